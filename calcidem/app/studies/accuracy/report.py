"""What was found, as Markdown tables and as JSON."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from calcidem.app.studies.accuracy.amplitudes import AmplitudeRow
from calcidem.app.studies.accuracy.converged import HALVING
from calcidem.app.studies.accuracy.convergence import STEPS, Convergence
from calcidem.app.studies.accuracy.equilibrium import EquilibriumRow
from calcidem.app.studies.accuracy.scatter import Scatter
from calcidem.app.studies.accuracy.settings import DEFAULT
from calcidem.app.studies.accuracy.study import Study, Summary, cheapest, covered, default_of

TARGETS = (0.005, 0.002, 0.001)
MANY_CELLS = 40  # above which the table of cells is left to the JSON
DIGITS = 5


@dataclass(frozen=True, slots=True)
class Findings:
    """Everything that one run of the command measured, and the campaign hash that it belongs to."""

    campaign_hash: str
    study: Study
    convergence: tuple[Convergence, ...] = ()
    amplitudes: tuple[AmplitudeRow, ...] = ()
    equilibrium: tuple[EquilibriumRow, ...] = ()
    scatter: tuple[Scatter, ...] = ()


def tables(findings: Findings, targets: Sequence[float] = TARGETS) -> str:
    """Give all tables as Markdown; those that were not measured are left out."""
    study = findings.study
    parts = [
        [opening(study)],
        settings_table(study.summaries),
        ["Cheapest setting whose worst error stays below a target:"],
        [f"- {100 * target:g} %: {name_of(cheapest(study, target))}" for target in targets],
        content_table(study),
        cell_table(study),
        convergence_table(findings.convergence),
        amplitude_table(findings.amplitudes),
        equilibrium_table(findings.equilibrium),
        scatter_table(findings.scatter),
    ]
    return "\n\n".join("\n".join(lines) for lines in parts if lines) + "\n"


def opening(study: Study) -> str:
    """Say the most important numbers."""
    row = default_of(study)
    return (
        f"Default against the reference, {row.cells} cells: median {row.median:.1e}, worst {row.worst:.1e}, "
        f"{study.reference_seconds / row.seconds:.0f} times faster ({row.seconds:.2f} s against "
        f"{study.reference_seconds:.1f} s of processor time a cell). The last halving of the reference's step "
        f"changed Vs by {study.halving:.1e} at most; {converged_share(study)}. "
        f"The error is at most the cell's own estimate in {100 * row.covered:.1f} % of the cells."
    )


def converged_share(study: Study) -> str:
    """Say in how many cells the reference's step is small enough."""
    changes = [abs(cell.halving) for cell in study.references if cell.halving is not None]
    return f"{sum(change < HALVING for change in changes)} of {len(changes)} cells are below {HALVING:g}"


def settings_table(summaries: Sequence[Summary]) -> list[str]:
    """Give one line for each setting; those that ask another question are marked."""
    lines = [
        "| setting | Vs median | Vs worst | first arrival | signal (L2) | within estimate | s a cell | cells lost |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in summaries:
        name = row.setting if row.numerical else f"*{row.setting}*"
        numbers = " | ".join(f"{value:.1e}" for value in (row.median, row.worst, row.arrival, row.signal))
        honest = f"{100 * row.covered:.0f} %" if row.numerical and np.isfinite(row.covered) else "-"
        lines.append(f"| {name} | {numbers} | {honest} | {row.seconds:.3f} | {row.lost} |")
    return lines


def content_table(study: Study) -> list[str]:
    """Give reference and default at each content."""
    lines = [
        (
            "| content % | cells | reference's step / limit, smallest | Vs by its last halving, largest "
            "| default: median | worst | within estimate | estimate, median |"
        ),
        "|---|---|---|---|---|---|---|---|",
    ]
    for content in sorted({cell.content for cell in study.references}):
        exact = [cell for cell in study.references if cell.content == content]
        found = [cell for cell in study.cells if cell.setting == DEFAULT and cell.content == content]
        errors = [abs(cell.vs_error) for cell in found if cell.vs_error is not None]
        if not errors:
            continue
        halving = max((abs(cell.halving) for cell in exact if cell.halving is not None), default=np.nan)
        finest = min(cell.step_fraction for cell in exact)
        estimate = np.median([cell.estimate for cell in found if cell.estimate is not None])
        lines.append(
            f"| {content:g} | {len(errors)} | {finest:g} | {halving:.1e} | {np.median(errors):.1e} "
            f"| {max(errors):.1e} | {100 * covered(found):.0f} % | {estimate:.1e} |"
        )
    return lines


def cell_table(study: Study) -> list[str]:
    """Give every cell of the default beside its reference, unless they are too many to read."""
    found = {(cell.seed, cell.content): cell for cell in study.cells if cell.setting == DEFAULT}
    if not found or len(study.references) > MANY_CELLS:
        return []
    lines = [
        (
            "| content % | seed | reference Vs, m/s | its step / limit | Vs by its last halving | default Vs, m/s "
            "| error | own estimate | first arrival | signal (L2) |"
        ),
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for exact in study.references:
        cell = found[exact.seed, exact.content]
        numbers = (cell.vs_error, cell.estimate, cell.arrival_error, cell.signal_error)
        lines.append(
            f"| {exact.content:g} | {exact.seed} | {plain(exact.vs, '.2f')} | {exact.step_fraction:g} "
            f"| {plain(exact.halving)} | {plain(cell.vs, '.2f')} | {' | '.join(plain(number) for number in numbers)} |"
        )
    return lines


def convergence_table(rows: Sequence[Convergence]) -> list[str]:
    """Give change of the signal and observed order for each halving of the step."""
    if not rows:
        return []
    halvings = [f"{2 * step:g} to {step:g}" for step in STEPS[1:]]
    lines = [
        f"| content % | local damping | signal, {' | '.join(halvings)} | order | order |",
        "|---|---|" + "---|" * (len(halvings) + 2),
    ]
    for row in rows:
        changes = " | ".join(f"{change:.1e}" for change in row.changes)
        orders = " | ".join(f"{order:.2f}" for order in row.orders)
        lines.append(f"| {row.content:g} | {'as configured' if row.damped else 'none'} | {changes} | {orders} |")
    return lines


def amplitude_table(rows: Sequence[AmplitudeRow]) -> list[str]:
    """Give the error of the regimes at each amplitude; the finite regime's own line is an effect, and marked."""
    if not rows:
        return []
    lines = [
        "| amplitude, m/s | regime | Vs median | Vs worst | cells | cells lost | refused |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        name = f"*{row.regime}, effect of the amplitude*" if row.regime == "finite" else row.regime
        reason = row.refusal.split(":")[0] if row.refusal else ""
        lines.append(
            f"| {row.amplitude:g} | {name} | {plain(row.median)} | {plain(row.worst)} | {row.cells} | {row.lost} "
            f"| {reason} |"
        )
    return lines


def equilibrium_table(rows: Sequence[EquilibriumRow]) -> list[str]:
    """Give what a packing's rest of imbalance does."""
    if not rows:
        return []
    lines = ["| balance of the packing | changed contacts | Vs median | Vs worst | cells |", "|---|---|---|---|---|"]
    lines += [
        f"| {row.balance:g} | {row.changed_contacts} | {row.median:.1e} | {row.worst:.1e} | {row.cells} |"
        for row in rows
    ]
    return lines


def scatter_table(rows: Sequence[Scatter]) -> list[str]:
    """Give statistical and numerical error beside each other, per content, for the default setting."""
    if not rows:
        return []
    lines = [
        (
            "| content % | numerical error: median | worst | mean with sign | scatter (sd / mean) | of samples "
            f"| statistical error of the mean of {rows[0].seeds} seeds |"
        ),
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row.content:g} | {row.numerical:.1e} | {row.worst:.1e} | {row.bias:+.1e} | {row.deviation:.1e} "
        f"| {row.samples} | {row.statistical:.1e} |"
        for row in rows
    ]
    return lines


def plain(number: float | None, form: str = ".1e") -> str:
    """Write a number, or a dash."""
    return "-" if number is None else format(number, form)


def name_of(row: Summary | None) -> str:
    """Name of a setting with its cost."""
    return "none of those measured" if row is None else f"{row.setting}, {row.seconds:.2f} s a cell"


def as_json(findings: Findings) -> str:
    """Everything as JSON, to five digits."""
    return json.dumps(rounded(asdict(findings)), separators=(",", ":"))


def rounded(value: object) -> object:
    """Return the same with all numbers to five digits, and null for what is no finite number."""
    if isinstance(value, dict):
        return {f"{key:g}" if isinstance(key, float) else str(key): rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None
    return value
