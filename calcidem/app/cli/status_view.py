"""The status of a campaign as a person sees it on a terminal, and as JSON."""

import math
from collections.abc import Iterator
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from calcidem.app.campaign.status import CampaignStatus, ContentStatus, Trouble, worst_status
from calcidem.storage.records import CellStatus
from calcidem.sweep.progress import duration, pluralize

STATUS_CHARACTERS = {
    CellStatus.DONE: ("#", "green"),
    CellStatus.PENDING: (".", "dim"),
    CellStatus.NO_ARRIVAL: ("n", "yellow"),
    CellStatus.UNSTABLE: ("u", "magenta"),
    CellStatus.FAILED: ("F", "bold red"),
    CellStatus.TIMED_OUT: ("T", "bold red"),
    CellStatus.QUARANTINED: ("Q", "bold white on red"),
}
"""Character and style of each state of a cell; the characters tell them apart without colours."""

UNPLANNED = " "

PARTLY_DONE = "+"
"""Some of the cells of a character are done, the others pending."""

WIDTH_OF_NUMBERS = 78
"""Columns that the table needs besides the matrix."""

NARROWEST_MATRIX = 10

MOST_TROUBLES = 12
"""Cells that are named with their reason; more are only counted."""


def status_view(status: CampaignStatus, width: int) -> RenderableType:
    """All there is to see, for a terminal of this many columns."""
    columns = max(NARROWEST_MATRIX, width - WIDTH_OF_NUMBERS)
    parts: list[RenderableType] = [Text(line) for line in head_lines(status)]
    parts += [matrix_table(status, columns), legend(status, columns)]
    parts += [Text(line, overflow="ellipsis", no_wrap=True) for line in trouble_lines(status)]
    return Group(*parts)


def head_lines(status: CampaignStatus) -> Iterator[str]:
    """What the campaign is, its progress, and how its last run went."""
    yield (
        f"Campaign {status.name}: {len(status.seeds)} seeds x {len(status.contents)} contents, hash {status.hash[:12]}"
        + "".join(f", packing {(found or 'unknown')[:12]}" for found in status.content_hashes.values())
    )
    total = sum(status.counts.values())
    finished = total - status.pending
    counts = [f"{status.counts[kind]} {words(kind)}" for kind in CellStatus if status.counts.get(kind)]
    yield f"{finished} of {total} cells finished ({percent_of(finished, total)}): {', '.join(counts)}"
    if status.last_run is not None:
        run = status.last_run
        if status.running:
            state = "running"
        else:
            state = run.exit_state or "stopped unexpectedly; the same 'calcidem run' command continues"
        yield (
            f"Run {status.run_number} on {run.host} with {pluralize(run.ranks, 'rank')}"
            f" since {run.started:%Y-%m-%d %H:%M} UTC: {state}"
        )
    if status.pending and math.isfinite(status.seconds_left):
        workers = pluralize(status.workers, "core") + ("" if status.running else " (as in the last run)")
        yield f"Time left: {duration(status.seconds_left)} on {workers}"


def matrix_table(status: CampaignStatus, columns: int) -> Table:
    """Seeds x contents as characters, with Vs so far and the time left of each content."""
    per_character = seeds_per_character(status, columns)
    seeds = f"seeds {status.seeds[0]} to {status.seeds[-1]}" if status.seeds else "seeds"
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("content %", justify="right", no_wrap=True)
    table.add_column(seeds, no_wrap=len(seeds) <= columns)
    for name in ("done", "mean Vs m/s", "95 % of mean", "sd m/s", "s/cell", "left"):
        table.add_column(name, justify="right", no_wrap=True)
    for content in status.contents:
        table.add_row(
            f"{content.content:g}",
            matrix_row(content, status.seeds, per_character),
            f"{content.counts.get(CellStatus.DONE, 0)}/{len(content.statuses)}",
            format_velocity(content.mean),
            f"+- {content.interval.half_width:.1f}" if math.isfinite(content.interval.half_width) else "-",
            format_velocity(content.deviation),
            "-" if math.isnan(content.seconds_per_cell) else f"{content.seconds_per_cell:.2g}",
            duration(None if math.isnan(content.seconds_left) else content.seconds_left / status.workers),
        )
    return table


def seeds_per_character(status: CampaignStatus, columns: int) -> int:
    """Seeds that share a character so that a matrix fits into so many columns."""
    return max(1, math.ceil(len(status.seeds) / columns))


def matrix_row(content: ContentStatus, seeds: tuple[int, ...], per_character: int) -> Text:
    """One character for each seed of a content, or for several: then the most alarming state of them."""
    row = Text()
    for start in range(0, len(seeds), per_character):
        planned = [content.statuses[s] for s in seeds[start : start + per_character] if s in content.statuses]
        worst = worst_status(planned) if planned else None
        symbol, style = STATUS_CHARACTERS[worst] if worst is not None else (UNPLANNED, "")
        if worst is CellStatus.PENDING and CellStatus.DONE in planned:
            symbol = PARTLY_DONE
        row.append(symbol, style)
    return row


def legend(status: CampaignStatus, columns: int) -> Text:
    """What the characters mean that occur in a matrix of so many columns."""
    text = Text("  ")
    for kind, (symbol, style) in STATUS_CHARACTERS.items():
        if status.counts.get(kind):
            text.append(symbol, style).append(f" {words(kind)}   ")
    if len(status.seeds) > columns:
        text.append(f"{PARTLY_DONE} partly done   one character for {seeds_per_character(status, columns)} seeds")
    return text


def trouble_lines(status: CampaignStatus) -> Iterator[str]:
    """Cells that went wrong or were tried again, the most alarming first."""
    if not status.troubles:
        return
    yield ""
    yield "Cells that went wrong or were tried again:"
    for trouble in status.troubles[:MOST_TROUBLES]:
        yield f"  {trouble_line(trouble)}"
    if len(status.troubles) > MOST_TROUBLES:
        yield f"  and {len(status.troubles) - MOST_TROUBLES} more; 'calcidem query DB --columns all' lists every cell"
    if any(trouble.reason for trouble in status.troubles):
        yield "'calcidem retry DB --status STATUS' makes such cells pending again."


def trouble_line(trouble: Trouble) -> str:
    """One line about a cell."""
    history = pluralize(trouble.attempts, "attempt")
    if trouble.losses:
        history += f", {pluralize(trouble.losses, 'worker')} lost"
    if trouble.retry:
        history += f", wave sent again with half the time step ({trouble.retry})"
    reason = f": {trouble.reason}" if trouble.reason else ""
    return f"seed {trouble.key.seed}, {trouble.key.content:g} %: {words(trouble.status)} after {history}{reason}"


def words(status: CellStatus) -> str:
    """Name of a status as it is spoken."""
    return status.value.replace("_", " ")


def percent_of(part: int, whole: int) -> str:
    """Part of a whole in percent, never 100 % before all is there."""
    return f"{math.floor(100 * part / whole)} %" if whole else "-"


def format_velocity(value: float) -> str:
    """A velocity, or a dash where there is none."""
    return f"{value:.1f}" if math.isfinite(value) else "-"


def status_as_json(status: CampaignStatus) -> dict[str, Any]:
    """All there is to know, in JSON's types; a missing number is null."""
    run = status.last_run
    return {
        "campaign": status.name,
        "hash": status.hash,
        "packing_content_hashes": list(status.content_hashes.values()),
        "running": status.running,
        "run": None if run is None else {"number": status.run_number, "ranks": run.ranks, "exit_state": run.exit_state},
        "cells": {kind.value: number for kind, number in sorted(status.counts.items())},
        "seconds_left": finite_or_none(status.seconds_left),
        "workers": status.workers,
        "seeds": list(status.seeds),
        "contents": [
            {
                "content": content.content,
                "status": [content.statuses[seed].value if seed in content.statuses else None for seed in status.seeds],
                "cells": {kind.value: number for kind, number in sorted(content.counts.items())},
                "mean": finite_or_none(content.mean),
                "sd": finite_or_none(content.deviation),
                "interval_95": [finite_or_none(content.interval.low), finite_or_none(content.interval.high)],
                "seconds_per_cell": finite_or_none(content.seconds_per_cell),
                "core_seconds_left": finite_or_none(content.seconds_left),
            }
            for content in status.contents
        ],
        "troubles": [
            {
                "seed": trouble.key.seed,
                "content": trouble.key.content,
                "status": trouble.status.value,
                "attempts": trouble.attempts,
                "losses": trouble.losses,
                "reason": trouble.reason,
                "retry": trouble.retry,
            }
            for trouble in status.troubles
        ],
    }


def finite_or_none(value: float) -> float | None:
    """A number as JSON has it."""
    return value if math.isfinite(value) else None
