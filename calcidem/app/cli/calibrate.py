"""``calcidem calibrate``: fit named parameters to measured Vs against content."""

from itertools import combinations
from pathlib import Path
from typing import Annotated

import typer

from calcidem.app.campaign.packing import provide_packing
from calcidem.app.cli.arguments import ConfigurationFile
from calcidem.app.config.reader import load_configuration
from calcidem.app.studies.calibrate import FITTABLE, FittedParameters, calibrate, read_targets, text_with_values


def calibrate_command(
    configuration: ConfigurationFile,
    target: Annotated[Path, typer.Option(help="CSV file with the columns content (percent) and vs (m/s).")],
    out: Annotated[Path, typer.Option(metavar="FILE.toml", help="Calibrated configuration to write.")],
    parameter: Annotated[
        list[str] | None, typer.Option(help=f"Parameter to fit, one of {', '.join(FITTABLE)}; may be repeated.")
    ] = None,
    seeds: Annotated[int, typer.Option(min=2, help="Number of seeds at each content, the same in every trial.")] = 16,
) -> None:
    """Fit parameters so that the mean of Vs matches measured values, and write a calibrated configuration."""
    loaded = load_configuration(configuration)
    targets = read_targets(target)
    packing = provide_packing(loaded, None, typer.echo)
    names = parameter or list(FITTABLE[: min(3, len(targets))])
    fitted = calibrate(loaded, packing, targets, names, range(1, seeds + 1), typer.echo)
    typer.echo("\n".join(_calibration_lines(fitted)))
    out.write_text(text_with_values(configuration.read_text(encoding="utf-8"), fitted.values), encoding="utf-8")
    typer.echo(f"Wrote {out}")


def _calibration_lines(fitted: FittedParameters) -> list[str]:
    """Report on a calibration."""
    lines = [f"{name} = {value:.5g} +- {fitted.deviations[name]:.2g}" for name, value in fitted.values.items()]
    lines += [
        f"correlation of {first} and {second}: {fitted.correlation[i, j]:+.2f}"
        for (i, first), (j, second) in combinations(enumerate(fitted.values), 2)
    ]
    lines += [
        f"{content:g} %: target {wanted:.1f} m/s, reached {fitted.fitted[content]:.1f} m/s "
        f"({100.0 * (fitted.fitted[content] / wanted - 1.0):+.1f} %)"
        for content, wanted in fitted.targets.items()
    ]
    return lines
