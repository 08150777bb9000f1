"""Texts and tables of a run for the user."""

import os
import sys
from collections.abc import Iterator

import numpy as np
from rich.table import Table

from calcidem.analysis.velocity import FEWEST_WAVELENGTHS, are_samples, median_known, small_strain_modulus
from calcidem.app.campaign.notices import tell
from calcidem.app.campaign.progress import ProgressDisplay
from calcidem.app.campaign.status import STATUS_QUANTITIES, UNREAD, CampaignStatus
from calcidem.app.cli.exit_codes import tell_error
from calcidem.app.cli.tables import format_number, make_console, make_table, marks_of, remarks_on
from calcidem.app.cli.terminal import IS_QUIET
from calcidem.app.config.reference import calibration_note
from calcidem.app.config.schema import Configuration
from calcidem.dem.sample.packing import WALL_NAMES, Packing
from calcidem.ends import CellStatus
from calcidem.storage.sql.engine import Address
from calcidem.storage.sql.store import Store
from calcidem.storage.store import Selection
from calcidem.sweep.ranks import COMMAND_VARIABLE, available_cores, launcher
from calcidem.sweep.schedule import pluralize


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

    def begin(self, configuration: Configuration, packing: Packing) -> None:
        """Report on the packing, and on idle cores."""
        if self.is_told_by_command:
            return
        for line in packing_lines(packing):
            tell(line)
        if note := calibration_note(configuration):
            tell(note)
        if not self.cores_used and sys.platform == "linux" and (cores := available_cores()) > 1:
            tell(f"Computing on one of {cores} cores; 'calcidem run' with --ranks 0 uses all.")

    def finish(self, store: Store, configuration: Configuration, code: int, *, in_haste: bool) -> None:
        """Show the velocities, export them and write the report if requested; in haste show them only."""
        if self.is_told_by_command:
            return
        from calcidem.storage.netcdf import belongs_to_another, export_netcdf  # imported after the cells

        plan = configuration.campaign
        self.console.print(_vs_table(store, Selection(None if plan.until else plan.seed_numbers, plan.contents)))
        if plan.until is not None and code == 0:
            from calcidem.app.campaign.until import SeedDemand

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

            page = write_report(configuration.database, netcdf.with_suffix(".html").absolute())
            tell(f"Wrote {page}")

    def refuse(self, error: Exception) -> int:
        """Report an error, and return its exit code."""
        return tell_error(error)


def packing_lines(packing: Packing) -> Iterator[str]:
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
    columns = store.table((*STATUS_QUANTITIES, "effective_vs", "wavelengths_on_path", "broken_bonds"), selection)
    found = CampaignStatus.of(store, columns, ())
    velocities = ("mean m/s", "sd m/s", "reading m/s", "effective m/s", "its sd m/s")
    table = make_table("Shear-wave velocity", numbers=("content %", "done", *velocities, "G0 MPa", "L/lambda"))
    table.add_column("other cells")
    marks, is_near, counted = [], False, are_samples(columns["vs"], columns["content"])
    for one in found.contents:
        here = (columns["content"] == one.content) & counted
        marks.append(marks_of(one.counts, one.budget.loud))
        median = median_known(columns["wavelengths_on_path"][here])
        is_near |= (near := median < FEWEST_WAVELENGTHS)
        effective = columns["effective_vs"][here].astype(float)
        effective = effective[np.isfinite(effective)]
        mean = float(effective.mean()) if effective.size else np.nan
        deviation = float(effective.std(ddof=1)) if effective.size > 1 else np.nan
        others = one.counts.keys() - {CellStatus.DONE}
        table.add_row(
            f"{one.content:g}",
            f"{one.counts.get(CellStatus.DONE, 0)}/{len(one.statuses)}{marks[-1]}",
            *map(format_number, (one.mean, one.deviation, one.budget.scatter, mean, deviation)),
            format_number(np.nan if one.budget.loud else small_strain_modulus(mean) / 1e6, "{:.4g}"),
            format_number(median, "{:.2f}") + (" *" if near else ""),
            ", ".join(f"{one.counts[status]} {status.words}" for status in CellStatus if status in others),
        )
    remarks = [f"standard error of Vs: {found.budget}; reading m/s: sd of Vs by reading errors alone"]
    if is_near:
        remarks.append(f"* fewer than {FEWEST_WAVELENGTHS:g} wavelengths between transmitter and receiver: near field")
    remarks += remarks_on(marks, found.budget.loud)
    if count := int(np.count_nonzero(columns["broken_bonds"] > 0)):
        remarks.append(
            f"the pulse broke bonds in {pluralize(count, 'cell')}: 'calcidem query DB --where \"broken_bonds > 0\"'"
        )
    if any(found.counts.get(status) for status in UNREAD):
        remarks.append("'calcidem status DB' has reasons and remedies of cells without velocity")
    table.caption = "\n".join(remarks)
    return table
