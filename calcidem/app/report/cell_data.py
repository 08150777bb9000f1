"""Data of single cells for the page: records, signals, cement patterns and paths, compressed."""

import json
import zlib
from base64 import b64encode
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import groupby
from typing import Any

import numpy as np
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from numpy.typing import ArrayLike, NDArray

from calcidem.analysis.campaign_analysis import CampaignAnalysis, MeasuredSample, UnavailableError
from calcidem.analysis.figures.samples import read_arrival
from calcidem.analysis.packing_graph import PackingGraph
from calcidem.app.campaign.packing import section_of, section_reader
from calcidem.dem.wave.reading import Reading
from calcidem.storage.records import (
    ALL_CELLS,
    MOST_PULSE_EFFECT,
    NORMAL_95,
    NOT_PLANNED,
    QUANTITY_BY_NAME,
    CellResult,
    Selection,
)
from calcidem.wording import EXCEPTIONAL, readable_unit

MOST_FULL_RECORDS = 10_000
SHORT_RECORD = ("status", "reason", "vs", "vs_error", "path_normalized_connectivity", "seconds")
"""Quantities of a cell if the campaign has more cells than this."""


def gather_cell_data(analysis: CampaignAnalysis, room: int) -> tuple[dict[str, str], list[str]]:
    """Gather records of all cells, signals and samples of as many seeds as fit, and then sections likewise.

    Return compressed JSON in base64 by id of its element ("records", "packing-0", "seed-1", ...), and sentences about
    omitted data. All blocks together may take ``room`` bytes of the page; records and packings are always included.
    """
    blocks: dict[str, str] = {}
    remarks: list[str] = []
    try:
        graphs = analysis.graphs
    except UnavailableError as error:
        graphs = ()
        remarks.append(f"No samples are drawn: {error}.")
    names = [name for name in QUANTITY_BY_NAME if name not in {"seed", "content"}]
    if analysis.vs.size > MOST_FULL_RECORDS:
        names = [name for name in names if name in SHORT_RECORD]
        remarks.append(f"Of each of the {analysis.vs.size:,} cells only {len(names)} quantities are in this page.")
    blocks["records"] = _compress(_describe_records(analysis, names))
    for graph in graphs:
        blocks[f"packing-{graph.packing.index}"] = _compress(packing_block(analysis, graph))
    room -= sum(map(len, blocks.values()))
    shown: list[int] = []
    known: dict[tuple[int, float], MeasuredSample] = {}
    with suppress(UnavailableError):  # the cement of samples with analysed paths need not be drawn again
        known = {(sample.seed, sample.content): sample for sample in analysis.samples}
    strange: deque[CellResult] = deque()
    cemented = analysis.with_cement(analysis.store, iter(strange.popleft, None))  # prepared once, not for each seed

    def with_cement(cell: CellResult) -> CellResult:
        if (cell.key.seed, cell.key.content) in known:
            return cell
        strange.append(cell)
        return next(cemented)

    stored = analysis.store.results(ALL_CELLS, with_arrays=True)
    for seed, grouped in groupby(stored, lambda cell: cell.key.seed):
        cells = [with_cement(cell) for cell in grouped]
        text = _compress(list(describe_cells(analysis, cells, graphs, known)))
        if len(text) > room:
            break
        room -= len(text)
        blocks[f"seed-{seed}"] = text
        shown.append(seed)
    drawn, sections = _gather_sections(analysis, shown, room)
    blocks |= sections
    if len(shown) < analysis.vs.sizes["seed"]:
        remarks.append(
            f"Signals and samples of {len(shown)} of {analysis.vs.sizes['seed']:,} seeds are in this page; "
            "'calcidem show DB --seed S --content C --out DIR' draws every one."
        )
    if drawn < len(shown):
        those = (
            f"Space-time sections of {drawn} of {analysis.vs.sizes['seed']:,} seeds are"
            if drawn
            else "No space-time section is"
        )
        remarks.append(f"{those} in this page; 'calcidem show DB --seed S --content C --out DIR' draws every one.")
    return blocks, remarks


def _gather_sections(analysis: CampaignAnalysis, seeds: Sequence[int], room: int) -> tuple[int, dict[str, str]]:
    """Gather the sections of as many seeds as fit; return the number of seeds, and the blocks of their sections."""
    blocks: dict[str, str] = {}
    for drawn, seed in enumerate(seeds):
        sections = describe_sections(analysis, analysis.store.results(Selection(seed), with_arrays=("section",)))
        if sections:
            text = _compress(sections)
            room -= len(text)
            if room < 0:
                return drawn, blocks
            blocks[f"sections-{seed}"] = text
    return len(seeds), blocks


def _describe_records(analysis: CampaignAnalysis, names: list[str]) -> dict[str, Any]:
    """Return quantities as columns over seeds, then contents, without those that no cell has."""
    cells = analysis.cells.assign(status=analysis.status.where(analysis.status != NOT_PLANNED, ""))
    columns = {name: numbers_or_none(cells[name].to_numpy().ravel()) for name in names}
    shown = [
        name
        for name, values in columns.items()
        if any(value not in {None, ""} and (value or name not in EXCEPTIONAL) for value in values)
    ]
    return describe_axes(analysis.vs["seed"].to_numpy(), analysis.vs["content"].to_numpy(), shown) | {
        "columns": columns
    }


def describe_axes(seeds: NDArray[np.int64], contents: NDArray[np.float64], names: Collection[str]) -> dict[str, Any]:
    """Return the header of the records for the script: seeds as texts, contents (percent), and quantities."""
    return {
        "seeds": [str(seed) for seed in seeds.tolist()],  # JavaScript cannot hold a number of 63 bits exactly
        "contents": contents.tolist(),
        "quantities": [
            {"name": q.name, "kind": q.kind, "unit": readable_unit(q.unit), "meaning": q.meaning}
            for q in QUANTITY_BY_NAME.values()
            if q.name in names
        ],
        "normal95": NORMAL_95,
        "mostPulseEffect": MOST_PULSE_EFFECT,
    }


def numbers_or_none(values: NDArray[Any]) -> list[Any]:
    """Return numbers with six digits, whole ones unchanged, and None for missing ones."""
    if values.dtype.kind != "f":
        return [value or "" for value in values.tolist()]
    return [
        None if value != value else value if value.is_integer() else float(f"{value:.6g}")  # noqa: PLR0124 - NaN
        for value in values.tolist()
    ]


def packing_block(analysis: CampaignAnalysis, graph: PackingGraph) -> dict[str, Any]:
    """Return disks in micrometres, contacts by differences of their first grains, and the bands of the walls."""
    packing, wave = graph.packing, analysis.config["wave"]
    return {
        **{name: _rounded(getattr(packing, name) * 1e6) for name in ("x", "y", "radius")},
        **{name: float(getattr(packing, name) * 1e6) for name in ("width", "height")},
        "first": _steps(graph.graph.pairs[:, 0]),
        "second": graph.graph.pairs[:, 1].tolist(),
        "bands": [wave[f"{band}_half_width"] * 1e6 for band in ("transmitter", "receiver")],
    }


def describe_cells(
    analysis: CampaignAnalysis,
    cells: Iterable[CellResult],
    graphs: tuple[PackingGraph, ...],
    known: Mapping[tuple[int, float], MeasuredSample],
) -> Iterator[dict[str, Any]]:
    """Return signals, paths, and the changes of cemented contacts from cell to cell, which are few.

    For samples ``known`` by seed and content, cement and path are not computed again.
    """
    before: dict[int, NDArray[np.uint8]] = {}
    for cell in cells:
        described: dict[str, Any] = {"content": cell.key.content, "packing": cell.packing_index}
        if cell.section is not None:
            described["signal"] = _describe_signal(analysis, cell)
        sample = known.get((cell.key.seed, cell.key.content))
        graph = graphs[cell.packing_index] if cell.packing_index < len(graphs) else None
        kinds = sample.kinds if sample else graph.kinds(cell.cement) if graph and cell.cement else None
        if graph and kinds is not None:
            changed = kinds != before.get(cell.packing_index, np.zeros_like(kinds))
            before[cell.packing_index] = kinds
            described["cement"] = [_steps(np.flatnonzero(changed & (kinds == kind))) for kind in (0, 1, 2)]
            with suppress(ValueError):  # for samples without a path
                stored = tuple(cell.path.grains.tolist()) if cell.path else ()
                path = sample.path if sample else graph.path(kinds > 0, stored)
                described["path"] = _steps(path.grains)
        yield described


def describe_sections(analysis: CampaignAnalysis, cells: Iterable[CellResult]) -> list[dict[str, Any]]:
    """Return the motion across the path of the cells of one seed that have a section, and the peaks at the receiver.

    Motion is given as differences of levels at each place. Times are in milliseconds, places in millimetres. A peak has
    its travel time, and whether it is that which is read; the other is that of the fitted wave.
    """
    read, described = section_reader(analysis.store), []
    for cell in cells:
        if cell.section is None:
            continue
        section, found = section_of(cell.section), read(cell)
        motion = np.asarray(section.across, dtype=float)
        peaks: list[tuple[float, int]] = []
        if isinstance(found, Reading):
            peaks = [(section.distance / (found.wave.velocity * (1.0 + found.bias)), 0)]
            peaks += [(found.travel_time, 1)] if cell.vs_peak is not None else []
        stride, height = -(-len(motion) // 90), 40  # times and levels, finer than the drawing's lines
        traces = motion[::stride]
        largest = np.abs(traces).max(axis=0, initial=0.0)
        levels = np.rint(traces / np.where(largest > 0.0, largest, 1.0) * height).astype(int)
        described.append(
            {
                "content": cell.key.content,
                "start": round(1e3 * section.start_time, 6),
                "interval": float(f"{1e3 * stride * section.sampling_interval:.6g}"),
                "levels": height,
                "places": [round(1e3 * place, 2) for place in section.places],
                "traces": np.diff(levels, axis=0, prepend=0).T.tolist(),
                "begin": float(f"{0.5e3 / section.frequency:.6g}"),
                "coherence": cell.coherence,
                "peaks": [[float(f"{1e3 * travel:.5g}"), chosen] for travel, chosen in sorted(peaks)],
            }
        )
    return described


def _describe_signal(analysis: CampaignAnalysis, cell: CellResult) -> dict[str, Any]:
    """Return both signals as differences of levels, their peaks, and the arrivals in milliseconds."""
    arrival = read_arrival(analysis, cell)
    # 300 times and 2000 levels are finer than a screen's pixels. Records without a reading are long.
    stride = -(-arrival.time.size // (300 if cell.vs else 1500))
    described: dict[str, Any] = {
        "start": 1e3 * float(arrival.time[0]),
        "interval": 1e3 * stride * float(arrival.time[1] - arrival.time[0]),
        "unit": "m/s",
        "arrivals": {method: round(1e3 * arrival.arrival_time(method), 6) for method in arrival.velocities},
    }
    for name in ("transmitted", "received"):
        values = getattr(arrival, name)
        largest = float(np.abs(values).max()) or 1.0
        described[name] = {"largest": float(f"{largest:.4g}"), "steps": _steps(values[::stride] / largest * 2000)}
    return described


def _rounded(values: ArrayLike) -> list[int]:
    whole: list[int] = np.round(np.asarray(values, dtype=np.float64)).astype(np.int64).tolist()
    return whole


def _steps(values: ArrayLike) -> list[int]:
    """Return whole numbers as differences, which compress better."""
    return _rounded(np.diff(_rounded(values), prepend=0))


def _compress(described: object) -> str:
    """Return data for the page: JSON, deflated, in base64."""
    return pack(json.dumps(described, separators=(",", ":"), allow_nan=False).encode())


def page_templates(*packages: str) -> Environment:
    """Templates of the report and of the live page in these packages; an unknown name in one is an error."""
    return Environment(
        loader=ChoiceLoader([PackageLoader(package) for package in packages]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def pack(content: bytes) -> str:
    """Return bytes for the page: deflated, in base64."""
    return b64encode(zlib.compress(content, 9)).decode()
