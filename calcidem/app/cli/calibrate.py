"""``calcidem calibrate``: fit named parameters to measured means and scatter of Vs against content."""

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calcidem.app.campaign.notices import tell
from calcidem.app.cli.arguments import (
    HIGHEST_SEED,
    SEEDS_AT_ONCE,
    ConfigurationFile,
    StudyCores,
    number_parser,
    parse_percentage,
)
from calcidem.sweep.ranks import available_cores
from calcidem.sweep.schedule import EXIT_ERROR

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from calcidem.app.studies.calibrate import FittedContent, FittedParameters


def calibrate_command(
    configuration: ConfigurationFile,
    target: Annotated[
        Path,
        typer.Option(
            help="Table: content (percent), Vs (m/s), optionally sd, samples; a row for each specimen or mean."
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE.toml", help="Calibrated configuration to write.")],
    free: Annotated[
        list[str] | None,
        typer.Option(
            "--free",
            "--parameter",
            metavar="SECTION.KEY[=LOW:HIGH]",
            help="Number to fit, in its range; may be repeated. Default: sand.wave_stiffness_factor, "
            "pattern.p_share, pattern.cluster_area.",
        ),
    ] = None,
    seeds: Annotated[int, typer.Option(min=3, max=SEEDS_AT_ONCE, help="Seeds at each content.")] = 16,
    first_seed: Annotated[int, typer.Option(min=0, max=HIGHEST_SEED - SEEDS_AT_ONCE, help="First seed.")] = 1,
    predict: Annotated[
        list[float] | None,
        typer.Option(
            parser=parse_percentage,
            metavar="PERCENT",
            help="Content to predict and not to fit; may be repeated.",
        ),
    ] = None,
    tolerance: Annotated[
        float,
        typer.Option(
            parser=number_parser(0.0, 1.0, "is not a number from 0 to 1"),
            metavar="PART",
            help="Relative error of the model, added to that of the targets.",
        ),
    ] = 0.02,
    cores: StudyCores = 0,
) -> None:
    """Fit parameters to measured means, and standard deviations, of Vs; write a configuration."""
    from calcidem.analysis.measured import group_specimens
    from calcidem.app.campaign.packing import provide_packing
    from calcidem.app.config.measured import read_targets
    from calcidem.app.config.reader import load_configuration, parse_file
    from calcidem.app.studies.calibrate import FITTED_BY_DEFAULT, FitPlan, calibrate
    from calcidem.app.studies.campaigns import study_workers
    from calcidem.app.studies.parameters import ParameterRange, refuse_unwritable, text_with_values
    from calcidem.storage.files import refuse_to_replace, write_text_atomically

    refuse_to_replace(out)
    loaded = load_configuration(configuration)
    targets = tuple(joined for joined, _ in group_specimens(read_targets(target, tell)))
    if len(targets) > len({row.content for row in targets}):
        raise typer.BadParameter(
            "has one content under several confining stresses; give the rows of one of them", param_hint="--target"
        )
    packing = provide_packing(loaded, None)
    ranges = [ParameterRange.parse(text) for text in free or FITTED_BY_DEFAULT[: len(targets)]]
    chosen = range(first_seed, first_seed + seeds)
    plan = FitPlan(targets, ranges, chosen, tuple(dict.fromkeys(predict or ())), tolerance)
    _, text = parse_file(configuration)
    refuse_unwritable(text, loaded, plan.start(loaded, packing), out)
    trials = out.with_suffix(".trials.db")
    tell(f"Every trial is a campaign in {trials}; after a stop the same command continues.")
    with study_workers(cores or available_cores()) as executor:
        fitted = calibrate(loaded, packing, plan, trials, executor, tell)
    typer.echo("\n".join(_calibration_lines(fitted)))
    if not fitted.is_fitted:
        typer.echo(f"Nothing was fitted: {out} is not written.")
        raise typer.Exit(EXIT_ERROR)
    write_text_atomically(out, text_with_values(text, fitted.values))
    typer.echo(f"Wrote {out}")


def _calibration_lines(fitted: "FittedParameters") -> Iterator[str]:
    """Report on a calibration."""
    if fitted.is_fitted:
        for name, value in fitted.values.items():
            low, high = fitted.intervals.get(name, (None, None))
            posterior = "" if low is None else f", 95 % of the posterior {low:.4g} to {high:.4g}"
            yield f"{name} = {value:.5g} +- {fitted.deviations[name]:.2g}{posterior}"
        for (i, first), (j, second) in combinations(enumerate(fitted.values), 2):
            yield f"correlation of {first} and {second}: {fitted.correlation[i, j]:+.2f}"
        yield f"chi-square {fitted.chi_square:.1f} with {fitted.freedom} degrees of freedom"
    for row in fitted.contents:
        yield _content_line(row, fitted.trials)
    yield from (f"Doubt: {doubt}." for doubt in fitted.doubts)


def _content_line(row: "FittedContent", trials: int) -> str:
    """One content: targets, results, and number of seeds."""
    target = row.target
    if row.seeds <= 1:
        return f"{row.role} {row.content:g} %: {row.seeds} of {row.planned} seeds have a velocity"
    mean, sd = f"mean {row.mean:.1f} +- {row.mean_error:.1f} m/s", f"sd {row.sd:.1f} m/s"
    if target is not None:
        mean += f" (target {target.vs:.1f}, {100.0 * (row.mean / target.vs - 1.0):+.1f} %)"
    if target is not None and target.sd is not None:
        sd += f" (target {target.sd:.1f}, x {row.sd / target.sd:.2f})"
    used = f"{row.seeds} of {row.planned} seeds" + (f" in all {trials} trials" if row.role == "fitted" else "")
    bands = [
        f"{name} {band[0]:.0f} to {band[1]:.0f}"
        for name, band in (("mean", row.mean_band), ("sd", row.sd_band))
        if band is not None
    ]
    predicted = f"; 95 % of campaigns have {', '.join(bands)} m/s" if bands else ""
    return f"{row.role} {row.content:g} %: {mean}, {sd}; {used}{predicted}"
