"""Texts and tables for the terminal: of a run, and of the status of a campaign."""

import math
import os
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from calcidem.analysis.velocity import SOIL_DENSITY, are_samples, median_known, small_strain_modulus
from calcidem.app.campaign.status import (
    STATUS_QUANTITIES,
    UNREAD,
    URGENCY,
    CampaignStatus,
    ProgressDisplay,
)
from calcidem.app.cli.options import IS_QUIET
from calcidem.app.cli.output import WholeTable, make_console, make_table
from calcidem.ends import CellStatus, Verdict
from calcidem.storage.records import MOST_PULSE_EFFECT, Selection, depends_on_pulse
from calcidem.storage.sql.engine import Address
from calcidem.storage.sql.store import Store
from calcidem.sweep.ranks import COMMAND_VARIABLE, available_cores, launcher
from calcidem.wording import duration, first_of, number, pluralize, printable, tell

if TYPE_CHECKING:  # the status needs no configuration and no packing
    from calcidem.app.config.schema import Configuration
    from calcidem.dem.sample.packing import Packing


class TerminalView:
    """A `calcidem.app.campaign.run.RunView` on the terminal, or in the log, of this process.

    Ranks that `calcidem run --ranks` started only write sentences: their command shows the progress and the results.
    """

    def __init__(self, *, with_report: bool, cores_used: bool) -> None:
        self.console = make_console()
        self.quiet, self.is_told_by_command = IS_QUIET.get(), COMMAND_VARIABLE in os.environ
        self.cores_used = cores_used or launcher() is not None
        self.with_report = with_report

    def display(self) -> ProgressDisplay:
        """Display of the progress, unless only results are wanted."""
        return ProgressDisplay(None if self.quiet else self.console, shows_progress=not self.is_told_by_command)

    def begin(self, configuration: "Configuration", packing: "Packing") -> None:
        """Report on the packing, and on idle cores."""
        if self.is_told_by_command:
            return
        for line in packing_lines(packing):
            tell(line)
        from calcidem.app.config.examples import calibration_note

        if note := calibration_note(configuration):
            tell(note)
        if not self.cores_used and sys.platform == "linux" and (cores := available_cores()) > 1:
            tell(f"Computing on one of {cores} cores; 'calcidem run' with --ranks 0 uses all.")

    def finish(self, store: Store, configuration: "Configuration", code: int, *, in_haste: bool) -> None:
        """Show the velocities, export them and write the report if requested; in haste show them only."""
        if self.is_told_by_command:
            return
        from calcidem.storage.netcdf import belongs_to_another, export_netcdf  # imported after the cells

        plan = configuration.campaign
        self.console.print(_vs_table(store, Selection(None if plan.until else plan.seed_numbers, plan.contents)))
        if plan.until is not None and code == 0:
            from calcidem.app.campaign.cells import SeedDemand

            for line in SeedDemand.of_store(store, plan).lines():
                tell(line)
        address = Address.parse(configuration.database)
        tell(f"Database: {address}")
        netcdf = configuration.netcdf
        if belongs_to_another(netcdf, store.record.hash):  # two campaigns of one database, or with one name
            netcdf = netcdf.with_stem(f"{netcdf.stem}-{store.record.hash[:8]}")
        if in_haste:
            tell(f"NetCDF:   not written, to end quickly; calcidem export {address} OUT.nc does it")
        else:
            tell(f"Wrote {export_netcdf(store, netcdf)}")
        if self.with_report and code == 0:
            from calcidem.app.report.page import write_report

            page = netcdf.with_suffix(".html").absolute()
            write_report(configuration.database, page, campaign_name=configuration.campaign.name)
            tell(f"Wrote {page}")

    def refuse(self, error: Exception) -> int:
        """Report an error, and return its exit code."""
        from calcidem.app.cli.exit_codes import tell_error

        return tell_error(error)


def packing_lines(packing: "Packing") -> Iterator[str]:
    """Report on a packing."""
    report = packing.report
    yield (
        f"Packing: {len(packing.radius)} disks in {packing.width:.4g} m x {packing.height:.4g} m, "
        f"porosity {report.porosity:.4f}, {len(packing.pairs)} contacts"
    )
    yield (
        f"  coordination number {report.coordination_number:.3f}, "
        f"{report.coordination_number_without_rattlers:.3f} without {report.rattlers} rattlers"
    )
    from calcidem.dem.sample.packing import WALL_NAMES

    stresses = zip(WALL_NAMES, report.wall_stress, strict=True)
    yield f"  normal stress: {', '.join(f'{name} {stress:.1f} Pa' for name, stress in stresses)}"
    mean, largest = (
        f"{100.0 * overlap / float(packing.radius.mean()):.2g} %"
        for overlap in (report.mean_overlap, report.largest_overlap)
    )
    yield (
        f"  overlap: mean {mean}, largest {largest} of the mean radius; "
        f"unbalanced-force ratio {report.unbalanced_ratio:.2g}; made in {report.seconds:.0f} s ({report.steps} steps)"
    )
    yield f"  content hash {packing.content_hash}"


def _vs_table(store: Store, selection: Selection) -> Table:
    """Table of Vs against content for selected cells of the store's campaign."""
    columns = store.table((*STATUS_QUANTITIES, "effective_vs"), selection)
    found = CampaignStatus.of(store, columns, ())
    velocities = ("mean m/s", "sd m/s", "reading m/s", "effective mean m/s", "effective sd m/s")
    table = make_table("Shear-wave velocity", numbers=("content %", "done", *velocities, "G0 MPa", "L/lambda"))
    if has_others := any(one.counts.keys() - {CellStatus.DONE} for one in found.contents):
        table.add_column("other cells")
    counted, also_counted = (are_samples(columns[name], columns["content"]) for name in ("vs", "effective_vs"))
    for one in found.contents:
        here = (columns["content"] == one.content) & counted
        effective = columns["effective_vs"][(columns["content"] == one.content) & also_counted].astype(float)
        mean = float(effective.mean()) if effective.size else np.nan
        loud = depends_on_pulse(columns["pulse_effect"][columns["content"] == one.content].astype(float)).any()
        deviation = float(effective.std(ddof=1)) if effective.size > 1 else np.nan
        others = [status for status in CellStatus if status in one.counts and status != CellStatus.DONE]
        table.add_row(
            f"{one.content:g}",
            f"{one.counts.get(CellStatus.DONE, 0)}/{len(one.statuses)}",
            *map(number, (one.mean, one.deviation, one.budget.scatter, mean, deviation)),
            number(np.nan if loud else small_strain_modulus(mean) / 1e6, ".4g"),
            number(median_known(columns["wavelengths_on_path"][here]), ".2f"),
            *([", ".join(f"{one.counts[status]} {status.words}" for status in others)] if has_others else ()),
        )
    meaning = (
        f"standard error of Vs: {found.budget}; reading: sd of Vs by reading errors alone; effective: Vs of the "
        f"wave that fits all stations; G0: from its mean, for a soil of {SOIL_DENSITY:g} kg/m3"
    )
    table.caption = "\n".join((meaning, *found.notes))
    return table


_STATUS_CHARACTERS = {
    CellStatus.DONE: ("#", "green"),
    CellStatus.PENDING: (".", "dim"),
    CellStatus.NO_ARRIVAL: ("n", "yellow"),
    CellStatus.UNSTABLE: ("u", "magenta"),
    CellStatus.FAILED: ("F", "bold red"),
    CellStatus.TIMED_OUT: ("T", "bold red"),
    CellStatus.QUARANTINED: ("Q", "bold white on red"),
}
"""Character and style of each status of a cell; the characters differ, so colours are not needed."""

_PARTLY_DONE = "+"
"""Character for cells of which some are done and the others pending."""


def status_view(status: CampaignStatus, width: int) -> RenderableType:
    """Whole status, for a terminal of this many columns."""
    columns = max(10, width - 78)  # the table needs so many besides the matrix
    parts: list[RenderableType] = [Text(printable(line)) for line in _head_lines(status)]
    per_character = max(1, math.ceil(len(status.seeds) / columns))  # seeds, so that the matrix fits into the columns
    legend = Text("  ")
    for kind, (symbol, style) in _STATUS_CHARACTERS.items():
        if status.counts.get(kind):
            legend.append(symbol, style).append(f" {kind.words}   ")
    if per_character > 1:
        legend.append(f"{_PARTLY_DONE} partly done   one character for {per_character} seeds")
    parts += [_matrix_table(status, columns, per_character), legend]
    parts += [Text(f"  {note}") for note in status.notes]
    if status.counts.get(CellStatus.DONE):
        parts.append(Text(f"  standard error of Vs: {status.budget}"))
    parts += [Text(printable(line)) for line in _trouble_lines(status)]
    verdicts = {Verdict.of(trouble.reason) for trouble in status.troubles}
    parts += [Text(f"No arrival: {verdict.explained}.") for verdict in Verdict if verdict in verdicts]
    return Group(*parts)


def _head_lines(status: CampaignStatus) -> Iterator[str]:
    """Campaign, its progress, and its last run."""
    yield (
        f"Campaign {status.name}: {len(status.seeds)} seeds x {len(status.contents)} contents, hash {status.hash[:12]}"
        + "".join(f", packing {found[:12]}" for found in status.content_hashes.values())
    )
    total = sum(status.counts.values())
    finished = total - status.pending
    counts = [f"{status.counts[kind]} {kind.words}" for kind in CellStatus if status.counts.get(kind)]
    # never 100 % before all cells have finished
    percent = f"{math.floor(100 * finished / total)} %" if total else "-"
    yield f"{finished} of {total} cells finished ({percent}): {', '.join(counts)}"
    if status.last_run is not None:
        run = status.last_run
        ended = run.exit_state or "stopped unexpectedly; the same 'calcidem run' command continues"
        yield (
            f"Run {status.run_number} on {run.host} with {pluralize(run.ranks, 'rank')}"
            f" since {run.started:%Y-%m-%d %H:%M} UTC: {'running' if status.running else ended}"
        )
    if status.pending and math.isfinite(status.seconds_left):
        workers = pluralize(status.workers, "core") + ("" if status.running else " (as in the last run)")
        yield f"Time left: {duration(status.seconds_left)} on {workers}"


def _matrix_table(status: CampaignStatus, columns: int, per_character: int) -> WholeTable:
    """Seeds x contents as characters, with Vs so far and the time left of each content.

    A character stands for one seed, or for several with their most severe status.
    """
    seeds = f"seeds {status.seeds[0]} to {status.seeds[-1]}" if status.seeds else "seeds"
    table = WholeTable(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("content %", justify="right", no_wrap=True)
    table.add_column(seeds, no_wrap=len(seeds) <= columns)
    for name in ("done", "mean Vs m/s", "95 % of mean", "sd m/s", "s/cell", *(["left"] if status.pending else [])):
        table.add_column(name, justify="right", no_wrap=True)
    for content in status.contents:
        symbols = Text()
        for start in range(0, len(status.seeds), per_character):
            several = status.seeds[start : start + per_character]
            planned = [content.statuses[seed] for seed in several if seed in content.statuses]
            worst = min(planned, key=URGENCY.__getitem__, default=None)
            symbol, style = _STATUS_CHARACTERS[worst] if worst is not None else (" ", "")
            if worst is CellStatus.PENDING and CellStatus.DONE in planned:
                symbol = _PARTLY_DONE
            symbols.append(symbol, style)
        row: list[str | Text] = [
            f"{content.content:g}",
            symbols,
            f"{content.counts.get(CellStatus.DONE, 0)}/{len(content.statuses)}",
            number(content.mean),
            f"+- {half:.1f}" if math.isfinite(half := content.interval.half_width) else "-",
            number(content.deviation),
            number(content.seconds_per_cell, ".2g"),
        ]
        if status.pending:
            seconds = None if math.isnan(content.seconds_left) else content.seconds_left / status.workers
            row.append(duration(seconds))
        table.add_row(*row)
    return table


def _trouble_lines(status: CampaignStatus) -> Iterator[str]:
    """Cells that failed or were tried again, the most severe first."""
    if not status.troubles:
        return
    yield ""
    yield "Failed or repeated cells:"
    lines = []
    for trouble in status.troubles:
        history = pluralize(trouble.attempts, "attempt")
        if trouble.losses:
            history += f", {pluralize(trouble.losses, 'run')} died meanwhile"
        if trouble.retry:
            history += f", computed again with half the time step ({trouble.retry})"
        reason = f": {trouble.reason}" if trouble.reason else ""
        lines.append(f"{trouble.key}: {trouble.status.words} after {history}{reason}")
    yield from (f"  {line}" for line in first_of(lines))
    went_wrong = {trouble.status for trouble in status.troubles if trouble.reason}
    if went_wrong & {*UNREAD}:
        kinds = " and ".join(kind.words for kind in UNREAD if kind in went_wrong)
        yield f"Cells with {kinds} give the same again; 'calcidem show DB --seed S --content C --out DIR' draws them."
    for kind in sorted(went_wrong - {*UNREAD}):
        yield f"'calcidem run CONFIG --retry {kind}' computes cells that are {kind.words} again."


def status_as_json(status: CampaignStatus) -> dict[str, Any]:
    """Whole status in JSON's types; a missing number is null."""
    told = status.to_json()
    for content, row in zip(status.contents, told["contents"], strict=True):
        row["status"] = [content.statuses.get(seed) for seed in status.seeds]
    return told | {
        "packing_content_hashes": list(status.content_hashes.values()),
        "seeds": list(status.seeds),
        "troubles": [
            {"seed": trouble.key.seed, "content": trouble.key.content}
            | {name: getattr(trouble, name) for name in ("status", "attempts", "losses", "reason", "retry")}
            for trouble in status.troubles
        ],
    }


def pulse_remark(loud: int) -> str:
    """Verdict on this number of samples whose velocity depends on the pulse."""
    return (
        f"Vs of {pluralize(loud, 'sample')} depends on the pulse by more than {100 * MOST_PULSE_EFFECT:g} %: a smaller "
        "wave.amplitude measures the sample"
    )
