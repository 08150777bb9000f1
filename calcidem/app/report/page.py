"""The report: one self-contained HTML page, and its figures, tables and numbers as files."""

import csv
import os
import re
from base64 import b64encode
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.correlation import correlate
from calcidem.analysis.distribution import tabulate
from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES, STUDY_FIGURES
from calcidem.analysis.figures.style import FigureEntry, render, save
from calcidem.analysis.measured import Target
from calcidem.analysis.packing_graph import installed_features
from calcidem.analysis.velocity import NOTE_QUANTITIES, notes_on
from calcidem.app.campaign.packing import with_patterns
from calcidem.app.report.cell_data import gather_cell_data, pack, page_templates
from calcidem.app.report.sections import PAGE_SECTIONS, TABLES, Data, SectionPlan, make_or_explain
from calcidem.app.report.tables import Table
from calcidem.input_file import open_input
from calcidem.storage.errors import OutputRefusedError
from calcidem.storage.files import spreadsheet_value, write_text_atomically
from calcidem.storage.netcdf import write_netcdf
from calcidem.storage.sql.store import Store, read_campaign
from calcidem.wording import ABSENT, decimal, duration, pluralize, tell

_MEANINGS: Mapping[str, str] = {
    "content": "Mass of calcite over mass of sand.",
    "n": "Number of samples with a velocity.",
    "standard deviation": "Scatter of Vs between samples that differ in the places of their cement only.",
    "reading error": "Part of the scatter that comes from reading the arrivals, and not from the samples. Near the "
    "standard deviation or above, it is an upper estimate, and the deviation says little of the samples.",
    "95 % of new samples": "Range that contains 95 of 100 further samples, if Vs is normally distributed.",
    "skewness": "Asymmetry of the distribution: 0 if it is symmetric, positive if fast samples lie far out.",
    "kurtosis": "Weight of the tails: 3 for a normal distribution.",
    "p, normal": "Probability of such skewness and kurtosis if Vs is normally distributed.",
    "missing": "Cells that are not computed yet.",
    "failed": "Cells that were computed and gave no velocity.",
    "G0": "Shear modulus at small strain: density of the soil times effective_vs squared.",
    "wavelengths on the path": "Distance from transmitter to receiver over the wavelength Vs / f.",
    "wavelength / d50": "Wavelength over the median diameter of the grains.",
    "calcite by Eq. 2": "Calcite content of the cemented contacts by the paper's Eq. 2, each counted once.",
    "static speed": "Speed of very long shear waves, from the stiffness of the sample at rest.",
    "with Vs, all contents": "Pearson's correlation: 1 or -1 on a straight line, 0 if they are unrelated.",
    "Spearman": "Correlation of the ranks, which does not assume a straight line.",
    "p, corrected": "Probability that one of the features correlates so well if none is related to Vs.",
    "residual deviation": "Scatter of Vs about the law.",
    "coverage": "Share of samples that lie in the 95 % interval predicted for them.",
    "step / limit": "Time step over the largest one at which the computation is stable.",
    "standard error of the mean": "Uncertainty of the mean of Vs, which falls with the number of samples.",
    "mean effective_vs": "Velocity of the damped wave that fits a section, mean over the samples.",
    "coordination number": "Mean number of contacts of a grain.",
    "unbalanced-force ratio": "Mean net force on a grain over the mean contact force; near 0 at rest.",
    "porosity": "Area of the voids over area of the box.",
}
"""Meanings by words in headers and first columns, without units."""


@dataclass(frozen=True, slots=True)
class _Picture:
    """Figure in a page."""

    entry: FigureEntry[Any]
    """Its name, title and caption."""
    source: str = ""
    """Picture: a data URI, or the contents of the block `packed`; empty without one."""
    inches: float = 0.0
    ratio: float = 1.0
    """Width for which the size of its letters was chosen, and width over height."""
    reason: str = ""
    """Reason for a missing picture."""

    @property
    def packed(self) -> str:
        """Name of the page's block with its compressed data; empty for a data URI."""
        return f"picture-{self.entry.name}" if self.source and not self.entry.pictorial else ""


@dataclass(frozen=True, slots=True)
class _PageSection:
    """Part of the page."""

    anchor: str
    title: str
    """Name in links, and heading."""
    text: tuple[str, ...] = ()
    """Paragraphs."""
    tables: tuple[Table, ...] = ()
    pictures: tuple[_Picture, ...] = ()
    """In the order of display, tables after pictures."""
    folded: tuple[Table, ...] = ()
    """Tables that open on a click."""


def write_report(  # noqa: PLR0913 - all but two have names in every call
    database: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    campaign_name: str | None = None,
    studies: Mapping[str, xr.Dataset] | None = None,
    files: str | os.PathLike[str] | None = None,
    figures: Sequence[str] = (),
    measured: tuple[Target, ...] = (),
    watch: Callable[[int, int], None] = lambda _, __: None,
) -> Path:
    """Write the report of a campaign as one HTML file, replaced only when the new one is complete; return its path.

    A run may write the database meanwhile. Results of `calcidem.app.studies.sensitivity`, named "frequency"
    and "damping", are included. ``files`` is a folder for figures, tables and numbers; ``figures`` names those of
    `CAMPAIGN_FIGURES` to write there, by default all. Laboratory velocities are
    drawn in figures of Vs, with a table of the misfit. After each section ``watch`` receives the numbers of finished
    and of all parts; the last part is the cells. `StoreError` if the database cannot be read, `OSError` if the file
    cannot be written.
    """
    target = Path(out)
    with read_campaign(database, campaign_name) as store:
        # Paths are analysed for the samples of the first seeds; 5,000 take a minute.
        analysis = CampaignAnalysis(store, 5000, with_patterns, installed_features(), measured)
        write_text_atomically(target, _render_page(analysis, studies or {}, watch))
        if files is not None:
            count = pluralize(len(figures or CAMPAIGN_FIGURES), "figure")
            choice = "" if figures else "; 'calcidem report --figure NAME' chooses"
            tell(f"Drawing {count} in three formats, 2 to 5 s for each{choice}.")
            _write_files(analysis, files, figures)
    return target


def unnamed_page(store: Store) -> Path:
    """Return the default page of a campaign: beside its database, or in the present folder for a server.

    `OutputRefusedError` if a file of that name is not a report of this campaign.
    """
    database = store.address.path
    page = Path(f"{Path(store.record.name).name}.html") if database is None else database.with_suffix(".html")
    if page.exists():
        with open_input(page) as file:
            head = file.read(50_000)  # style and head
        if _identity(store).encode() not in head:
            raise OutputRefusedError(f"{page} is not a report of this campaign.", "Give another name with --out.")
    return page


def _identity(store: Store) -> str:
    """Text in the head of a page that identifies its campaign."""
    return f"campaign {store.record.hash[:16]}"


def _render_page(
    analysis: CampaignAnalysis, studies: Mapping[str, xr.Dataset], watch: Callable[[int, int], None]
) -> str:
    """Return the page as text."""
    sections: list[_PageSection] = []
    parts = len(PAGE_SECTIONS) + 1
    for plan in PAGE_SECTIONS:
        watch(len(sections), parts)
        sections.append(_make_section(plan, analysis))
    watch(len(sections), parts)
    drawn = tuple(_draw_picture(entry, studies[entry.study]) for entry in STUDY_FIGURES if entry.study in studies)
    sections.append(_PageSection("sensitivity", "Sensitivity", pictures=drawn))
    shown = [section for section in sections if section.tables or section.pictures or section.folded]
    pictures = [picture for section in shown for picture in section.pictures]
    # A page of 3 MB loads in a second. Tables, style and script take 0.2 MB. Cells get as much beside many pictures.
    room = max(200_000, 3_000_000 - 200_000 - sum(len(picture.source) for picture in pictures))
    record, (blocks, remarks) = analysis.store.record, gather_cell_data(analysis, room)
    template = page_templates("calcidem.app.report").get_template("report.html")
    return template.render(
        name=record.name,
        identity=_identity(analysis.store),
        written=f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        facts=_key_facts(analysis),
        blocks=blocks | {picture.packed: picture.source for picture in pictures if picture.packed},
        remarks=remarks,
        sections=shown,
        explained_terms=_explained_terms,
    )


def _key_facts(analysis: CampaignAnalysis) -> tuple[tuple[str, str], ...]:
    """Return the key numbers of the campaign."""
    rows, (error, parts) = analysis.distributions, analysis.budget.texts
    done, failed = sum(row.vs.n for row in rows), sum(row.failed for row in rows)
    missing = sum(row.missing for row in rows)
    means = [row.vs.mean for row in rows if row.vs.n]
    seconds = float(np.nansum(analysis.cells["seconds"].to_numpy()))
    span = f"{decimal(min(means))} to {decimal(max(means))} m/s" if means else "none"
    return (
        ("distinct samples measured", f"{done} of {done + failed + missing}"),
        ("without velocity", str(failed)),
        ("not computed yet", str(missing)),
        ("contents and seeds", f"{analysis.vs.sizes['content']} \N{MULTIPLICATION SIGN} {analysis.vs.sizes['seed']}"),
        ("mean Vs", span),
        (f"standard error of Vs ({parts})", error),
        ("velocities that depend on the pulse", f"{analysis.budget.loud}"),
        ("computing time of the cells", duration(seconds)),
    )


def _make_section(plan: SectionPlan, analysis: CampaignAnalysis) -> _PageSection:
    """Make the tables and figures of a section for which the campaign has data."""
    remarks = _velocity_remarks(analysis) if plan.anchor == "velocities" else []
    read, planned = len(analysis.analysed_seeds), analysis.vs.sizes["seed"]
    if plan.anchor == "paths" and read < planned:
        remarks.append(f"Samples of {read:,} of {planned:,} seeds are analysed here.")
    tables: dict[str, Table] = {}
    for name in (*plan.tables, *plan.folded):
        table, reason = make_or_explain(TABLES[name], analysis)
        if table:
            tables[name] = table
        if reason:
            remarks.append(f"A table ({name}) is left out: {reason}.")
    entries = {entry.name: entry for entry in CAMPAIGN_FIGURES}
    return _PageSection(
        plan.anchor,
        plan.title,
        tuple(remarks),
        tables=tuple(tables[name] for name in plan.tables if name in tables),
        pictures=tuple(_draw_picture(entries[name], analysis) for name in plan.figures),
        folded=tuple(tables[name] for name in plan.folded if name in tables),
    )


def _velocity_remarks(analysis: CampaignAnalysis) -> list[str]:
    """Return remarks on few samples and missing cement, and the advice on the velocities."""
    remarks = []
    measured = [row.vs.n for row in analysis.distributions if row.vs.n and row.content > 0]
    if measured and min(measured) < 30:  # of these the moments have little meaning
        remarks.append(
            f"With only {min(measured)} samples at a content, skewness and kurtosis have wide errors, and a test that "
            "does not reject normality is weak."
        )
    if any(row.content == 0 for row in analysis.distributions) and analysis.vs.sizes["seed"] > 1:
        remarks.append(
            "Without cement all seeds are the same sample. It counts once, and its interval is that of its error."
        )
    return remarks + notes_on(analysis.store.table(NOTE_QUANTITIES))


def _draw_picture(entry: FigureEntry[Data], data: Data) -> _Picture:
    """Draw a figure for a self-contained page, grains as pixels, curves as compressed vectors; or say why it is not."""
    figure, reason = make_or_explain(entry.draw, data)
    if figure is None:
        return _Picture(entry, reason=reason)
    if entry.pictorial:
        source = f"data:image/png;base64,{b64encode(render(figure, 'png', colours=256)).decode()}"
    else:
        source = pack(render(figure, "svg"))
    ratio = round(figure.get_figwidth() / figure.get_figheight(), 4)
    return _Picture(entry, source, figure.get_figwidth(), ratio)


def _explained_terms(table: Table) -> tuple[tuple[str, str], ...]:
    """Return the terms in header and first column of a table, with their meanings."""
    words = (*table.header, *(row[0] for row in table.rows))
    found = dict.fromkeys(word.partition(" (")[0] for word in words)
    return tuple((word, _MEANINGS[word]) for word in found if word in _MEANINGS)


def _as_numbers(table: Table) -> list[list[str]]:
    """Header and rows for programs: bare numbers, ends of intervals in columns of their own, empty if missing."""
    number, signs = r"(-?\d+(?:\.\d+)?(?:e-?\d+)?)", str.maketrans("\N{MINUS SIGN}⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "--0123456789")
    forms = re.compile(rf"{number}(?: %)?|{number} \((?:{number} to {number}|{ABSENT})\)|{number} to {number}")
    columns: list[list[str]] = []
    for name, *texts in zip(table.header, *table.rows, strict=True):
        read = [forms.fullmatch(text.translate(signs).replace(" \N{MULTIPLICATION SIGN} 10", "e")) for text in texts]
        if not all(found or text in {ABSENT, f"{ABSENT} ({ABSENT})"} for found, text in zip(read, texts, strict=True)):
            columns.append([name, *("" if text == ABSENT else text for text in texts)])
            continue
        full = name + " (%)" * any(text.endswith(" %") for text in texts)
        for head, groups in ((full, (1, 2)), (f"{name}, low", (3, 5)), (f"{name}, high", (4, 6))):
            values = [next((found[group] for group in groups if found and found[group]), "") for found in read]
            if any(values) or (head == full and not any(read)):
                columns.append([head, *values])
    return [list(row) for row in zip(*columns, strict=True)]


def _write_files(
    analysis: CampaignAnalysis, out: str | os.PathLike[str], figures: Collection[str] = ()
) -> dict[str, str]:
    """Write the named figures (PNG, SVG, PDF), tables (table_*.csv) and numbers (NetCDF) of a campaign into a folder.

    Tables have rounded numbers as in the report; the NetCDF files have the exact ones.
    The folder is made if missing; files of these names are replaced or removed. Return reasons for omitted outputs by
    name. `OSError` if the folder cannot be written.
    """
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    chosen = [entry for entry in CAMPAIGN_FIGURES if not figures or entry.name in figures]
    exact: dict[str, Callable[[CampaignAnalysis], xr.Dataset]] = {
        "distributions": lambda analysis: tabulate(analysis.distributions),
        "features": lambda analysis: analysis.table,
        "correlations_overall": lambda analysis: correlate(analysis.table).overall,
        "correlations_within_content": lambda analysis: correlate(analysis.table).within,
    }
    files = [folder / f"{entry.name}.{ending}" for entry in chosen for ending in ("png", "svg", "pdf")]
    files += [*(folder / f"table_{name}.csv" for name in TABLES), *(folder / f"{name}.nc" for name in exact)]
    made = set[Path]()
    reasons: dict[str, str] = {}
    for entry in chosen:
        figure, reasons[entry.name] = make_or_explain(entry.draw, analysis)
        if figure is not None:
            made |= {*save(figure, folder, entry.name)}
    for name, make in TABLES.items():
        table, reasons[f"table_{name}"] = make_or_explain(make, analysis)
        if table is not None:
            made.add(file := folder / f"table_{name}.csv")
            with file.open("w", newline="", encoding="utf-8") as stream:
                csv.writer(stream).writerows(map(spreadsheet_value, row) for row in _as_numbers(table))
    for name, gather in exact.items():
        numbers, reasons[name] = make_or_explain(gather, analysis)
        if numbers is not None:
            made.add(file := folder / f"{name}.nc")
            write_netcdf(numbers, file)
    for file in set(files) - made:  # an earlier report may have had more
        file.unlink(missing_ok=True)
    tell(f"Wrote {len(made)} files to {folder}")
    return {name: reason for name, reason in reasons.items() if reason}
