"""What each departure of the preset `paper` from the printed method costs: alone, and with the others fitted again.

`python docs/reproduction/departures.py FOLDER` takes an hour on one core. What FOLDER has is not computed again.
"""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from calcidem.analysis.published import published_study
from calcidem.app.config.presets import preset_text

CALIBRATED = (0.11, 0.66, 2.55, 5.0, 9.0)
SAMPLES = 116
FACTOR, SHARE, AREA = "sand.wave_stiffness_factor", "pattern.p_share", "pattern.cluster_area"
PATCHES = "pattern.p_patch_diameter=0.003:0.012"
DEPARTURES = {
    "none": ({}, [FACTOR]),
    "2 MPa: 5 kPa": ({"stress": "5.0e3", "wave_stiffness_factor": "15.0"}, [FACTOR, SHARE, PATCHES, AREA]),
    "factor: 1": ({"wave_stiffness_factor": "1.0"}, [SHARE, PATCHES, AREA]),
    "patches: single P contacts": ({"p_patch_diameter": "0.0"}, [FACTOR, SHARE, AREA]),
    "driven grains: a wall that rubs": ({"transmitter": '"wall"'}, [FACTOR, SHARE, PATCHES, AREA]),
    "receiver of 25 mm: 10 mm": ({"receiver_half_width": "0.01"}, [FACTOR, SHARE, PATCHES, AREA]),
}
"""Printed values, and what is fitted again. Under 5 kPa the fit starts where the velocities are near."""

TRIAL = re.compile(r"over target (.*); chi-square (.*)")


def with_values(text: str, changes: dict[str, str]) -> str:
    """Preset with other values; each key stands in one section."""
    for key, value in changes.items():
        text, count = re.subn(rf"(?m)^{key} = \S+", f"{key} = {value}", text)
        if count != 1:
            raise ValueError(key)
    return text


def targets() -> str:
    """Published means and standard deviations at the contents of the calibration, as a CSV file."""
    rows = [
        f"{content:g},{row.mean},{row.standard_deviation},{SAMPLES}\n"
        for content, row in published_study().velocities
        if content in CALIBRATED
    ]
    return "content,vs,sd,samples\n" + "".join(rows)


def trials(folder: Path, name: str) -> list[tuple[float, list[float]]]:
    """Chi-square, and means and standard deviations over the published ones, of each trial."""
    changes, free = DEPARTURES[name]
    stem = re.sub(r"\W+", "-", name)
    configuration, log = folder / f"{stem}.toml", folder / f"{stem}.log"
    if not log.exists():
        configuration.write_text(with_values(preset_text("paper"), changes), encoding="utf-8")
        (folder / "targets.csv").write_text(targets(), encoding="utf-8")
        command = [sys.executable, "-m", "calcidem", "calibrate", configuration, "--target", folder / "targets.csv"]
        command += ["--seeds", "16", "--first-seed", "501", "--tolerance", "0.03", "--out", folder / f"{stem}-fit.toml"]
        command += [word for key in free for word in ("--free", key)]
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=True)  # noqa: S603 - ours
        log.write_text(done.stdout, encoding="utf-8")
    return [(float(chi), [float(x) for x in ratios.split(", ")]) for ratios, chi in TRIAL.findall(log.read_text())]


def row(chi_square: float, ratios: list[float]) -> str:
    """Root mean square deviation of the means, range of standard deviations over the published, chi-square."""
    means, deviations = np.array(ratios).reshape(-1, 2).T
    rms = 100.0 * np.sqrt(np.mean((means - 1.0) ** 2))
    return f"{rms:.1f} %, {deviations.min():.2f} to {deviations.max():.2f}, {chi_square:.0f}"


def main() -> None:
    """Print the table."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    print("| departure: as printed | alone | fitted again |\n|---|---|---|")
    for name in DEPARTURES:
        found = trials(folder, name)
        print(f"| {name} | {row(*found[0])} | {row(*min(found))} |", flush=True)


if __name__ == "__main__":
    main()
