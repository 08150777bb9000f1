"""``calcidem predict``: Vs of a sample that was not simulated, and a check of such predictions."""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.table import Table

from calcidem.app.cli.arguments import HIGHEST_SEED, CampaignName, Database, Level, number_parser, parse_percentage
from calcidem.app.cli.formats import Format, FormatOption, tell_rows
from calcidem.storage.records import P_CONTACT, CementPattern

if TYPE_CHECKING:  # loaded by the command itself, not by its help
    from calcidem.analysis.predictor import Prediction, PredictorCheck


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
    feature: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE", help="Or a feature, such as path_normalized_connectivity=0.6; may be repeated."
        ),
    ] = None,
    level: Level = 0.95,
    layout: FormatOption = Format.TABLE,
    campaign: CampaignName = None,
) -> None:
    """Predict Vs of a sample from the campaign's own samples of its content, with an interval; nothing is simulated.

    Features are the cemented shares of the contacts at the height of the receiver (column_share) and of all
    (cemented_share), or those of --feature. Leaving out each sample in turn checks the intervals.
    """
    from calcidem.analysis.campaign_analysis import CampaignAnalysis
    from calcidem.app.campaign.patterns import with_patterns
    from calcidem.app.campaign.prediction import CEMENT_FEATURES, check_predictions
    from calcidem.app.cli.tables import make_console
    from calcidem.storage.sql.store import read_campaign

    given = [option for option in (seed, pattern, feature) if option is not None]
    if len(given) > 1 or (given and content is None):
        raise typer.BadParameter("give --content, and one of --seed, --pattern and --feature or none of them")
    cement = None if pattern is None else _read_pattern(pattern)
    features = None if feature is None else dict(_read_feature(text) for text in feature)
    with read_campaign(database, campaign) as store:
        predicted: dict[str, float] = {}
        if content is not None:
            from calcidem.app.campaign.opened import Campaign  # a sample that was not simulated needs the engine

            prediction = Campaign(store).predict(
                content=content, seed=seed, pattern=cement, features=features, level=level
            )
            predicted = _prediction_row(content, prediction)
            if layout is Format.TABLE:
                typer.echo(_prediction_line(content, prediction, level))
        names = CEMENT_FEATURES if features is None else tuple(features)
        analysis = CampaignAnalysis(store, with_cement=with_patterns)
        checks = check_predictions(analysis, names, level)
        alone = check_predictions(analysis, (), level)
    if content is not None:
        checks = {known: check for known, check in checks.items() if np.isclose(known, content)}
    if layout is not Format.TABLE:
        rows = [_check_row(known, check, alone[known]) | predicted for known, check in checks.items()]
        if not rows and predicted:  # too few samples for a check
            rows = [predicted]
        tell_rows(rows, layout, names=("content", "n", "coverage", "score", "score_alone", *predicted))
    elif content is None:
        make_console().print(_check_table(checks, alone))
        typer.echo(_overall_line(checks, alone))
    else:
        for known, check in checks.items():
            typer.echo(_check_line(check, alone[known]))


_parse_value = number_parser(-1e12, 1e12, "is not a value; write NAME=VALUE, such as path_normalized_connectivity=0.6")


def _read_pattern(path: Path) -> CementPattern:
    """Cemented contacts in a file; P and C contacts have the same effect on a path."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as source:
            lines = [row[:2] for row in csv.reader(source) if row]
        if lines and not any(entry.strip().lstrip("-").isdigit() for entry in lines[0]):
            del lines[0]  # a header
        contacts = np.array([[int(entry) for entry in row] for row in lines], dtype=np.int32).reshape(len(lines), 2)
    except (ValueError, OverflowError, csv.Error) as error:
        raise typer.BadParameter(f"{path}: {error}; give two grain numbers on each line") from error
    return CementPattern(contacts, np.full(len(contacts), P_CONTACT, dtype=np.uint8), np.empty((0, 2)))


def _read_feature(text: str) -> tuple[str, float]:
    """Name and value of a feature."""
    name, _, value = text.partition("=")
    return name.strip(), _parse_value(value)


def _prediction_line(content: float, prediction: "Prediction", level: float) -> str:
    """Describe a prediction and its basis."""
    interval = prediction.interval
    source = "content and features" if prediction.uses_features else "the content alone"
    return (
        f"{content:g} %: Vs {prediction.vs:.0f} m/s, {100.0 * level:g} % of such samples from {interval.low:.0f} to "
        f"{interval.high:.0f} m/s, from {source}."
    )


def _prediction_row(content: float, prediction: "Prediction") -> dict[str, float]:
    """The same for programs; m/s."""
    low, high = prediction.interval.low, prediction.interval.high
    return {"content": content, "vs": prediction.vs, "vs_interval_low": low, "vs_interval_high": high}


def _check_row(content: float, check: "PredictorCheck", alone: "PredictorCheck") -> dict[str, float]:
    """A check for programs; scores in m/s."""
    numbers = {name: getattr(check, name) for name in ("n", "coverage", "score")}
    return {"content": content, **numbers, "score_alone": alone.score}


def _check_line(check: "PredictorCheck", alone: "PredictorCheck") -> str:
    """Describe the predictions of samples that were left out."""
    return (
        f"Of {check.n} samples left out one by one {100.0 * check.coverage:.1f} % lay in their interval. "
        f"Mean interval score {check.score:.0f} m/s; {alone.score:.0f} m/s for the content alone."
    )


def _check_table(checks: "Mapping[float, PredictorCheck]", alone: "Mapping[float, PredictorCheck]") -> Table:
    """Table of all contents."""
    from calcidem.app.cli.tables import make_table

    table = make_table(None, numbers=("content, %", "samples", "in interval, %", "score, m/s", "of content alone, m/s"))
    for content, check in checks.items():
        numbers = f"{100.0 * check.coverage:.1f}", f"{check.score:.1f}", f"{alone[content].score:.1f}"
        table.add_row(f"{content:g}", str(check.n), *numbers)
    return table


def _overall_line(checks: "Mapping[float, PredictorCheck]", alone: "Mapping[float, PredictorCheck]") -> str:
    """Coverage and scores over all samples."""
    if not checks:
        return "No content has the six velocities that a check needs."
    inside = np.concatenate([check.inside for check in checks.values()])
    scores, without = (
        np.concatenate([found[content].scores for content in checks]).mean() for found in (checks, alone)
    )
    return (
        f"In all, {100.0 * inside.mean():.1f} % of {inside.size} samples, predicted from the other seeds of their "
        f"content, lay in their interval. Mean interval score {scores:.1f} m/s; "
        f"{without:.1f} m/s for the content alone."
    )
