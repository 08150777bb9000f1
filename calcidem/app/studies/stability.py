"""Command `calcidem stability`: what happens to a cell of a campaign if its quantities become extreme.

Each quantity is varied alone, or all are drawn at random. Every scene is run as a user would run it, and judged.
"""

import json
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import qmc

from calcidem.analysis.figures.style import (
    BLUE,
    GREY,
    ORANGE,
    VERMILION,
    VS_LABEL,
    apply_style,
    letter_panels,
    new_figure,
)
from calcidem.app.config.checks import check_against_packing
from calcidem.app.config.reader import change_configuration
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.study import StudyResult, markdown_table, read_former, signal_distance
from calcidem.dem.engine.scene import Sand
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.check import PATTERNS
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure
from calcidem.storage.files import write_text_atomically
from calcidem.storage.records import NORMAL_95


class SceneVerdict(StrEnum):
    """Verdict on a scene."""

    STABLE = "stable"
    REFUSED = "refused beforehand"
    STOPPED = "stopped with a reason"
    WRONG = "silently wrong"


@dataclass(frozen=True, slots=True)
class Judgement:
    """Judgement of one scene."""

    verdict: SceneVerdict
    reason: str = ""
    """Reason in words."""
    vs: float | None = None
    """Velocity, m/s; None if there is none."""
    error: float | None = None
    """True relative error; None if unknown."""


QUANTITIES = {
    "wave.step_fraction": ("time step / stability limit", (0.2, 0.4, 0.6, 0.8, 0.95, 1.0, 1.1)),
    "cement.bond_modulus": ("modulus of bonds / stiffness of contacts", (1.0, 10.0, 1e2, 1e3, 1e4, 1e5, 1e6)),
    "wave.damping": ("local damping factor", (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)),
    "wave.amplitude": ("velocity of the pulse $v_0$ (m/s)", (1e-9, 1e-7, 1e-5, 1e-3, 1e-1, 1.0, 10.0)),
    "wave.frequency": ("frequency / that of the campaign", (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 10.0)),
    "campaign.contents": ("share of the capacity for calcite", (0.0, 0.1, 0.3, 0.6, 0.9, 1.0)),
}
"""Keys of a configuration, each with a label for its values and those values."""
_POWERS = ("cement.bond_modulus", "wave.amplitude", "wave.frequency")  # varied over powers of ten


def stability(
    configuration: Configuration,
    experiment: Experiment,
    content: float,
    *,
    scenes: int = 0,
    draw: int = 1,
    kept: Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> StudyResult:
    """Judge the first seed of a campaign at a content, percent, with each of the `QUANTITIES` varied alone.

    With ``scenes``, as many scenes are judged, in which all quantities are drawn with the seed ``draw``, between their
    second value and their last but one. Grain sizes are not varied, since each needs a packing of its own.
    ``experiment`` is that of the campaign. The file ``kept`` has the scenes judged so far: after a stop the same study
    goes on with it, and removes it at the end; `OutputRefusedError` if it is of another one.
    """
    seed, contents = configuration.campaign.seed_numbers[0], configuration.campaign.contents
    plan = replace(configuration.campaign, seeds=(seed,), contents=(content,), until=None)
    radius, overlap = float(np.mean(experiment.packing.radius)), experiment.packing.report.mean_overlap
    units = {
        "cement.bond_modulus": pressed_stiffness(radius, overlap, experiment.stiffen()[1]),
        "wave.frequency": experiment.frequency(content),
        "campaign.contents": capacity(experiment, seed),
    }
    if scenes:
        ranges = {
            key: tuple(np.log10([values[1], values[-2]])) if key in _POWERS else (values[1], values[-2])
            for key, (_, values) in QUANTITIES.items()
        }
        groups = {"all": draw_latin(ranges, _POWERS, scenes, draw)}
    else:
        groups = {key: [{key: value} for value in values] for key, (_, values) in QUANTITIES.items()}
    identity = {
        "campaign_hash": configuration.hash,
        "packing_hash": experiment.packing.content_hash,
        "seed": seed,
        "content": content,
        "largest_content": max(contents),
        "scenes": scenes,
        "draw": draw,
    }
    former = read_former(kept, identity, "rows", list[dict[str, Any]])
    rows: list[dict[str, Any]] = []
    for name, group in groups.items():
        for number, drawn in enumerate(group):
            progress(f"{name}: scene {number + 1} of {len(group)}")
            changed = {key: value * units.get(key, 1.0) for key, value in drawn.items()}
            if "campaign.contents" in changed:  # a rounded content must not exceed the capacity
                changed["campaign.contents"] = float(np.floor(changed["campaign.contents"] * 1e6) / 1e6)
                if changed["campaign.contents"] > max(contents):  # the campaign may lack a frequency there
                    changed.setdefault("wave.frequency", experiment.frequency(max(contents)))
            scene = partial(_changed_experiment, replace(configuration, campaign=plan), experiment.packing, changed)
            if len(rows) < len(former):
                rows.append(former[len(rows)])
                continue
            rows.append({"quantity": name, **changed, **asdict(judge_scene(scene, seed))})
            if kept is not None:
                kept.parent.mkdir(parents=True, exist_ok=True)
                write_text_atomically(kept, json.dumps({**identity, "rows": rows}))
    if kept is not None:
        kept.unlink(missing_ok=True)
    counts = markdown_table(
        ("quantity", *SceneVerdict),
        count_verdicts({name: [row["verdict"] for row in rows if row["quantity"] == name] for name in groups}),
    )
    shown = [row for row in rows if not scenes or row["verdict"] == SceneVerdict.WRONG]
    cases = markdown_table(
        ("scene", "verdict", "Vs, m/s", "error", "reason"),
        [
            (
                ", ".join(f"{key} = {row[key]:.4g}" for key in QUANTITIES if key in row),
                row["verdict"],
                "-" if row["vs"] is None else f"{row['vs']:.4g}",
                row["error"],
                row["reason"],
            )
            for row in shown
        ],
    )
    return StudyResult(
        text="\n\n".join(table for table in (counts, cases) if table) + "\n",
        rows=rows,
        json=json.dumps(rows, indent=1),
        figures={} if scenes else {"": partial(_draw_outcomes, rows, units)},
        is_wrong=any(row["verdict"] == SceneVerdict.WRONG for row in rows),
    )


def judge_scene(scene: Callable[[], tuple[Experiment, float]], seed: int) -> Judgement:
    """Measure a scene; if it gives a velocity, repeat it with the finite law, longer, with a quarter of the step.

    ``scene`` returns an experiment and a content, percent, or raises a `ValueError`. A velocity is wrong if it differs
    by more than 5 % and by more than its stated 95 % interval.
    """
    try:
        experiment, content = scene()
        (found,) = measure(experiment, content, [seed], lanes=1)
        if found.vs is None or found.reading is None:
            return Judgement(SceneVerdict.STOPPED, found.reason)
        # The reference is read however large its own error is.
        read = replace(experiment.pick, largest_error=1.0)
        finer = replace(experiment, is_checked=False, pick=read).with_wave(
            law="finite",
            precision="float64",
            step_fraction=found.check.step_fraction / 4.0,
            samples_per_period=experiment.wave.samples_per_period * 4,
            slowest=experiment.wave.slowest / 2.0,
        )
        (exact,) = measure(finer, content, [seed], lanes=1)
    except ValueError as error:
        return Judgement(SceneVerdict.REFUSED, str(error).splitlines()[-1].strip())
    if exact.vs is None:  # a borderline case of the reading, if the signals agree
        distance = signal_distance(found.section, exact.section)
        reason, error_of_vs = f"{exact.reason} with a smaller step, signals {distance:.2g} apart", None
        right = distance < 0.1
    else:
        reason, error_of_vs = found.section.retry, found.vs / exact.vs - 1.0
        check = found.check
        stated = math.hypot(found.reading.error, check.numerical_error or 0.0, check.pulse_effect or 0.0)
        right = abs(error_of_vs) <= max(0.05, NORMAL_95 * stated)
    return Judgement(SceneVerdict.STABLE if right else SceneVerdict.WRONG, reason, found.vs, error_of_vs)


def draw_latin(
    ranges: Mapping[str, tuple[float, float]], powers: Collection[str], count: int, seed: int
) -> list[dict[str, float]]:
    """Latin hypercube over ranges, of exponents of ten for the quantities in ``powers``; the values of each scene."""
    sample = qmc.scale(qmc.LatinHypercube(len(ranges), rng=seed).random(count), *np.array(list(ranges.values())).T)
    return [
        {name: float(10.0**value if name in powers else value) for name, value in zip(ranges, row, strict=True)}
        for row in sample
    ]


def count_verdicts(groups: Mapping[str, Iterable[str]]) -> list[tuple[object, ...]]:
    """Name of each group of scenes, and the number of its scenes with each `SceneVerdict`."""
    counts = {name: Counter(verdicts) for name, verdicts in groups.items()}
    return [(name, *(count[verdict] for verdict in SceneVerdict)) for name, count in counts.items()]


def capacity(experiment: Experiment, seed: int) -> float:
    """Largest content of the sample of a seed and of the check samples, percent."""
    return min(experiment.ordering(each).maximum_content for each in {seed, *range(PATTERNS)})


def pressed_stiffness(radius: float, overlap: float, sand: Sand) -> float:
    """Hertz normal stiffness, N/m, of two disks of a radius at an overlap, both in m."""
    return float(1.5 * sand.hertz_coefficient(np.array(radius), np.array(radius)) * np.sqrt(overlap))


def _changed_experiment(
    configuration: Configuration, packing: Packing, changes: Mapping[str, float]
) -> tuple[Experiment, float]:
    """Experiment and content of a configuration with other values, after all checks of a run."""
    values = {key: [value] if key == "campaign.contents" else value for key, value in changes.items()}
    changed = change_configuration(configuration, values)
    check_against_packing(changed, packing)
    return changed.experiment(packing), changed.campaign.contents[0]


VERDICT_COLOURS = dict(zip(SceneVerdict, (BLUE, GREY, ORANGE, VERMILION), strict=True))


@apply_style
def _draw_outcomes(rows: Sequence[Mapping[str, Any]], units: Mapping[str, float]) -> Figure:
    """Draw Vs over each quantity; scenes without a velocity are at the bottom."""
    figure = new_figure(6.0)
    panels = figure.subplots(-(-len(QUANTITIES) // 2), 2).ravel()
    for axes, (key, (label, _)) in zip(panels, QUANTITIES.items(), strict=False):
        for row in (row for row in rows if row["quantity"] == key):
            place = row[key] / units.get(key, 1.0)
            look = {"color": VERDICT_COLOURS[row["verdict"]], "markersize": 5, "clip_on": False}
            if row["vs"] is None:
                axes.plot(place, 0.0, "s", transform=axes.get_xaxis_transform(), **look)
            else:
                axes.plot(place, row["vs"], "o", **look)
        axes.set(xscale="log" if key in _POWERS else "linear", xlabel=label, ylabel=VS_LABEL)
        axes.set_ylim(bottom=0.0)
    letter_panels(panels)
    handles = [
        panels[0].plot([], [], "s", color=colour, label=verdict)[0] for verdict, colour in VERDICT_COLOURS.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure
