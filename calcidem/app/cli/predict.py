"""``calcidem predict``: Vs of a sample that was not simulated, and a check of such predictions."""

import csv
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from calcidem.app.cli.arguments import HIGHEST_SEED, CampaignName, Database, Level, parse_percentage
from calcidem.app.cli.formats import Format, FormatOption, tell_rows
from calcidem.input_file import read_text
from calcidem.storage.records import P_CONTACT, CementPattern


def predict_command(
    database: Database,
    content: Annotated[
        float | None,
        typer.Option(
            parser=parse_percentage,
            metavar="PERCENT",
            help="Content of the sample; without it all are checked.",
        ),
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
    """Predict Vs of a sample from the campaign's own samples of its content, with an interval; nothing is simulated.

    The feature is the conductance of the cement as a network (network_conductance). Leaving out each sample in turn
    checks the intervals.
    """
    from calcidem.analysis.campaign_analysis import CampaignAnalysis
    from calcidem.app.campaign.patterns import with_patterns
    from calcidem.app.campaign.prediction import check_predictions
    from calcidem.storage.sql.store import read_campaign

    if (seed is not None and pattern is not None) or (content is None and (seed, pattern) != (None, None)):
        raise typer.BadParameter("give --content, and one of --seed and --pattern or none of them")
    cement = None if pattern is None else _read_pattern(pattern)
    with read_campaign(database, campaign) as store:
        predicted: dict[str, float] = {}
        if content is not None:
            from calcidem.app.campaign.opened import Campaign  # a sample that was not simulated needs the engine

            prediction = Campaign(store).predict(content=content, seed=seed, pattern=cement, level=level)
            low, high = prediction.interval.low, prediction.interval.high
            predicted = {"content": content, "vs": prediction.vs, "vs_interval_low": low, "vs_interval_high": high}
            if layout is Format.TABLE:
                source = "content and features" if prediction.uses_features else "the content alone"
                typer.echo(
                    f"{content:g} %: Vs {prediction.vs:.0f} m/s, {100.0 * level:g} % of such samples from {low:.0f} to "
                    f"{high:.0f} m/s, from {source}."
                )
        analysis = CampaignAnalysis(store, with_cement=with_patterns)
        checks = check_predictions(analysis, level)
        alone = check_predictions(analysis, level, with_cement=False)
    chosen = [known for known in checks if content is None or np.isclose(known, content)]
    if layout is Format.TABLE:
        _tell_checks(checks, alone, chosen, content)
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
    text = read_text(path, 1_000_000_000)  # bytes; the contacts of 10 million disks have fewer
    try:
        lines = [row[:2] for row in csv.reader(text.splitlines()) if row]
        if lines and not any(entry.strip().lstrip("-").isdigit() for entry in lines[0]):
            del lines[0]  # a header
        contacts = np.array([[int(entry) for entry in row] for row in lines], dtype=np.int32).reshape(len(lines), 2)
    except (ValueError, OverflowError, csv.Error) as error:
        raise typer.BadParameter(f"{path}: {error}; give two grain numbers on each line") from error
    return CementPattern(contacts, np.full(len(contacts), P_CONTACT, dtype=np.uint8), np.empty((0, 2)))


def _tell_checks(
    checks: dict[float, tuple[Any, Any]],
    alone: dict[float, tuple[Any, Any]],
    chosen: list[float],
    content: float | None,
) -> None:
    """Tell how far to trust predictions: a table of all contents, or a sentence on one."""
    from calcidem.app.cli.tables import make_console, make_table

    if not chosen:
        if content is None:
            typer.echo("No content has the six velocities that a check needs.")
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
    typer.echo(
        f"Of {inside.size} samples, each predicted from the other seeds of its content, {100.0 * inside.mean():.1f} % "
        f"lay in their interval. Mean interval score {scores.mean():.1f} m/s; {without.mean():.1f} m/s for the content "
        "alone."
    )
