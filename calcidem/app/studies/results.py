"""Result of a study in every form in which its command gives it."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import xarray as xr
from matplotlib.figure import Figure

from calcidem.analysis.figures.style import save
from calcidem.storage.files import write_text_atomically
from calcidem.storage.netcdf import write_netcdf


@dataclass(frozen=True, slots=True, eq=False)
class StudyResult:
    """Results of a study."""

    text: str
    """Markdown tables to show."""
    page: str = ""
    """Tables for the file, if they differ from those to show."""
    rows: Sequence[Mapping[str, Any]] = ()
    """One for each case, for CSV and Parquet."""
    json: str = ""
    """All results, for programs."""
    dataset: xr.Dataset | None = None
    """All results, for NetCDF."""
    figures: Mapping[str, Callable[[], Figure]] = field(default_factory=dict)
    """Draws each figure by its name; without a name it has that of the table."""
    formats: tuple[str, ...] = ("png",)
    """Formats of the figures."""
    is_wrong: bool = False
    """Whether the program was wrong without saying so."""

    def write(self, table: Path) -> Iterator[Path]:
        """Write the tables, after NetCDF, figures and JSON beside them; yields each file."""
        table.parent.mkdir(parents=True, exist_ok=True)
        if self.dataset is not None:
            write_netcdf(self.dataset, table.with_suffix(".nc"))
            yield table.with_suffix(".nc")
        for name, draw in self.figures.items():
            yield from save(draw(), table.parent, name or table.stem, self.formats)
        if self.json:
            write_text_atomically(table.with_suffix(".json"), self.json)
            yield table.with_suffix(".json")
        write_text_atomically(table, self.page or self.text)
        yield table


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Table with a line for each row; empty if there are no rows. Numbers with a point have two digits."""
    entries = [[number(entry) if isinstance(entry, float | None) else str(entry) for entry in row] for row in rows]
    lines = [f"| {' | '.join(row)} |" for row in entries]
    return "\n".join([f"| {' | '.join(header)} |", f"|{'---|' * len(header)}", *lines]) if lines else ""


def number(value: float | None, form: str = ".1e") -> str:
    """Format a number, or a dash if it is missing."""
    return "-" if value is None else format(value, form)
