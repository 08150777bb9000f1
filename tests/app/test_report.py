"""The report, the folder of figures and tables, and the closer look at one cell, from a small real campaign."""

import csv
import json
import re
import shutil
import sqlite3
import zlib
from base64 import b64decode
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from places import TUTORIAL

from calcidem.analysis.figures.registry import CAMPAIGN_FIGURES
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.cli.views import _vs_table
from calcidem.app.report import cell_data
from calcidem.app.report import page as page_of_report
from calcidem.app.report.cell_data import gather_cell_data
from calcidem.app.report.page import _MEANINGS, _as_numbers, _explained_terms, _write_files, unnamed_page, write_report
from calcidem.app.report.sections import (
    TABLES,
    _configuration_table,
    _parameter_table,
    _published_table,
    make_or_explain,
)
from calcidem.app.report.tables import Table, _outcome_table, _velocity_table, probability
from calcidem.app.studies.sensitivity import run_studies
from calcidem.ends import CellStatus
from calcidem.storage.errors import OutputRefusedError, UnknownCellError
from calcidem.storage.records import CellKey, CellResult, Selection
from calcidem.storage.sql.store import Store, read_campaign
from calcidem.wording import ABSENT, decimal, significant

pytestmark = pytest.mark.slow

ROOM = 10_000_000
"""Bytes that hold every cell of a small campaign."""

VOID = {"meta", "link", "img", "br", "input"}
"""A campaign on the published sand; the small one is on a sand of its own."""


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
    """All tags are closed, and every link and script is in the page itself: no file, no network."""
    reader = PageReader()
    reader.feed(page)
    assert reader.open == []
    for link in reader.links:
        assert link.startswith("data:") or link[1:] in reader.anchors


def test_page_has_every_figure_or_says_why_not(page: str) -> None:
    """Each figure of the registry is there, as a picture or with the reason for its absence."""
    for entry in CAMPAIGN_FIGURES:
        block = re.search(rf'<figure id="figure-{entry.name}">(.*?)</figure>', page, re.DOTALL)
        assert block
        assert "<img" in block[1] or "Not drawn: " in block[1]
    packed = set(re.findall(r'data-packed="([^"]+)"', page))
    assert page.count('src="data:image/') + len(packed) == len(CAMPAIGN_FIGURES)
    assert packed <= set(re.findall(r'<script type="application/octet-stream" id="([^"]+)"', page))


def test_a_page_without_a_name_replaces_the_report_of_its_campaign_alone(
    small_database: Path, small_report: Path, tmp_path: Path
) -> None:
    """It is named by the database and beside it; any other file of that name is refused."""
    database = Path(shutil.copy(small_database, tmp_path / "small-0.3mm.db"))
    page = tmp_path / "small-0.3mm.html"
    with read_campaign(database) as store:
        assert unnamed_page(store) == page
        shutil.copy(small_report, page)
        assert unnamed_page(store) == page
        page.write_text(page.read_text(encoding="utf-8").replace(store.record.hash[:16], "f" * 16), encoding="utf-8")
        with pytest.raises(OutputRefusedError, match=r"small-0\.3mm\.html is not a report of this campaign"):
            unnamed_page(store)


def test_missing_and_failed_cells_are_counted_apart(page: str, small_database: Path) -> None:
    """The cell that was not computed and the one that failed are in different columns, with the reason."""
    with open_campaign(small_database) as campaign:
        analysis = campaign.analyse()
        table, outcomes = _velocity_table(analysis), _outcome_table(analysis)
        failed = [row.failed for row in analysis.distributions if row.content in {0.34, 9.0}]
    rows = {row[0]: dict(zip(table.header, row, strict=True)) for row in table.rows}
    assert (rows["0.34"]["missing"], rows["0.34"]["failed"]) == ("1", str(failed[0]))
    assert (rows["9"]["missing"], rows["9"]["failed"]) == ("0", str(failed[1]))
    assert outcomes is not None
    assert ("failed", "the worker ran out of memory", "9", "1") in outcomes.rows
    assert "the worker ran out of memory" in page


def test_calibrated_parameters_are_named() -> None:
    """What differs from the published or the literal value is marked, what agrees is not."""
    with open_campaign(TUTORIAL) as campaign:
        table = _parameter_table(campaign.config)
    assert table is not None
    marked = {table.rows[place][0] for place in table.marked}
    assert {"sand.wave_stiffness_factor", "pattern.p_share", "wave.amplitude"} <= marked
    assert not {"sand.shear_modulus", "wave.damping", "packing.stress", "packing.width"} & marked


def test_a_frequency_that_chose_itself_is_given_with_its_values() -> None:
    """Of each content that has a cell."""
    frequency = (("seed", "content"), [[np.nan, 69e3, np.nan], [np.nan, 69e3, 130e3]])
    cells = xr.Dataset({"frequency": frequency}, {"content": [0.0, 0.5, 3.0]})
    analysis = SimpleNamespace(config={"wave": {"frequency": "auto", "damping": 0.3}}, cells=cells)
    assert _configuration_table(analysis).rows[0] == ("wave.frequency", "auto: 69 kHz at 0.5 %, 130 kHz at 3 %")  # type: ignore[arg-type]


def test_another_sand_is_not_held_beside_the_paper(page: str, small_database: Path) -> None:
    """A sand in a box of its own has no row, column or remark about what was published."""
    assert "published" not in re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL).lower()
    with open_campaign(small_database) as campaign:
        analysis = campaign.analyse()
        assert _parameter_table(campaign.config) is None
        assert _published_table(analysis) is None


def test_cell_data_give_back_what_is_stored(small_database: Path) -> None:
    """Signals to a step of the screen, arrivals, paths and every cemented contact come back from the page's blocks."""
    with open_campaign(small_database) as campaign:
        analysis = campaign.analyse()
        blocks = gather_cell_data(analysis, ROOM)[0]
        done = list(campaign.select(status="done", with_arrays=True))
        cell = max(done, key=lambda cell: cell.key.content)
        seed_number, content = cell.key.seed, cell.key.content
        graph, path = analysis.graphs[0], analysis.sample(seed_number, content).path.grains
    seed, packing, records = (
        json.loads(zlib.decompress(b64decode(blocks[name]))) for name in (f"seed-{seed_number}", "packing-0", "records")
    )
    assert cell.section is not None
    assert cell.cement is not None
    place = [described["content"] for described in seed].index(content)
    described, kinds = seed[place], np.zeros(len(packing["second"]), dtype=np.uint8)
    for earlier in seed[: place + 1]:
        for kind, rows in enumerate(earlier["cement"]):
            kinds[np.cumsum(rows, dtype=int)] = kind
    assert np.array_equal(kinds, graph.kinds(cell.cement))
    assert tuple(np.cumsum(described["path"])) == path
    assert np.array_equal(np.cumsum(packing["first"]), graph.graph.pairs[:, 0])
    received = described["signal"]["received"]
    values = np.cumsum(received["steps"]) / 2000 * received["largest"]
    stride = round(described["signal"]["interval"] / (1e3 * cell.section.sampling_interval))
    assert np.allclose(values, cell.section.received[::stride], atol=1e-3 * received["largest"])
    vs = records["columns"]["vs"][
        records["seeds"].index(str(seed_number)) * len(records["contents"]) + records["contents"].index(content)
    ]
    assert vs == pytest.approx(cell.vs, rel=1e-5)


def test_whole_numbers_keep_all_digits_in_the_page() -> None:
    """A number of steps is a count; other numbers have six digits, and missing ones are none."""
    given = np.array([1234567.0, 1234567.5, np.nan, 0.12345678])
    assert cell_data.numbers_or_none(given) == [1234567.0, 1234570.0, None, 0.123457]


def test_the_section_in_the_page_is_the_one_that_was_read(small_database: Path) -> None:
    """Traces come back to a step of the drawing, and the marked peak has the travel time of the stored velocity."""
    with open_campaign(small_database) as campaign:
        analysis = campaign.analyse()
        blocks = gather_cell_data(analysis, ROOM)[0]
        cell = next(cell for cell in campaign.select(status="done", with_arrays=True) if cell.section is not None)
    assert cell.section is not None
    sections = json.loads(zlib.decompress(b64decode(blocks[f"sections-{cell.key.seed}"])))
    found = next(one for one in sections if one["content"] == cell.key.content)
    (chosen,) = [peak for peak in found["peaks"] if peak[1]]
    assert chosen[0] / 1e3 == pytest.approx(cell.distance / cell.vs_peak, rel=1e-4)
    assert found["coherence"] == cell.coherence
    trace = np.cumsum(found["traces"][-1])
    at = 1e-3 * (found["start"] + found["interval"] * np.arange(len(trace)))
    received = np.interp(at, cell.section.time, cell.section.received)
    assert np.abs(trace).max() == found["levels"]
    assert np.corrcoef(trace, received)[0, 1] > 0.95  # at the times of the drawing
    assert max(len(text) for name, text in blocks.items() if name.startswith("sections-")) < 6 * 3000


def test_sections_end_where_the_page_is_full(small_database: Path) -> None:
    """What is left of the page is for sections: later seeds have none, and the page says where they are drawn."""
    with open_campaign(small_database) as campaign:
        analysis = campaign.analyse()
        whole = gather_cell_data(analysis, ROOM)[0]
        sections = [name for name in whole if name.startswith("sections-")]
        room = sum(map(len, whole.values())) - len(whole[sections[-1]])
        blocks, remarks = gather_cell_data(analysis, room)
    assert list(blocks) == [name for name in whole if name != sections[-1]]
    assert f"Space-time sections of {len(sections) - 1} of {analysis.vs.sizes['seed']} seeds" in remarks[-1]


def test_large_campaigns_leave_out_what_a_page_cannot_hold(
    small_database: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond the limits a page has fewer quantities and samples of fewer seeds, and says so."""
    monkeypatch.setattr(cell_data, "MOST_FULL_RECORDS", 10)
    with open_campaign(small_database) as campaign:
        analysis = campaign.analyse()
        whole = gather_cell_data(analysis, ROOM)[0]
        always = sum(len(text) for name, text in whole.items() if not name.startswith(("seed-", "sections-")))
        room = always + len(whole["seed-1"]) + len(whole["seed-2"])
        blocks, remarks = gather_cell_data(analysis, room)
        analysis = campaign.analyse(most_samples=12)
        assert {sample.seed for sample in analysis.samples} == set(analysis.analysed_seeds) == {1, 2}
    assert [name for name in blocks if name.startswith("seed-")] == ["seed-1", "seed-2"]
    assert sum(map(len, blocks.values())) <= room
    assert remarks[0].startswith("Of each of the 36 cells only 6 quantities")
    assert remarks[1].startswith("Signals and samples of 2 of 6 seeds")


def test_published_table_stands_beside_the_published_sand() -> None:
    """The tutorial's contents have published rows."""
    with open_campaign(TUTORIAL) as campaign:
        table = _published_table(campaign.analyse())
    assert table is not None
    assert [row[0] for row in table.rows] == ["0.66", "2.55", "5", "9"]


def test_no_modulus_is_given_where_the_pulse_changes_the_velocity(tmp_path: Path) -> None:
    """Also of a content of which every Vs is unread, but not the effective velocity."""
    database = Path(shutil.copy(TUTORIAL, tmp_path / "loud.db"))
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute(
            "UPDATE result SET status = 'no_arrival', vs = NULL, wavelengths_on_path = NULL, "
            "wavelength_over_d50 = NULL, pulse_effect = 0.15 WHERE cell_id IN (SELECT id FROM cell WHERE content = 5)"
        )
    with open_campaign(database) as campaign:
        contents = campaign.analyse().vs["content"].to_numpy().tolist()
        meaning, both = (TABLES[name](campaign.analyse()) for name in ("meaning", "two_velocities"))
        terminal = {str(column.header): list(column.cells) for column in _vs_table(campaign.store, Selection()).columns}
    assert meaning is not None
    assert both is not None
    moduli = [row[meaning.header.index("G0 (MPa)")] for row in meaning.rows]
    of_terminal = [terminal[name] for name in ("effective mean m/s", "G0 MPa")]
    for content, modulus, velocity, shown in zip(contents, moduli, *of_terminal, strict=True):
        assert (modulus == ABSENT, shown == "-", velocity == "-") == (content == 5.0, content == 5.0, False)
    assert contents.index(5.0) in both.marked


def test_the_sample_without_cement_has_the_time_of_the_seed_that_was_computed() -> None:
    """Which need not be the first."""
    with open_campaign(TUTORIAL) as campaign:
        analysis = campaign.analyse()
        vars(analysis)["cells"] = analysis.cells.copy(deep=True)
        analysis.cells["seconds"].loc[{"content": 0.0}] = np.where(analysis.cells["seed"] == 2, 7.5, np.nan)
        table = TABLES["errors_and_cost"](analysis)
    assert table is not None
    assert dict(zip(table.header, table.rows[0], strict=True))["time for a cell (s)"] == "7.5"


def test_a_coefficient_without_an_interval_has_one_dash_for_it() -> None:
    """As other values have; the file for programs then has the bare number."""
    with open_campaign(TUTORIAL) as campaign:
        analysis = campaign.analyse()
        vars(analysis)["table"] = analysis.table.isel(seed=[0, 1])  # too few for an interval
        table = TABLES["features"](analysis)
    assert table is not None
    texts = [row[table.header.index("with Vs, within one content")] for row in table.rows]
    assert {text.partition(" ")[2] for text in texts} == {f"({ABSENT})"}
    header, *rows = _as_numbers(table)
    assert all(row[header.index("with Vs, within one content")].replace(".", "").lstrip("-").isdigit() for row in rows)


def test_studies_are_shown_when_given(small_database: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The report has the figures of the studies that it is given."""
    monkeypatch.setattr(page_of_report, "PAGE_SECTIONS", ())  # the other figures need not be drawn again
    studies = run_studies(small_database, ["damping"], contents=[0.66])
    text = write_report(small_database, tmp_path / "r.html", studies=studies).read_text(encoding="utf-8")
    assert '<figure id="figure-study_damping">' in text
    assert '<figure id="figure-study_reading">' not in text
    with pytest.raises(ValueError, match="study 'colour' does not exist"):
        run_studies(small_database, ["colour"])


def test_a_folder_has_figures_tables_and_numbers(
    small_database: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder has three files for each figure, tables that can be read, the exact numbers, and what is not ours."""
    told: list[str] = []
    monkeypatch.setattr("calcidem.app.report.page.tell", told.append)
    for name in ("table_measured.csv", "notes.txt"):
        (tmp_path / "out").mkdir(exist_ok=True)
        (tmp_path / "out" / name).write_text("of an earlier report", encoding="utf-8")
    monkeypatch.setattr("calcidem.app.report.page.CAMPAIGN_FIGURES", CAMPAIGN_FIGURES[::14])  # all take long
    with open_campaign(small_database) as campaign:
        left_out = _write_files(campaign.analyse(), folder := tmp_path / "out")
    assert not (folder / "table_measured.csv").exists(), "nothing is measured here"
    assert (folder / "notes.txt").exists()
    assert told == [f"Wrote {len(list(folder.iterdir())) - 1} files to {folder}"]
    for entry in CAMPAIGN_FIGURES[::14]:
        written = {file.suffix for file in folder.glob(f"{entry.name}.*")}
        assert written == (set() if entry.name in left_out else {".png", ".svg", ".pdf"})
    with (folder / "table_velocities.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["content (%)"] for row in rows] == ["0", "0.34", "0.66", "2.55", "5", "9"]
    assert min(float(row["skewness"]) for row in rows[1:]) < 0.0  # with the minus that programs read
    assert not rows[0]["skewness"]  # all samples of 0 % are the same
    row = rows[2]
    assert float(row["mean (m/s), low"]) < float(row["mean (m/s)"]) < float(row["mean (m/s), high"])
    assert float(row["95 % of new samples (m/s), low"]) < float(row["95 % of new samples (m/s), high"])
    with (
        xr.open_dataset(folder / "distributions.nc") as numbers,
        open_campaign(small_database) as campaign,
    ):
        assert float(numbers["mean"].sel(content=0.66)) == pytest.approx(
            float(campaign.vs().sel(content=0.66).mean()), rel=1e-14
        )


def test_numbers_of_tables_are_bare_for_programs() -> None:
    """Intervals have columns of their own, minus signs and powers are those of programs; texts stay as they are."""
    rows = (
        ("5", "\N{MINUS SIGN}42 (\N{MINUS SIGN}50 to 13)", "1.2 \N{MULTIPLICATION SIGN} 10⁻⁵", "7 %", "m²"),
        ("9", f"{ABSENT} ({ABSENT})", "3", ABSENT, "5"),
    )
    assert _as_numbers(Table("", ("content (%)", "mean", "p", "share", "text"), rows)) == [
        ["content (%)", "mean", "mean, low", "mean, high", "p", "share (%)", "text"],
        ["5", "-42", "-50", "13", "1.2e-5", "7", "m²"],
        ["9", "", "", "", "3", "", "5"],
    ]


def test_no_table_of_the_folder_holds_a_formula(
    small_database: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reason and a host that a spreadsheet would evaluate begin with an apostrophe in CSV; numbers do not."""
    monkeypatch.setattr("calcidem.app.report.page.CAMPAIGN_FIGURES", ())  # pictures take seconds
    formulas = "=cmd|' /C calc'!A0", "@SUM(1)"
    database = Path(shutil.copy(small_database, tmp_path / "small.db"))
    with Store(database) as store:
        store.use_campaign()
        store.begin_run(replace(store.runs()[0][1], host=formulas[1]))
        store.record_results([CellResult(CellKey(6, 0.34), CellStatus.FAILED, formulas[0])])
    with open_campaign(database) as campaign:
        _write_files(campaign.analyse(), tmp_path / "analysis")
    tables = sorted((tmp_path / "analysis").glob("table_*.csv"))
    values = [value for file in tables for row in csv.reader(file.open(encoding="utf-8")) for value in row]
    assert {f"'{formulas[0]}"} == {value for value in values if formulas[0] in value}
    assert {value[:1] for value in values if formulas[1] in value} == {"'"}
    assert not [value for value in values if value.startswith(("=", "+", "@"))]


def test_one_cell_is_shown_with_its_pictures(small_database: Path, tmp_path: Path, invoke: Callable[..., str]) -> None:
    """A cell is described by its quantities and drawn with cement, path, signals and section."""
    told = invoke("show", small_database, "--seed", 1, "--content", 0.66, "--out", tmp_path / "cell")
    assert re.search("outcome of the cell +done", told)
    assert {file.name for file in (tmp_path / "cell").glob("*.png")} == {
        f"seed1_content0.66_{part}.png" for part in ("cement", "path", "signals", "section")
    }
    with pytest.raises(UnknownCellError):
        invoke("show", small_database, "--seed", 6, "--content", 0.34)


def test_failed_cell_is_shown_without_pictures(
    small_database: Path, tmp_path: Path, invoke: Callable[..., str]
) -> None:
    """A cell without cement and signal is described by its reason."""
    told = invoke("show", small_database, "--seed", 6, "--content", 9, "--out", tmp_path / "cell")
    assert re.search("why the outcome is what it is +the worker ran out of memory", told)
    assert not (tmp_path / "cell").exists()


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
    """Missing numbers are dashes, and a p-value has two digits."""
    assert decimal(float("nan")) == "\N{EN DASH}"
    assert decimal(-3.14159, 2) == "\N{MINUS SIGN}3.14"
    assert (probability(1e-9), probability(0.0471)) == ("< 0.001", "0.047")


def test_words_are_explained_where_they_stand(small_report: Path) -> None:
    """Each explained word is one of a table, and stands with its meaning below that table."""
    with open_campaign(TUTORIAL) as campaign:
        tables = [make_or_explain(make, campaign.analyse())[0] for make in TABLES.values()]
    explained = {word for table in tables if table is not None for word, _ in _explained_terms(table)}
    assert explained | {"static speed"} == set(_MEANINGS)  # a column that only some campaigns have
    text = small_report.read_text(encoding="utf-8")
    assert f"<dt>skewness</dt><dd>{_MEANINGS['skewness']}</dd>" in text
