"""Error against run time: every numerical setting against a converged reference (``calcidem accuracy``).

Each content is measured for itself and written at once, so that the same command continues after a stop.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from matplotlib.figure import Figure
from pydantic import TypeAdapter

from calcidem.analysis.figures.style import BLACK, BLUE, GREY, VERMILION, apply_style, new_figure
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.study import (
    ROUNDS,
    Cells,
    CellsFound,
    StudyResult,
    markdown_table,
    read_former,
    relative_deviation,
    signal_distance,
)
from calcidem.dem.wave.check import cheapest_law
from calcidem.dem.wave.experiment import Experiment, domain_of
from calcidem.dem.wave.measurement import Measurement
from calcidem.dem.wave.section import Pulse
from calcidem.storage.records import NORMAL_95
from calcidem.wording import pluralize

DEFAULT = "default"
REFERENCE_SAMPLES = 1600  # samples per period of the pulse
HALVING = 1.0e-4  # largest relative change of Vs by halving the step
FINEST = 0.05  # smallest step of a reference over the limit


@dataclass(frozen=True, slots=True)
class Setting:
    """One setting for computing the same cells."""

    name: str
    """Changed parameter and its value, unique in a study."""
    experiment: Experiment
    """Complete experiment."""
    numerical: bool = True
    """False if the exact answer also changes, as with the width of a band or the damping. The difference is then not an
    error, and `Study.cheapest` excludes the setting.
    """
    adds: str = ""
    """What this setting computes and the experiment leaves out; empty if nothing."""
    why: str = ""
    """Reason why the experiment may leave it out."""


def unchecked(experiment: Experiment) -> Experiment:
    """The experiment without checks, with the contact law that they try first."""
    return replace(experiment, is_checked=False).with_wave(law=cheapest_law(experiment))


def settings(experiment: Experiment, contents: Sequence[float]) -> Iterator[Setting]:
    """Yield the settings of a study: the experiment's own first, then every knob; contents in percent.

    The first has its checks, which may choose another law and step at each content. The others have none.
    """
    yield Setting(DEFAULT, experiment)
    experiment = unchecked(experiment)
    wave = experiment.wave
    checked = "check samples of each content have it, and the stated error includes it"

    def vary(knob: str, *values: float | str) -> Iterator[Setting]:
        for value in values:
            if value != getattr(wave, knob):
                yield Setting(f"{knob} {value}", experiment.with_wave(**{knob: value}))

    yield from vary("step_fraction", 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.95)
    yield from vary("samples_per_period", 50, 100, 200, 400)  # the stride of the record
    for other in vary("precision", "float32", "float64"):
        double = wave.precision == "float32"
        yield replace(other, adds="double precision", why=checked) if double else other
    if experiment.installation == "preserve":
        yield Setting("law linear", experiment.with_wave(law="linear"))
    finite = Setting("law finite", experiment.with_wave(law="finite"))
    stroke = Pulse(wave.amplitude, min(map(experiment.frequency, contents))).stroke
    share = stroke / experiment.packing.report.mean_overlap
    why = f"{checked}; the pulse moves the transmitter by {share:.1g} mean overlaps"
    yield replace(finite, adds="slip, opening, new contacts", why=why) if wave.law == "linear" else finite
    everywhere = Setting("whole domain", experiment.with_wave(whole_domain=True))
    domain = domain_of(experiment.packing, wave, experiment.installation).packing
    share = 1.0 - len(domain.x) / len(experiment.packing.x)
    why = f"no signal reaches {share:.0%} of the disks, deep in the damping layers or without contacts"
    yield replace(everywhere, adds="disks out of reach", why=why) if share > 0.0 else everywhere
    # Combinations, in which errors of several knobs add up or cancel.
    yield Setting("single precision, step 0.95", experiment.with_wave(precision="float32", step_fraction=0.95))
    finer = experiment.with_wave(law="finite", step_fraction=0.4, samples_per_period=400)
    yield Setting("finite, 400 samples, step 0.4", finer)
    if wave.damping > 0.0:
        yield Setting("damping 0", experiment.with_wave(damping=0.0), numerical=False)
    for name in ("transmitter_half_width", "receiver_half_width"):
        for factor in (0.8, 1.25):
            width = factor * getattr(wave, name)
            yield Setting(f"{name} {1e3 * width:g} mm", experiment.with_wave(**{name: width}), numerical=False)


@dataclass(frozen=True, slots=True)
class ReferenceCell:
    """Reference of one cell."""

    seed: int
    content: float
    """The cell; content in percent."""
    vs: float | None
    """m/s; None if the reference has no reliable pick either."""
    step_fraction: float
    """Step over the stability limit."""
    halving: float | None
    """Relative change of Vs by halving twice this step; None without a velocity."""


@dataclass(frozen=True, slots=True)
class CellError:
    """Deviation of one cell with one setting from the reference."""

    setting: str
    """`Setting.name`."""
    seed: int
    content: float
    """The cell; content in percent."""
    vs: float | None
    reference_vs: float | None
    """m/s; None without a reliable pick."""
    vs_deviation: float | None
    effective_deviation: float | None
    """Relative deviations of Vs and of the effective velocity, signed; None unless both have one."""
    arrival_error: float | None
    """Relative error of the travel time of the first arrival, signed; None unless both have one."""
    signal_error: float | None
    """See `signal_distance`; None if a signal is not finite."""
    stated: float | None
    """Relative standard error of both by the numerics, as the check of the content measured it; None without it."""

    @classmethod
    def compare(cls, setting: str, found: Measurement, exact: Measurement) -> Self:
        """Compare a cell with the reference of the same cell."""
        exact_arrival, arrival = (None if one.reading is None else one.reading.first_arrival for one in (exact, found))
        distance = signal_distance(found.section, exact.section)
        return cls(
            setting=setting,
            seed=found.seed,
            content=found.content,
            vs=found.vs,
            reference_vs=exact.vs,
            vs_deviation=relative_deviation(found.vs, exact.vs),
            effective_deviation=relative_deviation(found.effective_vs, exact.effective_vs),
            arrival_error=relative_deviation(exact_arrival, arrival),
            signal_error=distance if np.isfinite(distance) else None,
            stated=found.check.numerical_error,
        )


@dataclass(frozen=True, slots=True)
class ContentErrors:
    """What a study measured at one content."""

    content: float
    """Percent."""
    references: tuple[ReferenceCell, ...]
    cells: tuple[CellError, ...]
    """Every cell of the reference, and of every setting that is not refused there."""
    reference_seconds: float
    seconds: dict[str, float]
    """Processor time of a cell, s: of the reference, and by setting."""


@dataclass(frozen=True, slots=True)
class Summary:
    """Absolute relative errors of one setting over its cells; infinite if nothing can be compared."""

    setting: str
    numerical: bool
    """See `Setting`."""
    cells: int
    """Compared cells; 0 if the setting was refused."""
    lost: int
    """Cells with a velocity only in the reference."""
    median: float
    worst: float
    effective_median: float
    effective_worst: float
    """Errors of Vs, and of the effective velocity."""
    arrival: float
    signal: float
    """Medians of the errors of the first arrival and of the whole signal."""
    seconds: float
    """Processor time of a cell."""
    change: float
    """Largest relative change of Vs against the experiment's own setting."""
    adds: str = ""
    why: str = ""
    """See `Setting`."""

    @classmethod
    def of(
        cls, setting: str, parts: Sequence[ContentErrors], *, numerical: bool = True, adds: str = "", why: str = ""
    ) -> Self:
        """Summary of the cells of one setting at some contents."""
        every = [cell for part in parts for cell in part.cells]
        own = {(cell.seed, cell.content): cell.vs for cell in every if cell.setting == DEFAULT}
        cells = [cell for cell in every if cell.setting == setting]

        def sizes(values: Iterable[float | None]) -> list[float]:
            return [abs(value) for value in values if value is not None] or [np.inf]

        errors, effective = (
            sizes(cell.vs_deviation for cell in cells),
            sizes(cell.effective_deviation for cell in cells),
        )
        changes = sizes(relative_deviation(cell.vs, own.get((cell.seed, cell.content))) for cell in cells)
        return cls(
            setting=setting,
            numerical=numerical,
            cells=sum(cell.vs_deviation is not None for cell in cells),
            lost=sum(cell.vs is None and cell.reference_vs is not None for cell in cells),
            median=float(np.median(errors)),
            worst=max(errors),
            effective_median=float(np.median(effective)),
            effective_worst=max(effective),
            arrival=float(np.median(sizes(cell.arrival_error for cell in cells))),
            signal=float(np.median(sizes(cell.signal_error for cell in cells))),
            seconds=float(np.mean([part.seconds[setting] for part in parts if setting in part.seconds] or [np.inf])),
            change=max(changes),
            adds=adds,
            why=why,
        )


@dataclass(frozen=True, slots=True)
class Study:
    """Results of a study."""

    parts: tuple[ContentErrors, ...]
    """One for each content that is not refused, ascending."""
    summaries: tuple[Summary, ...]
    """One for each setting, over all contents; the experiment's own first."""

    @property
    def cells(self) -> list[CellError]:
        """Every cell of every setting."""
        return [cell for part in self.parts for cell in part.cells]

    @property
    def references(self) -> list[ReferenceCell]:
        """Reference of every cell."""
        return [cell for part in self.parts for cell in part.references]

    @property
    def reference_seconds(self) -> float:
        """Processor time of a cell of the reference, s."""
        return float(np.mean([part.reference_seconds for part in self.parts]))

    def cheapest(self, target: float) -> Summary | None:
        """Cheapest numerical setting whose worst relative error of Vs meets a target; None if there is none."""
        meeting = [
            row for row in self.summaries if row.numerical and row.cells and not row.lost and row.worst <= target
        ]
        return min(meeting, key=lambda row: row.seconds, default=None)

    @property
    def pareto(self) -> tuple[Summary, ...]:
        """Settings that no other beats in both median error and run time (Pareto front), fastest first."""
        front: list[Summary] = []
        for row in sorted((s for s in self.summaries if s.numerical and s.cells), key=lambda s: (s.seconds, s.median)):
            if not front or row.median < front[-1].median:
                front.append(row)
        return tuple(front)


def accuracy(
    configuration: Configuration,
    cells: Cells,
    compared: Sequence[Setting],
    *,
    rounds: int = ROUNDS,
    former: Path | None = None,
    tell: Callable[[StudyResult], object] = lambda _: None,
) -> StudyResult:
    """Measure error over run time, see `run_study`.

    ``tell`` receives the results after each content. Contents in the JSON file ``former``, which may not exist, are not
    measured again.

    `ValueError` if no content can be computed; `OutputRefusedError` if the file has the results of another
    configuration, packing, choice of seeds or of settings.
    """
    identity = {
        "campaign_hash": configuration.hash,
        "packing_hash": cells.experiment.packing.content_hash,
        "seeds": list(cells.seeds),
        "settings": [one.name for one in compared],
    }

    def result(study: Study) -> StudyResult:
        tables = accuracy_tables(study)
        text = "\n\n".join(tables.values())
        page = "\n\n".join(f"<!-- {name} -->\n{table}\n<!-- end -->" for name, table in tables.items()) + "\n"
        told = TypeAdapter(dict[str, Any]).dump_json({**identity, **asdict(study)}).decode()
        rows = [asdict(cell) for cell in study.cells]
        return StudyResult(text, page, rows, told, figures={"": partial(draw_error_against_run_time, study)})

    known = {part.content: part for part in read_former(former, identity, "parts", list[ContentErrors])}
    return result(run_study(cells, compared, rounds=rounds, known=known, tell=lambda study: tell(result(study))))


def choose_settings(cells: Cells, only: Sequence[str]) -> list[Setting]:
    """Return the default and the settings of these names, all without names; `ValueError` for an unknown name."""
    known = {setting.name: setting for setting in settings(cells.experiment, cells.contents)}
    for name in only:
        if name not in known:
            raise ValueError(f"only = '{name}': choose among {', '.join(map(repr, known))}")
    return [known[DEFAULT], *(known[name] for name in only or known if name != DEFAULT)]


def run_study(
    cells: Cells,
    compared: Sequence[Setting],
    *,
    coarsest: float = 0.4,
    rounds: int = ROUNDS,
    known: Mapping[float, ContentErrors] | None = None,
    tell: Callable[[Study], object] = lambda _: None,
) -> Study:
    """Measure the errors of settings.

    The experiment's own setting comes first in ``compared``, see `choose_settings`. The search for the reference starts
    at a step of ``coarsest`` times the limit. Settings are timed alternately in ``rounds``. ``known`` contents are not
    measured again, and are results whether they are asked for or not. ``tell`` receives the results after each content.
    A refused content has none; `ValueError` if all are refused.
    """
    found_parts = dict(known or {})

    def study() -> Study:
        parts = [found_parts[content] for content in sorted(found_parts)]
        summaries = (
            Summary.of(one.name, parts, numerical=one.numerical, adds=one.adds, why=one.why) for one in compared
        )
        return Study(tuple(parts), tuple(summaries))

    for content in cells.contents:
        if content in found_parts:
            cells.progress(f"{content:g} %: known from an earlier start")
            continue
        cells.progress(f"{content:g} %: reference")
        try:
            exact, references, taken = find_reference(cells, content, coarsest)
            found, seconds = cells.take_turns({one.name: one.experiment for one in compared}, content, rounds)
        except ValueError as refused:
            cells.progress(f"{content:g} %: {refused}")
            if content == cells.contents[-1] and not found_parts:
                raise
            continue
        errors = tuple(CellError.compare(name, own[key], exact[key]) for name, own in found.items() for key in exact)
        found_parts[content] = ContentErrors(content, references, errors, taken, seconds)
        tell(study())
    return study()


def covered_share(errors: Iterable[float | None], stated: Iterable[float | None]) -> float:
    """Share of errors within the 95 % interval of their stated standard error, of those with both; NaN of none."""
    known = [
        abs(error) <= NORMAL_95 * own
        for error, own in zip(errors, stated, strict=True)
        if error is not None and own is not None
    ]
    return float(np.mean(known)) if known else np.nan


def find_reference(
    cells: Cells, content: float, coarsest: float
) -> tuple[CellsFound, tuple[ReferenceCell, ...], float]:
    """Measure a content accurately: the step of each cell is halved until its Vs changes by less than `HALVING`.

    A reference has double precision, the finite law, all disks and dense samples. A cell that still changes at `FINEST`
    keeps this step and records its change. Returns the measurements, their reference cells, and the mean processor time
    of a cell, s.
    """
    exact = replace(cells.experiment, is_checked=False).with_wave(
        precision="float64",
        law="finite",
        whole_domain=True,
        samples_per_period=max(REFERENCE_SAMPLES, cells.experiment.wave.samples_per_period),
    )
    step, waiting = coarsest, list(cells.seeds)
    before = cells.measure(exact.with_wave(step_fraction=step), [content])
    done: dict[int, tuple[Measurement, ReferenceCell, float]] = {}
    while waiting:
        step /= 2.0
        now, seconds = cells.measure_and_time(exact.with_wave(step_fraction=step), content, waiting)
        for seed in waiting:
            cell = now[seed, content]
            change = relative_deviation(cell.vs, before[seed, content].vs)
            if change is None or abs(change) < HALVING or step <= FINEST:
                done[seed] = cell, ReferenceCell(seed, content, cell.vs, step, change), seconds
        waiting = [seed for seed in waiting if seed not in done]
        before = now
    found = {(seed, content): done[seed][0] for seed in cells.seeds}
    return found, tuple(done[seed][1] for seed in cells.seeds), float(np.mean([one[2] for one in done.values()]))


def accuracy_tables(study: Study) -> dict[str, str]:
    """Return all measured tables as Markdown, by name."""
    cheapest = [(target, study.cheapest(target / 100.0)) for target in (0.5, 0.2, 0.1)]  # percent of Vs
    wanted = [
        f"- {target:g} %: {'none of those measured' if one is None else f'{one.setting}, {one.seconds:.2f} s a cell'}"
        for target, one in cheapest
    ]
    parts = {
        "opening": _opening(study),
        "settings": _settings_table(study),
        "left_out": _left_out_table(study),
        "targets": "\n".join(["Cheapest setting whose worst error stays below a target:\n", *wanted]),
        "contents": _content_table(study),
    }
    return {name: table for name, table in parts.items() if table}


def _left_out_table(study: Study) -> str:
    """Return what the computation leaves out, why that is safe, and what it would cost."""
    own = study.summaries[0]
    rows = [
        (
            row.adds,
            row.why,
            f"{row.seconds / own.seconds:.2f} x the time",
            row.change if np.isfinite(row.change) else "no velocity to compare",
        )
        for row in study.summaries
        if row.adds and np.isfinite(row.seconds)
    ]
    return markdown_table(("left out", "why that is safe", "with it", "Vs changes by at most"), rows)


def _opening(study: Study) -> str:
    """Summarise the most important numbers."""
    row = study.summaries[0]
    changes = [abs(cell.halving) for cell in study.references if cell.halving is not None]
    if not row.cells:
        return "No cell has a velocity with the default and in the reference."
    of_vs, of_effective = _covered(study.parts)
    return (
        f"Default against the reference, {pluralize(row.cells, 'cell')}: median {row.median:.1e}, worst "
        f"{row.worst:.1e}, of the effective velocity {row.effective_median:.1e} and {row.effective_worst:.1e}; "
        f"{study.reference_seconds / row.seconds:.0f} times faster ({row.seconds:.2f} s against "
        f"{study.reference_seconds:.1f} s of processor time a cell). The last halving of the reference's step "
        f"changed Vs by {max(changes, default=0.0):.1e} at most; {sum(change < HALVING for change in changes)} of "
        f"{pluralize(len(changes), 'cell')} changed by less than {HALVING:g}. "
        f"The error is within 1.96 stated standard errors in {of_vs} of the cells, that of the effective "
        f"velocity in {of_effective}."
    )


def _covered(parts: Iterable[ContentErrors]) -> tuple[str, str]:
    """Shares of the default's cells with an error of Vs, and of the effective velocity, within the stated one."""
    cells = [cell for part in parts for cell in part.cells if cell.setting == DEFAULT]
    stated = [cell.stated for cell in cells]
    of_vs = covered_share([cell.vs_deviation for cell in cells], stated)
    of_effective = covered_share([cell.effective_deviation for cell in cells], stated)
    first, second = (f"{100 * share:.0f} %" if np.isfinite(share) else "-" for share in (of_vs, of_effective))
    return first, second


def _settings_table(study: Study) -> str:
    """Return one line for each setting; those that change the exact answer are marked."""
    errors = ("Vs median", "worst", "effective Vs median", "worst", "first arrival", "signal (L2)")
    rows = [
        (
            row.setting if row.numerical else f"*{row.setting}*",
            *(row.median, row.worst, row.effective_median, row.effective_worst, row.arrival, row.signal),
            f"{row.seconds:.3f}",
            row.lost,
        )
        for row in study.summaries
        if row.cells or row.lost  # not for a setting that was refused at all contents
    ]
    return markdown_table(("setting", *errors, "s a cell", "cells lost"), rows)


def _content_table(study: Study) -> str:
    """Return reference and default at each content."""
    rows = []
    for part in study.parts:
        own = Summary.of(DEFAULT, [part])
        of_vs, of_effective = _covered([part])
        rows.append(
            (
                f"{part.content:g}",
                own.cells,
                f"{min(cell.step_fraction for cell in part.references):g}",
                max((abs(cell.halving) for cell in part.references if cell.halving is not None), default=None),
                next(cell.stated for cell in part.cells if cell.setting == DEFAULT),
                *(own.median, own.worst, of_vs),
                *(own.effective_median, own.effective_worst, of_effective),
            )
        )
    header = (
        *("content %", "cells", "reference's step / limit, smallest", "Vs by its last halving, largest"),
        "stated standard error",
        *("error of Vs: median", "worst", "within 1.96 of it"),
        *("error of effective Vs: median", "worst", "within 1.96 of it"),
    )
    return markdown_table(header, rows)


@apply_style
def draw_error_against_run_time(study: Study) -> "Figure":
    """Draw median and largest error of Vs over the processor time of a cell."""
    figure = new_figure(3.6)
    axes = figure.subplots()
    rows = [row for row in study.summaries if row.numerical and row.cells]
    front = study.pareto

    def drawable(error: float) -> float:
        return max(error, 1e-6)  # smaller errors, including zero, are drawn there

    axes.plot([row.seconds for row in front], [drawable(row.median) for row in front], color=BLUE, label="Pareto front")
    for row in rows:
        colour = VERMILION if row.setting == DEFAULT else BLUE if row in front else GREY
        axes.plot([row.seconds] * 2, [drawable(row.median), drawable(row.worst)], color=colour, linewidth=0.8)
        size = 5 if row.setting == DEFAULT else 3
        axes.plot(row.seconds, drawable(row.median), "o", color=colour, markersize=size)
    named = sorted({*front, *(row for row in rows if row.setting == DEFAULT)}, key=lambda row: row.seconds)
    for place, row in enumerate(named):
        # Labels are below the marks and their bars, and staggered, since settings of equal cost are close together.
        axes.annotate(
            row.setting,
            (row.seconds, drawable(row.median)),
            xytext=(-10, -10 - 9 * (place % 4)),
            textcoords="offset points",
            fontsize=6.5,
            color=BLACK,
            ha="right",
            arrowprops={"arrowstyle": "-", "color": GREY, "linewidth": 0.5, "shrinkA": 0, "shrinkB": 2},
        )
    axes.axvline(study.reference_seconds, color=GREY, linestyle=":", label="reference")
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="processor time of a cell (s)",
        ylabel="relative error of $V_s$: median to worst",
        xlim=(0.3 * min((row.seconds for row in rows), default=0.01), 1.5 * study.reference_seconds),
        ylim=(0.4 * min((drawable(row.median) for row in rows), default=1e-6), None),
    )
    axes.legend(loc="lower left")
    return figure
