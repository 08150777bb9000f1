"""The report: one HTML page that needs nothing else."""

import os
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import xarray as xr
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure

from calcidem.analysis.campaign_analysis import CampaignAnalysis, UnavailableError
from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES, CampaignFigure
from calcidem.analysis.figures.sensitivity import STUDY_FIGURES
from calcidem.analysis.figures.style import render
from calcidem.app.report.comparison import disagreement_table, published_table
from calcidem.app.report.provenance import configuration_table, packing_table, parameter_table, run_table
from calcidem.app.report.results import (
    cost_table,
    feature_table,
    growth_table,
    law_table,
    meaning_table,
    near_field_rows,
    outcome_table,
    velocity_table,
)
from calcidem.app.report.wording import Table, decimal, significant, time_span
from calcidem.storage.campaign import open_stored_campaign
from calcidem.storage.files import write_atomically

_FEW_SAMPLES = 30
"""Below this a skewness, a kurtosis and the verdict on normality say little."""


_MEDIA_TYPES = {"svg": "image/svg+xml", "png": "image/png"}


@dataclass(frozen=True, slots=True)
class _Picture:
    """A figure in a page.

    Attributes
    ----------
    name, title, caption
        As in the registry.
    source
        The picture itself as a data URI; empty where there is none.
    inches
        Width for which its letters were chosen.
    reason
        Why there is none.
    """

    name: str
    title: str
    caption: str
    source: str = ""
    inches: float = 0.0
    reason: str = ""


@dataclass(frozen=True, slots=True)
class _Section:
    """A part of the page.

    Attributes
    ----------
    anchor, title
        Name in links, and heading.
    text
        Paragraphs.
    tables, pictures
        In the order in which they are shown, tables after pictures.
    folded
        Tables that open on a click.
    """

    anchor: str
    title: str
    text: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: tuple[_Picture, ...] = ()
    folded: tuple[Table, ...] = ()


def write_report(
    database: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    campaign_name: str | None = None,
    studies: Mapping[str, xr.Dataset] | None = None,
) -> Path:
    """Write the report of a campaign.

    Parameters
    ----------
    database
        SQLite file or database URL; a run may go on writing it.
    out
        HTML file; replaced only when the new one is complete.
    campaign_name
        Which campaign, where the database has several.
    studies
        Results of `calcidem.app.studies.frequency_and_damping` to show, named "frequency" and "damping".

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    StoreError
        If the database can't be read.
    OSError
        If the file can't be written.
    """
    target = Path(out)
    with open_stored_campaign(database, campaign_name) as campaign:
        text = _render_page(CampaignAnalysis(campaign), studies or {})
    with write_atomically(target) as partial:
        partial.write_text(text, encoding="utf-8")
    return target


def _render_page(analysis: CampaignAnalysis, studies: Mapping[str, xr.Dataset]) -> str:
    """Give the page as text."""
    pictures = {picture.name: picture for picture in _campaign_pictures(analysis)}
    sections = (
        _velocity_section(analysis, pictures),
        _sample_section(pictures),
        _path_section(analysis, pictures),
        _error_section(analysis, pictures),
        _sensitivity_section(studies),
        _published_section(analysis),
        _provenance_section(analysis),
    )
    environment = Environment(
        loader=PackageLoader("calcidem.app.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    record = analysis.campaign.record
    return environment.get_template("report.html").render(
        name=record.name,
        hash=record.hash,
        written=f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        facts=key_facts(analysis),
        sections=[section for section in sections if section],
    )


def key_facts(analysis: CampaignAnalysis) -> tuple[tuple[str, str], ...]:
    """Give the numbers that say at a glance what the campaign is."""
    outcomes, cells = analysis.outcomes, analysis.cells
    done, failed = int(outcomes["measured"].sum()), int(outcomes["failed"].sum())
    missing = int(outcomes["missing"].sum())
    means = [row.vs.mean for row in analysis.distributions if row.vs.n]
    errors = cells["error_bound"].to_numpy()
    seconds = float(np.nansum(cells["seconds"].to_numpy()))
    error = f"{significant(100 * float(np.nanmax(errors)), 2)} %" if np.isfinite(errors).any() else "unknown"
    span = f"{decimal(min(means))} to {decimal(max(means))} m/s" if means else "none"
    return (
        ("samples measured", f"{done} of {done + failed + missing}"),
        ("without velocity", str(failed)),
        ("not computed yet", str(missing)),
        ("contents and seeds", f"{analysis.vs.sizes['content']} \N{MULTIPLICATION SIGN} {analysis.vs.sizes['seed']}"),
        ("mean Vs", span),
        ("bound of numerical error", error),
        ("computing time", time_span(seconds)),
    )


def _velocity_section(analysis: CampaignAnalysis, pictures: Mapping[str, _Picture]) -> _Section:
    tables = [velocity_table(analysis), meaning_table(analysis), outcome_table(analysis), growth_table(analysis)]
    text = []
    measured = [row.vs.n for row in analysis.distributions if row.vs.n]
    if measured and min(measured) < _FEW_SAMPLES:
        text.append(
            f"With only {min(measured)} samples at a content, skewness and kurtosis have wide errors, and a test "
            "that does not reject normality proves little."
        )
    if any(row.content == 0 and row.vs.n > 1 for row in analysis.distributions):
        text.append("Without cement the seeds of one packing are the same sample, so there is no scatter at 0 %.")
    if near := near_field_rows(analysis):
        text.append(
            f"At {len(near)} of {len(analysis.distributions)} contents fewer than two wavelengths lie between "
            "transmitter and receiver: near field and shear wave arrive together there."
        )
    return _Section(
        "velocities",
        "Shear-wave velocity",
        tuple(text),
        tables=tuple(table for table in tables if table),
        pictures=(pictures["vs_range"], pictures["histograms"]),
    )


def _sample_section(pictures: Mapping[str, _Picture]) -> _Section:
    shown = ("samples", "measurement", "signals", "methods")
    return _Section("samples", "Samples and measurement", pictures=tuple(pictures[name] for name in shown))


def _path_section(analysis: CampaignAnalysis, pictures: Mapping[str, _Picture]) -> _Section:
    tables: list[Table] = []
    reasons: list[str] = []
    makers: tuple[Callable[[], Table], ...] = (
        lambda: feature_table(analysis),
        lambda: law_table([analysis.physical_law, analysis.scanned_law]),
    )
    for make in makers:
        try:
            tables.append(make())
        except UnavailableError as error:
            reasons.append(f"A table is left out: {error}.")
    shown = ("paths", "correlations", "weight_scan", "laws")
    return _Section(
        "paths",
        "Preferential paths and connectivity",
        tuple(reasons),
        tables=tuple(tables),
        pictures=tuple(pictures[name] for name in shown),
    )


def _error_section(analysis: CampaignAnalysis, pictures: Mapping[str, _Picture]) -> _Section:
    return _Section("errors", "Errors and run time", tables=(cost_table(analysis),), pictures=(pictures["narrowing"],))


def _sensitivity_section(studies: Mapping[str, xr.Dataset]) -> _Section | None:
    pictures = tuple(_study_pictures(studies))
    return _Section("sensitivity", "Sensitivity", pictures=pictures) if pictures else None


def _published_section(analysis: CampaignAnalysis) -> _Section:
    table = published_table(analysis)
    text = () if table else ("The contents of this campaign are not those of the published tables.",)
    return _Section(
        "published",
        "The published study",
        text,
        tables=(table,) if table else (),
        folded=(disagreement_table(),),
    )


def _provenance_section(analysis: CampaignAnalysis) -> _Section:
    campaign = analysis.campaign
    tables = [parameter_table(campaign.config)]
    text = []
    try:
        tables.append(packing_table(analysis))
    except UnavailableError as error:
        text.append(f"No report on the packing: {error}.")
    return _Section(
        "provenance",
        "What was run",
        tuple(text),
        tables=(*tables, run_table(campaign.runs())),
        folded=(configuration_table(campaign.config),),
    )


def _campaign_pictures(analysis: CampaignAnalysis) -> Iterator[_Picture]:
    """Draw every figure that the campaign allows, in the registry's order."""
    for entry in CAMPAIGN_FIGURES:
        yield _draw_picture(entry, analysis)


def _draw_picture(entry: CampaignFigure, analysis: CampaignAnalysis) -> _Picture:
    """Draw one figure, or say why it can't be drawn."""
    try:
        figure = entry.draw(analysis)
    except UnavailableError as error:
        return _Picture(entry.name, entry.title, entry.caption, reason=str(error))
    source = _data_uri(figure, "png" if entry.pictorial else "svg")
    return _Picture(entry.name, entry.title, entry.caption, source, figure.get_figwidth())


def _study_pictures(studies: Mapping[str, xr.Dataset]) -> Iterator[_Picture]:
    """Draw the figures of the studies given, named "frequency" and "damping"."""
    for entry in STUDY_FIGURES:
        if entry.study in studies:
            figure = entry.draw(studies[entry.study])
            source = _data_uri(figure, "svg")
            yield _Picture(entry.name, entry.title, entry.caption, source, figure.get_figwidth())


def _data_uri(figure: Figure, file_format: str) -> str:
    """Give a figure as a data URI, so that a page needs no other file."""
    return f"data:{_MEDIA_TYPES[file_format]};base64,{b64encode(render(figure, file_format)).decode()}"
