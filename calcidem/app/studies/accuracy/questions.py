"""Tables with their own reference: order of convergence, strength of the pulse, balance of the packing, scatter.

Another amplitude of the pulse is another physical problem. The reference of every amplitude is therefore the finite
law at the same step and samples. The reference of a packing is the same packing closer to equilibrium. The numerical
error of a mean is compared with its statistical error.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calcidem.analysis.distribution import Distribution
from calcidem.app.campaign.packing import new_packing
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.accuracy.settings import DEFAULT, REFERENCE_SAMPLES, unchecked
from calcidem.app.studies.accuracy.study import Study
from calcidem.app.studies.study import Cells, CellsFound, at_common_times, errors_of_vs
from calcidem.dem.engine.assembly import pair_keys
from calcidem.dem.engine.scene import Preload
from calcidem.dem.kernels.layout import Floats
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.reading import smooth
from calcidem.dem.wave.rule import Law
from calcidem.dem.wave.section import Section

Rows = list[dict[str, Any]]
"""Rows of a table by the names of its columns; None where a value is missing."""


def answer_questions(
    study: Study, configuration: Configuration, cells: Cells, velocities: Mapping[float, Sequence[float]] | None
) -> dict[str, Rows]:
    """Tables with their own reference, by name.

    Velocities of a stored campaign at each content, m/s, give the scatter; with None a few samples are measured.
    """
    all_seeds = configuration.campaign.seed_numbers

    def packing_of(ratio: float) -> Packing:
        # A stored packing may come from another version and then be another sample, not the same at another ratio.
        rule = replace(configuration.packing, unbalanced_force_ratio=ratio)
        return new_packing(replace(configuration, packing=rule))

    convergence = _convergence_rows(cells, study)
    if velocities is None:
        cells.progress("scatter of the samples")
        found = cells.measure(cells.experiment, seeds=all_seeds[:16])
        velocities = {
            content: [cell.vs for cell in found.values() if cell.content == content and cell.vs is not None]
            for content in cells.contents
        }
    return {
        "convergence": convergence,
        "amplitudes": amplitude_rows(cells),
        "equilibrium": equilibrium_rows(cells, packing_of),
        "scatter": _scatter_rows(study, velocities, len(all_seeds)),
    }


def _convergence_rows(cells: Cells, study: Study) -> Rows:
    """Order of convergence at each content with a velocity of the reference."""
    rows, own = [], unchecked(cells.experiment).wave.law
    for content in dict.fromkeys(cell.content for cell in study.references if cell.vs is not None):
        known: tuple[tuple[bool, Law], ...] = ((True, own), (False, "linear"), (False, "finite"))
        for damped, law in known:
            words = "as configured" if damped else "none"
            cells.progress(f"{content:g} %: order of convergence, damping {words}, {law}")
            changes, orders = signal_convergence(cells, content, damped=damped, law=law)
            columns = (f"signal, {2 * step:g} to {step:g}" for step in CONVERGENCE_STEPS[1:])
            rows.append(
                {
                    "content %": content,
                    "law": law,
                    "local damping": words,
                    **dict(zip(columns, changes, strict=True)),
                    **{f"order {place}": order for place, order in enumerate(orders, 1)},
                }
            )
    return rows


CONVERGENCE_STEPS = (0.8, 0.4, 0.2, 0.1)
"""Steps over the limit; each is half of the previous one."""


def signal_convergence(
    cells: Cells, content: float, *, damped: bool, law: Law = "linear"
) -> tuple[list[float], list[float]]:
    """Change of the signal by each halving of the step, and the orders of convergence, medians over the cells.

    A change is the normalised L2 distance at the sampling times of the largest step. An order is the logarithm to base
    2 of a change over the next, without an exact solution. Without ``damped`` there is no damping.

    Local damping opposes the velocity half a step before, whose sign changes within a step: an error of first order.
    The shear-force increment of a sticking contact with changing stiffness, as in the finite law, has the same order.
    All other errors are of second order, as the linear law without damping shows.
    """
    even = replace(cells.experiment, is_checked=False, installation="preserve").with_wave(
        law=law,
        precision="float64",
        samples_per_period=REFERENCE_SAMPLES,
        **({} if damped else {"damping": 0.0, "boundary_damping": 0.0}),
    )
    runs = [cells.measure(even.with_wave(step_fraction=step), [content]) for step in CONVERGENCE_STEPS]
    sections = [[run[seed, content].section for run in runs] for seed in cells.seeds]
    changes = np.median([_signal_changes(cell, even.pick.smoothing) for cell in sections], axis=0)
    return changes.tolist(), np.log2(changes[:-1] / changes[1:]).tolist()


def _signal_changes(sections: Sequence[Section], smoothing: float) -> Floats:
    """Change from each section to the next, at the times of the first.

    Smoothing removes the quantisation of recorded velocities, which is as large as the smallest change.
    """
    signals = [smooth(section.received, smoothing * section.period) for section in sections]
    times = [section.times[: len(signal)] for section, signal in zip(sections, signals, strict=True)]
    signals = at_common_times(times, signals, times[0])
    size = np.linalg.norm(signals[-1])
    return np.array([np.linalg.norm(fine - coarse) / size for coarse, fine in itertools.pairwise(signals)])


def amplitude_rows(
    cells: Cells,
    amplitudes: Sequence[float] = (1.0e-5, 1.0e-4, 1.0e-3, 1.0e-2, 1.0e-1),  # m/s
) -> Rows:
    """Measure the linear law at several amplitudes against the finite law at the same amplitude.

    For the finite law itself the row has the deviation from the velocity at the experiment's amplitude: not an error,
    but the effect of the pulse's strength. Lost cells have a velocity with the finite law only.
    """

    def measured(law: Law, amplitude: float) -> tuple[CellsFound, str]:
        setting = replace(cells.experiment, is_checked=False)
        setting = setting.with_wave(law=law, amplitude=amplitude, samples_per_period=400)
        found: CellsFound = {}
        refusal = ""
        for content in cells.contents:
            try:
                found = {**found, **cells.measure(setting, [content])}
            except ValueError as refused:
                refusal = str(refused)
        return found, refusal

    own, _ = measured("finite", cells.experiment.wave.amplitude)
    rows = []
    for amplitude in amplitudes:
        cells.progress(f"laws at {amplitude:g} m/s")
        finite, refusal = measured("finite", amplitude)
        compared = [("finite, effect of the amplitude", finite, own, refusal)]
        if cells.experiment.installation == "preserve":
            linear, refusal = measured("linear", amplitude)
            compared.append(("linear", linear, finite, refusal))
        for name, found, exact, refusal in compared:
            errors = errors_of_vs(found, exact)
            rows.append(
                {
                    "amplitude, m/s": amplitude,
                    "law": name,
                    "Vs median": float(np.median(errors)) if errors else None,
                    "Vs worst": max(errors, default=None),
                    "cells": len(errors),
                    "cells lost": sum(cell.vs is not None for cell in exact.values()) - len(errors),
                    "refused": refusal.split(":")[0],
                }
            )
    return rows


def equilibrium_rows(
    cells: Cells, packing_of: Callable[[float], Packing], ratios: Sequence[float] = (1.0e-4, 1.0e-5, 1.0e-6, 1.0e-7)
) -> Rows:
    """Measure Vs in packings of several unbalanced-force ratios, with the cement at the same contacts.

    ``packing_of`` makes the experiment's packing for a ratio; that of the smallest ratio is the reference.
    """
    packings = {}
    for ratio in ratios:
        cells.progress(f"packing with an unbalanced-force ratio of {ratio:g}")
        packings[ratio] = packing_of(ratio)
    best = packings[min(ratios)]
    found = {
        ratio: cells.measure(replace(unchecked(cells.experiment), packing=_same_contacts(packing, best)))
        for ratio, packing in packings.items()
    }
    rows = []
    for ratio, packing in packings.items():
        errors = errors_of_vs(found[ratio], found[min(ratios)])
        rows.append(
            {
                "unbalanced-force ratio": ratio,
                "changed contacts": len(set(_keys_of(packing)) ^ set(_keys_of(best))),
                "Vs median": float(np.median(errors)) if errors else None,
                "Vs worst": max(errors, default=None),
                "cells": len(errors),
            }
        )
    return rows


def _same_contacts(packing: Packing, model: Packing) -> Packing:
    """Packing with the contact list of another one, so that cement is drawn at the same places.

    Positions determine touching contacts; the list determines possible cement and contacts with shear.
    """
    known = dict(zip(_keys_of(packing), np.asarray(packing.preload.shear).tolist(), strict=True))
    shear = np.array([known.get(key, 0.0) for key in _keys_of(model)])
    return replace(packing, preload=Preload(model.pairs, shear))


def _keys_of(packing: Packing) -> list[int]:
    """Key of each contact."""
    keys: list[int] = pair_keys(packing.pairs, len(packing.radius)).tolist()
    return keys


def _scatter_rows(study: Study, velocities: Mapping[float, Sequence[float]], seeds: int) -> Rows:
    """Compare the errors of a study's default setting with the scatter of the samples.

    ``velocities`` has samples of Vs at each content, m/s; ``seeds`` is the number of seeds of the campaign's mean. The
    mean error with its sign is the bias of the campaign's mean: unlike the statistical error it does not fall with the
    number of seeds.
    """
    errors: dict[float, list[float]] = {}
    for cell in study.cells:
        if cell.setting == DEFAULT and cell.vs_error is not None:
            errors.setdefault(cell.content, []).append(cell.vs_error)
    rows = []
    for content, found in sorted(errors.items()):
        samples = velocities.get(content, ())
        if len(samples) < 2:  # a scatter needs two
            continue
        spread = Distribution.of_sample(list(samples))
        deviation, sizes = spread.standard_deviation / spread.mean, np.abs(found)
        rows.append(
            {
                "content %": content,
                "numerical error: median": float(np.median(sizes)),
                "worst": float(np.max(sizes)),
                "mean with sign": float(np.mean(found)),
                "scatter (sd / mean)": deviation,
                "of samples": len(samples),
                f"statistical error of the mean of {seeds} seeds": deviation / float(np.sqrt(seeds)),
            }
        )
    return rows
