"""Guards of a running wave: what makes a sample's numbers untrustworthy, looked for at every chunk of the record.

An unstable explicit scheme grows by a constant factor each step: 1 % above the limit a velocity doubles in three
steps, so whatever starts between two looks is beyond every bound at the second.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from calcidem.dem.engine.assembly import lanes_of_bits
from calcidem.dem.engine.fields import require
from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.portable import length
from calcidem.dem.engine.readout import net_forces, overlaps, wall_overlaps
from calcidem.dem.engine.stability import critical_time_step, hertz_tangent
from calcidem.dem.kernels.layout import Floats, Integers

_BLOW_UP = 30.0  # velocity over the amplitude of the pulse at which a run has gone wrong; waves stay below about 5
_LARGEST_UNBALANCED_SPEED = 1e-3  # over the amplitude of the pulse
_NOTICEABLE = 0.1  # motion over mean overlap below which stiffnesses change by less than the margin of the step


def problems_of(state: State, amplitude: float, overlap: float, breakable: float = 0.0) -> list[str]:
    """Why each lane cannot be trusted any more, empty for those that can.

    Parameters
    ----------
    state
        What to look at; all lanes are looked at together, at about the cost of one.
    amplitude
        Of the pulse, m/s; nothing moves much faster in a sample that was at rest.
    overlap
        Mean overlap of the contacts at the start, m.
    breakable
        Part of its bonds that a sample may lose.
    """
    problems = [""] * state.features.lanes
    # NaN compares with nothing, so it is asked for by what it is not.
    for lane in np.flatnonzero(~(_largest_translation(state.motion.velocity) <= _BLOW_UP * amplitude)).tolist():
        speed = np.abs(state.motion.velocity[:, :2, lane]).max(axis=1)
        problems[lane] = f"{_name_disk(state, speed)} moves at {speed.max():.3g} m/s after {state.steps} steps"
    if state.features.linear:
        return problems
    motion = _largest_translation(state.motion.displacement)
    found = (
        _find_unlisted_neighbours(state, motion),
        _find_broken_bonds(state, breakable),
        _find_steps_above_limit(state, motion, overlap),
    )
    for lane, problem in chain(*found):
        problems[lane] = problems[lane] or problem
    return problems


def _find_unlisted_neighbours(state: State, motion: Floats) -> Iterator[tuple[int, str]]:
    """Give the lanes in which a disk may have met one that is not in the list of pairs."""
    if state.features.search or not state.features.finite:
        return
    for lane in np.flatnonzero(motion > 0.5 * state.skin).tolist():
        moved = np.abs(state.motion.displacement[:, :2, lane]).max(axis=1)
        yield lane, f"{_name_disk(state, moved)} moved {moved.max():.3g} m, out of reach of its list of neighbours"


def broken_bonds(state: State) -> Integers:
    """(L,) bonds that broke; nothing is counted where the kernel breaks none."""
    pairs, lanes = state.assembly.pairs, state.features.lanes
    if not state.features.breakage or not (pairs.cemented ^ pairs.intact).any():
        return np.zeros(lanes, dtype=np.int64)
    return np.asarray(np.count_nonzero(lanes_of_bits(pairs.cemented ^ pairs.intact, lanes), axis=0))


def cemented_bonds(state: State) -> Integers:
    """(L,) bonds that a sample was given."""
    return np.asarray(np.count_nonzero(lanes_of_bits(state.assembly.pairs.cemented, state.features.lanes), axis=0))


def _find_broken_bonds(state: State, breakable: float) -> Iterator[tuple[int, str]]:
    """Give the lanes in which more bonds broke than may."""
    broken = broken_bonds(state)
    if not broken.any():
        return
    for lane in np.flatnonzero(broken > breakable * cemented_bonds(state)).tolist():
        count = broken[lane]
        yield lane, f"{count} bonds broke within {state.steps} steps: the pulse changes the sample; lower amplitude"


def _find_steps_above_limit(state: State, motion: Floats, overlap: float) -> Iterator[tuple[int, str]]:
    """Give the lanes whose step is above the limit of the contacts as they are pressed now."""
    noticed = (motion > _NOTICEABLE * overlap) & (state.time_step > cheap_limit(state))
    if not noticed.any():
        return
    limit = _present_limit(state)
    for lane in np.flatnonzero(noticed & (state.time_step > limit)).tolist():
        problem = (
            f"the step of {state.time_step[lane]:.3g} s is above the stability limit of the pressed contacts "
            f"after {state.steps} steps, {limit[lane]:.3g} s: lower step_fraction or amplitude"
        )
        yield lane, problem


def _largest_translation(field: Floats) -> Floats:
    """(L,) largest absolute value of the translations in each lane; not a number if one of them is none."""
    # All components of a disk at once, rotation too: a long contiguous row is reduced much faster.
    translations: Floats = np.abs(field).max(axis=0)[:2]
    both: Floats = translations.max(axis=0)
    return both


def unbalanced_speed(state: State, amplitude: float) -> Floats:
    """(L,) speed at which unbalanced forces alone move the disks of a sample, rms, over the amplitude of the pulse.

    A disk with the net force F swings with about ``F / (m omega)``. Omega is that of the pressed contacts, from their
    limit ``2 / omega``: bonds are far stiffer, but disks without a bond do not feel them. The linear regime takes the
    reference state for balanced. `ValueError` if that is more than `_LARGEST_UNBALANCED_SPEED`.
    """
    lanes = state.features.lanes
    if state.features.linear:
        return np.zeros(lanes)
    pressed = replace(state.features, bonds=False, breakage=False, linear_group=False)
    swing = critical_time_step(state.scene, state.assembly, pressed) / 2.0
    speed = np.empty(lanes)
    for lane in range(lanes):
        force = length(*net_forces(state, lane)[:, :2].T)
        speed[lane] = float(np.sqrt(np.mean((force / state.scene.mass) ** 2))) * float(swing[lane])
    require(
        bool(np.all(speed <= _LARGEST_UNBALANCED_SPEED * amplitude)),
        "amplitude",
        amplitude,
        f"unbalanced forces of the packing alone move its disks at {speed.max():.3g} m/s, more than "
        f'{_LARGEST_UNBALANCED_SPEED:g} of the pulse: choose a stronger pulse, regime = "linear", or a packing with a '
        "smaller unbalanced_force_ratio",
    )
    return speed / amplitude


def _name_disk(state: State, values: Floats) -> str:
    """Say which disk has the largest value; the first that is not a number, if there is one.

    By its place, since disks that the wave cannot reach are left out and the others numbered anew.
    """
    disk = int(state.assembly.order[int(np.argmax(values))])
    return f"the disk at ({state.scene.x[disk]:.5g}, {state.scene.y[disk]:.5g}) m"


def cheap_limit(state: State) -> Floats:
    """Lower bound (L,) of the present stability limit, s, for a tenth of its price.

    To the matrices of `stability.critical_time_step` at the start each Hertz contact adds at most its own largest
    eigenvalue, ``max(k_n, 3 k_s)``. Where stiff bonds set the step, that is next to nothing however hard it is pressed.
    """
    pairs, wall_pairs, grains = state.assembly.pairs, state.assembly.wall_pairs, state.assembly.grains
    normal = np.zeros((len(grains.radius), state.features.lanes))
    pressed, leaning = (
        hertz_tangent(pairs.hertz, overlaps(state)),
        hertz_tangent(wall_pairs.hertz, wall_overlaps(state)),
    )
    for disk, stiffness in ((pairs.first, pressed), (pairs.second, pressed), (wall_pairs.disk, leaning)):
        np.add.at(normal, disk, stiffness)
    share = 2.0 * max(1.0, 3.0 * state.scene.sand.shear_ratio) * grains.inverse_mass * (1.0 + grains.damping)
    added = (share.astype(float)[:, None] * normal).max(axis=0)
    at_start = 2.0 / state.critical_time_step
    return np.asarray(2.0 / np.sqrt(at_start * at_start + added))


def _present_limit(state: State) -> Floats:
    """Stability limit at the present overlaps, (L,) s: Hertz contacts stiffen under load."""
    return critical_time_step(state.scene, state.assembly, state.features, overlaps(state), wall_overlaps(state))
