"""Status of a campaign for a terminal, and as JSON."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.text import Text

from calcidem.app.campaign.notices import printable
from calcidem.app.campaign.status import FEWEST_TO_PLAN, UNREAD, URGENCY, CampaignStatus, ContentStatus, Trouble
from calcidem.app.cli.tables import WholeTable, format_number, marks_of, remarks_on
from calcidem.ends import CellStatus, Verdict
from calcidem.sweep.schedule import duration, first_of, pluralize

if TYPE_CHECKING:  # loaded at its first use
    from calcidem.analysis.intervals import SeedPlan

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

_UNPLANNED = " "

_PARTLY_DONE = "+"
"""Character for cells of which some are done and the others pending."""

_WIDTH_OF_NUMBERS = 78
"""Number of columns that the table needs besides the matrix."""

_NARROWEST_MATRIX = 10


def status_view(status: CampaignStatus, width: int, half_width: float | None = None) -> RenderableType:
    """Whole status, for a terminal of this many columns, and the seeds for a half-width (m/s)."""
    columns = max(_NARROWEST_MATRIX, width - _WIDTH_OF_NUMBERS)
    parts: list[RenderableType] = [Text(printable(line)) for line in _head_lines(status)]
    parts += [_matrix_table(status, columns), _legend(status, columns)]
    marks = [marks_of(content.counts, content.budget.loud) for content in status.contents]
    parts += [Text(f"  {remark}") for remark in remarks_on(marks, status.budget.loud)]
    if status.counts.get(CellStatus.DONE):
        parts.append(Text(f"  standard error of Vs: {status.budget}"))
    if half_width is not None:
        parts += map(Text, _seed_lines(status, half_width))
    parts += [Text(printable(line), overflow="ellipsis", no_wrap=True) for line in _trouble_lines(status)]
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


def _matrix_table(status: CampaignStatus, columns: int) -> WholeTable:
    """Seeds x contents as characters, with Vs so far and the time left of each content."""
    per_character = _seeds_per_character(status, columns)
    seeds = f"seeds {status.seeds[0]} to {status.seeds[-1]}" if status.seeds else "seeds"
    table = WholeTable(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("content %", justify="right", no_wrap=True)
    table.add_column(seeds, no_wrap=len(seeds) <= columns)
    for name in ("done", "mean Vs m/s", "95 % of mean", "sd m/s", "s/cell", "left"):
        table.add_column(name, justify="right", no_wrap=True)
    for content in status.contents:
        table.add_row(
            f"{content.content:g}",
            _matrix_row(content, status.seeds, per_character),
            f"{content.counts.get(CellStatus.DONE, 0)}/{len(content.statuses)}"
            f"{marks_of(content.counts, content.budget.loud)}",
            format_number(content.mean),
            format_number(content.interval.half_width, "+- {:.1f}"),
            format_number(content.deviation),
            format_number(content.seconds_per_cell, "{:.2g}"),
            duration(None if math.isnan(content.seconds_left) else content.seconds_left / status.workers),
        )
    return table


def _seeds_per_character(status: CampaignStatus, columns: int) -> int:
    """Number of seeds per character, so that the matrix fits into the columns."""
    return max(1, math.ceil(len(status.seeds) / columns))


def _matrix_row(content: ContentStatus, seeds: tuple[int, ...], per_character: int) -> Text:
    """One character for each seed of a content, or for several seeds with their most severe status."""
    row = Text()
    for start in range(0, len(seeds), per_character):
        planned = [content.statuses[s] for s in seeds[start : start + per_character] if s in content.statuses]
        worst = min(planned, key=URGENCY.__getitem__, default=None)
        symbol, style = _STATUS_CHARACTERS[worst] if worst is not None else (_UNPLANNED, "")
        if worst is CellStatus.PENDING and CellStatus.DONE in planned:
            symbol = _PARTLY_DONE
        row.append(symbol, style)
    return row


def _legend(status: CampaignStatus, columns: int) -> Text:
    """Legend of the characters in a matrix of this number of columns."""
    text = Text("  ")
    for kind, (symbol, style) in _STATUS_CHARACTERS.items():
        if status.counts.get(kind):
            text.append(symbol, style).append(f" {kind.words}   ")
    if len(status.seeds) > columns:
        text.append(f"{_PARTLY_DONE} partly done   one character for {_seeds_per_character(status, columns)} seeds")
    return text


def _trouble_lines(status: CampaignStatus) -> Iterator[str]:
    """Cells that failed or were tried again, the most severe first."""
    if not status.troubles:
        return
    yield ""
    yield "Failed or repeated cells:"
    yield from (f"  {line}" for line in first_of([_trouble_line(trouble) for trouble in status.troubles]))
    went_wrong = {trouble.status for trouble in status.troubles if trouble.reason}
    if went_wrong & {*UNREAD}:
        kinds = " and ".join(kind.words for kind in UNREAD if kind in went_wrong)
        yield f"Cells with {kinds} give the same again; 'calcidem show DB --seed S --content C --out DIR' draws them."
    for kind in sorted(went_wrong - {*UNREAD}):
        yield f"'calcidem run CONFIG --retry {kind}' computes cells that are {kind.words} again."


def _trouble_line(trouble: Trouble) -> str:
    """One line about a cell."""
    history = pluralize(trouble.attempts, "attempt")
    if trouble.losses:
        history += f", {pluralize(trouble.losses, 'worker')} lost"
    if trouble.retry:
        history += f", computed again with half the time step ({trouble.retry})"
    reason = f": {trouble.reason}" if trouble.reason else ""
    return f"{trouble.key}: {trouble.status.words} after {history}{reason}"


def _plan_of(content: ContentStatus, half_width: float) -> "SeedPlan | None":
    """Seeds that a content needs for a half-width in m/s; None if its scatter is unknown."""
    from calcidem.analysis.intervals import SeedPlan  # statistics of SciPy, which take half a second

    if len(content.vs) < FEWEST_TO_PLAN:
        return None
    return SeedPlan.of_values(content.vs, half_width, unreadable=sum(content.counts.get(kind, 0) for kind in UNREAD))


def _seed_lines(status: CampaignStatus, half_width: float) -> Iterator[str]:
    """Seeds and time for a half-width in m/s at each content."""
    yield f"\nSeeds for a mean of +- {half_width:g} m/s (95 %):"
    for content in status.contents:
        if content.content == 0.0:
            yield "  0 %: all seeds are the same sample"
            continue
        plan = _plan_of(content, half_width)
        if plan is None:
            yield f"  {content.content:g} %: not known before {FEWEST_TO_PLAN} seeds have a velocity"
            continue
        seconds = None if math.isnan(content.seconds_per_cell) else plan.more * content.seconds_per_cell
        needed = f"{plan.needed} ({plan.needed_low} to {plan.needed_high}, since the scatter is uncertain)"
        more = f"{plan.more} more, about {duration(seconds)} on one core"
        yield f"  {content.content:g} %: {needed}; {plan.present} give +- {plan.present_half_width:.1f} m/s; {more}"


def status_as_json(status: CampaignStatus, half_width: float | None = None) -> dict[str, Any]:
    """Whole status in JSON's types; a missing number is null."""
    told = status.to_json()
    for content, row in zip(status.contents, told["contents"], strict=True):
        row["status"] = [content.statuses.get(seed) for seed in status.seeds]
        if half_width is not None and (plan := _plan_of(content, half_width)) is not None:
            row |= {"seeds_needed": plan.needed, "more_seeds": plan.more}
    return told | {
        "packing_content_hashes": list(status.content_hashes.values()),
        "seeds": list(status.seeds),
        "troubles": [
            {"seed": trouble.key.seed, "content": trouble.key.content}
            | {name: getattr(trouble, name) for name in ("status", "attempts", "losses", "reason", "retry")}
            for trouble in status.troubles
        ],
    }
