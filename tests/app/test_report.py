"""The report, the folder of figures and tables, and the closer look at one cell, from a small real campaign."""

import csv
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
import xarray as xr

from calcidem.analysis.campaign_analysis import CampaignAnalysis
from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES
from calcidem.app.report import show_cell, write_report
from calcidem.app.report.comparison import disagreement_table, published_table
from calcidem.app.report.provenance import parameter_table
from calcidem.app.report.results import outcome_table, velocity_table
from calcidem.app.report.wording import decimal, probability, significant, time_span
from calcidem.app.studies.frequency_and_damping import run_studies
from calcidem.storage.campaign import open_stored_campaign
from calcidem.storage.errors import UnknownCellError

pytestmark = pytest.mark.slow

VOID = {"meta", "link", "img", "br"}


class PageReader(HTMLParser):
    """Gathers tags and links of a page, and complains about tags that are not closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.links: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note a tag."""
        self.tags.append(tag)
        for name, value in attrs:
            if name in {"src", "href"}:
                self.links.append(value or "")
            if name == "id":
                assert value not in self.anchors, f"{value} is there twice"
                self.anchors.add(value or "")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """Check that a tag closes the last one opened."""
        assert self.open.pop() == tag


@pytest.fixture
def page(small_report: Path) -> str:
    """Text of the report of the small campaign."""
    return small_report.read_text(encoding="utf-8")


def test_page_is_well_formed_and_needs_nothing_else(page: str) -> None:
    """All tags are closed, and every link leads into the page itself: no script, no file, no network."""
    reader = PageReader()
    reader.feed(page)
    assert reader.open == []
    assert "script" not in reader.tags
    for link in reader.links:
        assert link.startswith("data:") or link[1:] in reader.anchors


def test_page_has_every_figure_or_says_why_not(page: str) -> None:
    """Each figure of the registry is there, as a picture or with the reason for its absence."""
    for entry in CAMPAIGN_FIGURES:
        block = re.search(rf'<figure id="figure-{entry.name}">(.*?)</figure>', page, re.DOTALL)
        assert block
        assert 'src="data:image/' in block[1] or "Not drawn: " in block[1]
    assert page.count('src="data:image/') == len(CAMPAIGN_FIGURES)


def test_missing_and_failed_cells_are_counted_apart(page: str, small_database: Path) -> None:
    """The cell that was not computed and the one that failed are in different columns, with the reason."""
    with open_stored_campaign(small_database) as campaign:
        analysis = CampaignAnalysis(campaign)
        table, outcomes = velocity_table(analysis), outcome_table(analysis)
        failed = analysis.outcomes["failed"].sel(content=9.0).item()
    rows = {row[0]: dict(zip(table.header, row, strict=True)) for row in table.rows}
    assert (rows["0.34"]["missing"], rows["0.34"]["failed"]) == ("1", "0")
    assert (rows["9"]["missing"], rows["9"]["failed"]) == ("0", str(failed))
    assert outcomes is not None
    assert ("failed", "the worker ran out of memory", "9", "1") in outcomes.rows
    assert "the worker ran out of memory" in page


def test_calibrated_parameters_are_named(small_database: Path) -> None:
    """What differs from the published or the literal value is marked, what agrees is not."""
    with open_stored_campaign(small_database) as campaign:
        table = parameter_table(campaign.config)
    marked = {table.rows[place][0] for place in table.marked}
    assert {"sand.wave_stiffness_factor", "pattern.p_share", "wave.amplitude", "packing.width"} <= marked
    assert not {"sand.shear_modulus", "wave.damping", "pattern.cluster_area"} & marked


def test_published_table_shows_disagreeing_verdicts(small_database: Path) -> None:
    """At 0.34 % the published verdict and the one from the published moments differ, and both are shown."""
    with open_stored_campaign(small_database) as campaign:
        table = published_table(CampaignAnalysis(campaign))
    assert table is not None
    row = dict(zip(table.header[6:], next(row for row in table.rows if row[0] == "0.34")[6:], strict=True))
    assert row["printed as normal"] == "yes"
    assert row["normal by printed moments"].startswith("no")
    assert any("Table 3, 0.34 %" in finding[0] for finding in disagreement_table().rows)


def test_studies_are_shown_when_given(small_database: Path, tmp_path: Path) -> None:
    """The report has the figures of the studies that it is given."""
    studies = run_studies(small_database, ["damping"], contents=[0.66])
    text = write_report(small_database, tmp_path / "r.html", studies=studies).read_text(encoding="utf-8")
    assert '<figure id="figure-study_damping">' in text
    assert '<figure id="figure-study_reading">' not in text
    with pytest.raises(ValueError, match="study 'colour' does not exist"):
        run_studies(small_database, ["colour"])


def test_analyse_writes_figures_tables_and_numbers(
    small_database: Path, small_folder: tuple[Path, dict[str, str]]
) -> None:
    """The folder has three files for each figure, tables that can be read, and the exact numbers."""
    folder, left_out = small_folder
    for entry in CAMPAIGN_FIGURES:
        written = {file.suffix for file in folder.glob(f"{entry.name}.*")}
        assert written == (set() if entry.name in left_out else {".png", ".svg", ".pdf"})
    with (folder / "table_velocities.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["content (%)"] for row in rows] == ["0", "0.34", "0.66", "2.55", "5", "9"]
    with (
        xr.open_dataset(folder / "distributions.nc") as numbers,
        open_stored_campaign(small_database) as campaign,
    ):
        assert float(numbers["mean"].sel(content=0.66)) == pytest.approx(
            float(campaign.vs().sel(content=0.66).mean()), rel=1e-14
        )


def test_one_cell_is_shown_with_its_pictures(small_database: Path, tmp_path: Path) -> None:
    """A cell is described by its quantities and drawn with cement, path and signals."""
    table, files = show_cell(small_database, 1, 0.66, tmp_path)
    assert dict(table.rows)["outcome of the cell"] == "done"
    assert {file.name for file in files if file.suffix == ".png"} == {
        f"seed1_content0.66_{part}.png" for part in ("cement", "path", "signals")
    }
    with pytest.raises(UnknownCellError):
        show_cell(small_database, 6, 0.34)


def test_failed_cell_is_shown_without_pictures(small_database: Path, tmp_path: Path) -> None:
    """A cell without cement and signal is described by its reason."""
    table, files = show_cell(small_database, 6, 9.0, tmp_path)
    assert ("why the outcome is what it is", "the worker ran out of memory") in table.rows
    assert files == []


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1190.0, "1190"),
        (6.5e11, "6.5 \N{MULTIPLICATION SIGN} 10¹¹"),
        (3.6e-6, "3.6 \N{MULTIPLICATION SIGN} 10⁻⁶"),
        (-0.25, "\N{MINUS SIGN}0.25"),
        (0.0, "0"),
        (123456.0, "1.23 \N{MULTIPLICATION SIGN} 10⁵"),
        (None, "\N{EN DASH}"),
    ],
)
def test_numbers_are_written_with_significant_digits(value: float | None, text: str) -> None:
    """Three significant digits, with a power of ten only where a plain number would be hard to read."""
    assert significant(value) == text


def test_words_for_numbers() -> None:
    """Missing numbers are dashes, times have the unit that suits them."""
    assert decimal(float("nan")) == "\N{EN DASH}"
    assert decimal(-3.14159, 2) == "\N{MINUS SIGN}3.14"
    assert (time_span(5.0), time_span(90.0), time_span(7200.0)) == ("5 s", "1.5 min", "2.0 h")
    assert (probability(1e-9), probability(0.0471)) == ("< 0.001", "0.047")
