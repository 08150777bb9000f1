"""Studies: ``calcidem predict``, ``sensitivity``, ``calibrate``, ``verify``, ``accuracy`` and ``stability``."""

import math
from collections import Counter
from collections.abc import Iterator
from importlib.resources import as_file, files
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from calcidem.app.cli.options import (
    DEFAULT_CONFIGURATION,
    HIGHEST_SEED,
    SEEDS_AT_ONCE,
    CampaignName,
    ConfigurationFile,
    Database,
    JudgedDatabase,
    Level,
    OnlyContents,
    StudyCores,
    StudyFolder,
    number_parser,
    percent_option,
    refuse_options,
    say,
)
from calcidem.app.cli.output import Format, FormatOption, tell_rows, tell_study, tell_tables
from calcidem.input_file import Table, read_input
from calcidem.storage.records import P_CONTACT, CementPattern
from calcidem.sweep.ranks import available_cores
from calcidem.sweep.schedule import EXIT_ERROR
from calcidem.wording import pluralize, tell

if TYPE_CHECKING:
    from calcidem.app.studies.calibrate import FittedContent, FittedParameters
    from calcidem.app.studies.verify import Verification


def predict_command(
    database: Database,
    content: Annotated[
        float | None,
        percent_option("Content of the sample; without it all are checked."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, max=HIGHEST_SEED, help="Seed whose cement is drawn.")] = None,
    pattern: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Or its cemented contacts: two grain numbers (from 0) per line."),
    ] = None,
    level: Level = 0.95,
    layout: FormatOption = Format.TABLE,
    campaign: CampaignName = None,
) -> None:
    """Predict Vs of a sample, with an interval, from the campaign's samples of its content, without simulating it.

    The feature is the conductance of the cement (network_conductance). The interval is that of a new sample, from the
    errors of the others in log Vs; 'report' gives one for a normal distribution.
    """
    from calcidem.app.campaign.opened import check_predictions, open_campaign
    from calcidem.app.cli.views import pulse_remark

    if (seed is not None and pattern is not None) or (content is None and (seed, pattern) != (None, None)):
        raise typer.BadParameter("give --content, and one of --seed and --pattern or none of them")
    cement = None if pattern is None else _read_pattern(pattern)
    with open_campaign(database, campaign) as opened:
        prediction, predicted = None, dict[str, float]()
        if content is not None:
            prediction = opened.predict(content=content, seed=seed, pattern=cement, level=level)
            low, high = prediction.interval.low, prediction.interval.high
            predicted = {"content": content, "vs": prediction.vs, "vs_interval_low": low, "vs_interval_high": high}
            if layout is Format.TABLE:
                source = "content and conductance" if prediction.uses_features else "the content alone"
                say(
                    f"{content:g} %: Vs {prediction.vs:.0f} m/s, {100.0 * level:g} % of such samples from {low:.0f} to "
                    f"{high:.0f} m/s, from {source}. Vs is their median."
                )
        analysis = opened.analyse()
        alone = check_predictions(analysis, level, with_cement=False)
        checks = alone if prediction and not prediction.uses_features else check_predictions(analysis, level)
    chosen = [known for known in checks if content is None or np.isclose(known, content)]
    if layout is Format.TABLE:
        _tell_checks(checks, alone, chosen, content)
        if loud := sum(row.budget.loud for row in analysis.distributions if row.content in chosen):
            say(pulse_remark(loud))
        return
    rows: list[dict[str, Any]] = [
        {
            "content": known,
            "n": checks[known][1].size,
            "coverage": float(checks[known][0].mean()),
            "score": float(checks[known][1].mean()),
            "score_alone": float(alone[known][1].mean()),
            **predicted,
        }
        for known in chosen
    ]
    if not rows and predicted:  # too few samples for a check
        rows = [dict(predicted)]
    tell_rows(rows, layout, names=("content", "n", "coverage", "score", "score_alone", *predicted))


def _read_pattern(path: Path) -> CementPattern:
    """Cemented contacts in a file; P and C contacts have the same effect on a path."""
    known = {"first": "first|i|a", "second": "second|j|b"}
    content = read_input(path, 1_000_000_000)  # bytes; the contacts of 10 million disks have fewer
    table = Table.read(content, path, known, tuple(known))
    if not table.rows and not table.head:
        raise typer.BadParameter(f"{path} has no line of two grain numbers; give one for each cemented contact")
    places = table.places(known)
    chosen = [places.get(name, place) for place, name in enumerate(known)]
    try:
        contacts = [[int(row[place]) for place in chosen] for _, row in table.rows]
        pairs = np.array(contacts, dtype=np.int32).reshape(len(contacts), 2)
    except (ValueError, OverflowError, IndexError) as error:
        raise typer.BadParameter(f"{path}: {error}; give two grain numbers on each line") from error
    return CementPattern(pairs, np.full(len(pairs), P_CONTACT, dtype=np.uint8), np.empty((0, 2)))


def _tell_checks(
    checks: dict[float, tuple[Any, Any]],
    alone: dict[float, tuple[Any, Any]],
    chosen: list[float],
    content: float | None,
) -> None:
    """Tell how far to trust predictions: a table of all contents, or a sentence on one."""
    from calcidem.analysis.fits import FEWEST_ROWS
    from calcidem.app.cli.output import make_console, make_table

    if not chosen:
        if content is None:
            say(f"No content has the {FEWEST_ROWS + 2} velocities that a check needs.")
        return
    inside, scores, without = (
        np.concatenate([found[known][part] for known in chosen])
        for found, part in ((checks, 0), (checks, 1), (alone, 1))
    )
    if content is None:
        table = make_table(
            None, numbers=("content, %", "samples", "in interval, %", "score, m/s", "of content alone, m/s")
        )
        for known in chosen:
            own, score = checks[known]
            numbers = f"{100.0 * own.mean():.1f}", f"{score.mean():.1f}", f"{alone[known][1].mean():.1f}"
            table.add_row(f"{known:g}", str(own.size), *numbers)
        make_console().print(table)
    told = (
        f"Of {inside.size} samples, each predicted from the other seeds of its content, {100.0 * inside.mean():.1f} % "
        f"lay in their interval. Mean interval score {scores.mean():.1f} m/s"
    )
    if checks is not alone:
        told += f"; {without.mean():.1f} m/s for the content alone"
        told += ", which predicts better" if without.mean() < scores.mean() else ""
    say(f"{told}. The score is the width, and more for a sample outside: small is good.")


def sensitivity_command(
    plan: Annotated[
        Path,
        typer.Argument(
            metavar="PLAN.toml|frequency|damping",
            help="Variants of a configuration, or the quantity to vary.",
        ),
    ],
    database: Annotated[
        str,
        typer.Option(
            "--db",
            metavar="DB",
            help="Database for all variants; frequency, damping: that of the campaign.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="TABLE.md", help="File for the table; figures and NetCDF beside it."),
    ] = None,
    content: OnlyContents = None,
    campaign: CampaignName = None,
    only_table: Annotated[bool, typer.Option("--only-table", help="Only show what is stored.")] = False,
    cores: StudyCores = 0,
) -> None:
    """Compute variants of a campaign with the same seeds, and show how each changes mean and scatter of Vs.

    'frequency' or 'damping' computes samples of a stored campaign with other values; its database is not written.
    """
    from calcidem.app.studies.sensitivity import compute_variants, read_variants, variant_table, vary_one
    from calcidem.app.studies.study import study_workers
    from calcidem.storage.files import refuse_to_replace

    if out is not None:
        refuse_to_replace(out)
    if str(plan) in {"frequency", "damping"}:
        refuse_options("leave it out: it is for a plan", {"--only-table": only_table, "--cores": cores or None})
        result = vary_one(str(plan), database, content, campaign)
    else:
        refuse_options("leave it out: the plan has it", {"--content": content, "--campaign": campaign})
        variants = read_variants(plan, database)
        if not only_table:
            with study_workers(cores or available_cores()) as executor:
                compute_variants(variants, tell, executor)
        result = variant_table(variants)
    if out is None:
        tell_tables(result.text)
        return
    for written in result.write(out):
        say(f"Wrote {written}")


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
            help="Number to fit, in its range (repeatable). Default: sand.wave_stiffness_factor, "
            "pattern.p_share, pattern.cluster_area.",
        ),
    ] = None,
    seeds: Annotated[int, typer.Option(min=3, max=SEEDS_AT_ONCE, help="Seeds at each content.")] = 16,
    first_seed: Annotated[int, typer.Option(min=0, max=HIGHEST_SEED - SEEDS_AT_ONCE, help="First seed.")] = 1,
    predict: Annotated[
        list[float] | None,
        percent_option("Content to predict and not to fit (repeatable)."),
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
    from calcidem.app.config.reader import load_configuration, parse_file, read_targets
    from calcidem.app.studies.calibrate import FITTED_BY_DEFAULT, FitPlan, calibrate
    from calcidem.app.studies.study import ParameterRange, refuse_unwritable, study_workers, text_with_values
    from calcidem.storage.files import refuse_to_replace, write_text_atomically

    refuse_to_replace(out)
    loaded = load_configuration(configuration)
    targets = tuple(joined for joined, _ in group_specimens(read_targets(target, tell)))
    if len(targets) > len({row.content for row in targets}):
        raise typer.BadParameter(
            "has one content under several confining stresses, or of specimens and of a mean; give the rows of one of "
            "them",
            param_hint="--target",
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
    say("\n".join(_calibration_lines(fitted)))
    if not fitted.is_fitted:
        say(f"Nothing was fitted: {out} is not written.")
        raise typer.Exit(EXIT_ERROR)
    write_text_atomically(out, text_with_values(text, {"campaign.name": out.stem, **fitted.values}))
    say(f"Wrote {out}")


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
    if row.content == 0.0:
        mean, sd = f"mean {row.mean:.1f} m/s", "no sd, also of the target: all seeds are one sample"
    if target is not None:
        mean += f" (target {target.vs:.1f}, {100.0 * (row.mean / target.vs - 1.0):+.1f} %)"
    if target is not None and target.sd is not None and row.content > 0.0:
        sd += f" (target {target.sd:.1f}, x {row.sd / target.sd:.2f})"
    used = f"{row.seeds} of {row.planned} seeds" + (f" in all {trials} trials" if row.role == "fitted" else "")
    bands = [
        f"{name} {band[0]:.0f} to {band[1]:.0f}"
        for name, band in (("mean", row.mean_band), ("sd", row.sd_band))
        if band is not None
    ]
    predicted = f"; 95 % of campaigns have {', '.join(bands)} m/s" if bands else ""
    return f"{row.role} {row.content:g} %: {mean}, {sd}; {used}{predicted}"


def verify_command(
    database: Database,
    cells: Annotated[int, typer.Option(min=1, help="Cells to compute again.")] = 4,
    choice: Annotated[int | None, typer.Option(min=0, metavar="SEED", help="Seed of their random choice.")] = None,
    integrity: Annotated[
        bool, typer.Option("--integrity", help="Only let SQLite check the whole file; exit code 1 if it is damaged.")
    ] = False,
    layout: FormatOption = Format.TABLE,
    campaign: CampaignName = None,
) -> None:
    """Compute random cells again, on the stored packing, and compare status, readings, step, cement and sections.

    Exit codes: 0 same bits; 3 same to rounding: counts, status and cement are equal, relative differences at most 1e-9;
    1 different; 2 not comparable, such as another physics version.
    """
    from calcidem.app.campaign.opened import open_campaign
    from calcidem.app.cli.exit_codes import EXIT_ROUNDING
    from calcidem.app.studies.verify import Agreement, random_cells, verify
    from calcidem.storage.errors import DAMAGE_REMEDY

    with open_campaign(database, campaign) as opened:
        if integrity:
            damage = opened.store.damage()
            if layout is not Format.TABLE:
                tell_rows([{"damage": text} for text in damage], layout, names=("damage",))
            else:
                say("\n".join((*damage, DAMAGE_REMEDY)) if damage else "No damage was found.")
            raise typer.Exit(EXIT_ERROR if damage else 0)
        keys = random_cells(opened.store, cells, choice)
        found = []
        for verification in verify(opened.store, keys, opened.experiment):
            if layout is Format.TABLE:
                say(_verification_line(verification))
            found.append(verification)
    counts = Counter(verification.agreement for verification in found)
    if layout is Format.TABLE:
        verdicts = ", ".join(f"{counts[agreement]} {agreement}" for agreement in Agreement)
        say(f"{pluralize(len(found), 'cell')}: {verdicts}.")
    else:
        rows = [
            {
                "seed": one.stored.key.seed,
                "content": one.stored.key.content,
                "agreement": one.agreement.value,
                "most_different": one.most_different,
                "relative_difference": one.differences.get(one.most_different, 0.0),
                "differences": dict(one.differences),
            }
            for one in found
        ]
        tell_rows(rows, layout)
    codes = {Agreement.SAME_BITS: 0, Agreement.ROUNDING: EXIT_ROUNDING, Agreement.DIFFERENT: EXIT_ERROR}
    if code := codes[max(counts, key=list(Agreement).index)]:  # the worst of them
        raise typer.Exit(code)


def _verification_line(verification: "Verification") -> str:
    """Result for one cell, with the quantity that differs most and its difference."""
    key, name = verification.stored.key, verification.most_different
    text = f"{key}: {verification.agreement}"
    if not name:
        return text
    size = verification.differences[name]
    stored, computed = (getattr(result, name, None) for result in (verification.stored, verification.computed))
    amount = "" if stored is computed is None else f": stored {stored}, computed {computed}"
    if math.isfinite(size):
        amount = f", relative difference {size:.2g}"
    others = len(verification.differences) - 1
    also = f"; {others} other{'s' if others > 1 else ''} differ{'' if others > 1 else 's'}" if others else ""
    return f"{text} (most of all {name}{amount}{also})"


def accuracy_command(
    configuration: ConfigurationFile = DEFAULT_CONFIGURATION,
    content: OnlyContents = None,
    seeds: Annotated[int, typer.Option(min=1, max=SEEDS_AT_ONCE, help="Seeds to measure.")] = 4,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SETTING",
            help="Only this setting beside the default, such as 'step_fraction 0.4' (repeatable).",
        ),
    ] = None,
    db: JudgedDatabase = None,
    out: StudyFolder = None,
    layout: FormatOption = Format.TABLE,
) -> None:
    """Measure error against run time of every numerical setting.

    A table has what the computation leaves out, why that is safe, and its cost. After a stop, the same command with
    --out continues.
    """
    from calcidem.app.config.reader import change_configuration, load_configuration
    from calcidem.app.studies.accuracy import accuracy, choose_settings
    from calcidem.app.studies.study import ROUNDS, Cells, StudyResult

    loaded = load_configuration(configuration)
    planned = change_configuration(loaded, {"campaign.contents": sorted(set(content or loaded.campaign.contents))})
    cells = Cells.of_campaign(planned, seeds, db, tell)
    try:
        compared = choose_settings(cells, only or ())
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    table = out and out / "accuracy.md"

    def write(part: StudyResult) -> None:
        if table is not None:
            list(part.write(table))

    former, rounds = table and table.with_suffix(".json"), 1 if only else ROUNDS
    result = accuracy(planned, cells, compared, rounds=rounds, former=former, tell=write)
    tell_study(result, layout, table)


def stability_command(
    configuration: Annotated[
        Path | None,
        typer.Argument(
            metavar="CONFIG", show_default=False, help="TOML file of the campaign; the preset quick if not given."
        ),
    ] = None,
    content: Annotated[
        float | None,
        percent_option("Content of the scenes; the campaign's middle one if not given."),
    ] = None,
    scenes: Annotated[
        int | None, typer.Option(min=1, help="Random scenes, without a figure, instead of one quantity at a time.")
    ] = None,
    draw: Annotated[int, typer.Option(min=0, metavar="SEED", help="Seed of the random scenes.")] = 1,
    db: JudgedDatabase = None,
    out: StudyFolder = None,
    layout: FormatOption = Format.TABLE,
) -> None:
    """Show which extreme values of step, bonds, damping, pulse and content are stable, refused or stopped.

    After a stop, the same command with --out continues. Exit code 1 if a velocity is silently wrong.
    """
    from calcidem.app.config.reader import load_configuration
    from calcidem.app.studies.stability import stability
    from calcidem.app.studies.study import Cells

    with as_file(files("calcidem.app.config.presets") / "quick.toml") as quick:
        loaded = load_configuration(configuration or quick)
    cells = Cells.of_campaign(loaded, 1, db, tell)
    middle = cells.contents[len(cells.contents) // 2]
    chosen = middle if content is None else content
    kept = out and out / "stability.partial.json"
    result = stability(loaded, cells.experiment, chosen, scenes=scenes or 0, draw=draw, kept=kept, progress=tell)
    tell_study(result, layout, out and out / "stability.md")
    if result.is_wrong:
        raise typer.Exit(EXIT_ERROR)
