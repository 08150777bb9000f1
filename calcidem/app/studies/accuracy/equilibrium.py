"""How much what is left unbalanced in a packing moves Vs: the same packing, left to come to rest more or less."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calcidem.app.studies.accuracy.reference import fitting_lanes, relative_deviation
from calcidem.dem.engine.assembly import pair_keys
from calcidem.dem.engine.scene import Preload
from calcidem.dem.sample.packing import Packing
from calcidem.dem.wave.experiment import Experiment
from calcidem.dem.wave.measurement import measure_all

_RATIOS = (1.0e-4, 1.0e-5, 1.0e-6, 1.0e-7)  # unbalanced-force ratios; the smallest is taken for exact


@dataclass(frozen=True, slots=True)
class EquilibriumRow:
    """A packing that was left at some unbalanced-force ratio.

    Attributes
    ----------
    unbalanced_force_ratio
        That ratio.
    changed_contacts
        Contacts that touch here or in the packing with the smallest ratio, but not in both.
    cells
        Compared.
    median, worst
        Relative error of Vs against the packing with the smallest ratio, all else equal.
    """

    unbalanced_force_ratio: float
    changed_contacts: int
    cells: int
    median: float
    worst: float


def equilibrium_rows(
    experiment: Experiment,
    contents: Sequence[float],
    seeds: Sequence[int],
    packing_of: Callable[[float], Packing],
    ratios: Sequence[float] = _RATIOS,
    *,
    lanes: int = 8,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[EquilibriumRow, ...]:
    """Measure Vs in packings of several unbalanced-force ratios, with the cement at the same contacts.

    ``packing_of`` makes the experiment's packing for a ratio.
    """
    packings = {}
    for ratio in ratios:
        progress(f"packing with an unbalanced-force ratio of {ratio:g}")
        packings[ratio] = packing_of(ratio)
    velocities = {}
    best = min(ratios)
    for ratio, packing in packings.items():
        setting = replace(experiment, packing=_same_contacts(packing, packings[best]))
        cells = [
            cell
            for content in contents
            for cell in measure_all(setting, content, seeds, lanes=fitting_lanes(seeds, lanes))
        ]
        velocities[ratio] = [cell.vs for cell in cells]
    rows = []
    for ratio in ratios:
        pairs = zip(velocities[ratio], velocities[best], strict=True)
        errors = [abs(error) for found, exact in pairs if (error := relative_deviation(found, exact)) is not None]
        changed = set(_keys_of(packings[ratio]).tolist()) ^ set(_keys_of(packings[best]).tolist())
        rows.append(
            EquilibriumRow(ratio, len(changed), len(errors), float(np.median(errors)), max(errors, default=np.inf))
        )
    return tuple(rows)


def _same_contacts(packing: Packing, model: Packing) -> Packing:
    """Packing with the list of contacts of another one, so that cement is drawn at the same places.

    Which contacts touch is a matter of the positions; the list says where cement may go and which carry shear.
    """
    known = dict(zip(_keys_of(packing).tolist(), np.asarray(packing.preload.shear).tolist(), strict=True))
    shear = np.array([known.get(key, 0.0) for key in _keys_of(model).tolist()])
    return replace(packing, preload=Preload(model.pairs, shear))


def _keys_of(packing: Packing) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """One number for each contact."""
    return pair_keys(packing.pairs, len(packing.radius))
