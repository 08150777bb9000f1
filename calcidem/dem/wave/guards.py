"""Guards of a running wave: each chunk of the record is checked for causes of unreliable results.

In an unstable explicit scheme velocities grow by a constant factor per step. 1 % above the limit they double in three
steps, so an instability between two checks exceeds every bound at the second.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from calcidem.dem.engine.assembly import lanes_of_bits
from calcidem.dem.engine.fields import require
from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.portable import length
from calcidem.dem.engine.readout import look_undamped, net_forces_from, overlaps, wall_overlaps
from calcidem.dem.engine.stability import critical_time_step, hertz_tangent
from calcidem.dem.kernels.layout import Floats, Integers


def problems_of(state: State, amplitude: float, overlap: float, breakable: float = 0.0) -> list[str]:
    """Problem of each lane; empty for lanes without one.

    Parameters
    ----------
    state
        State to check; all lanes together cost about as much as one.
    amplitude
        Amplitude of the pulse, m/s; nothing moves much faster in a sample that was at rest.
    overlap
        Mean overlap of the contacts at the start, m.
    breakable
        Largest permitted share of broken bonds.
    """
    problems = [""] * state.features.lanes
    # Comparisons with NaN are false, so the valid case is tested.
    # Waves stay below about five times the amplitude.
    for lane in np.flatnonzero(~(_largest_translation(state.motion.velocity) <= 30.0 * amplitude)).tolist():
        speed = np.abs(state.motion.velocity[:, :2, lane]).max(axis=1)
        problems[lane] = f"{_name_disk(state, speed)} moves at {speed.max():.3g} m/s after {state.steps} steps"
    if state.features.linear:
        return problems
    motion = _largest_translation(state.motion.displacement)
    found = (
        _find_broken_bonds(state, breakable),
        _find_steps_above_limit(state, motion, overlap),
    )
    for lane, problem in chain(*found):
        problems[lane] = problems[lane] or problem
    return problems


def broken_bonds(state: State) -> Integers:
    """(L,) number of broken bonds; zero if the kernel breaks none."""
    pairs, lanes = state.assembly.pairs, state.features.lanes
    if not state.features.breakage or not (pairs.cemented ^ pairs.intact).any():
        return np.zeros(lanes, dtype=np.int64)
    return np.asarray(np.count_nonzero(lanes_of_bits(pairs.cemented ^ pairs.intact, lanes), axis=0))


def cemented_bonds(state: State) -> Integers:
    """(L,) number of initial bonds."""
    return np.asarray(np.count_nonzero(lanes_of_bits(state.assembly.pairs.cemented, state.features.lanes), axis=0))


def _find_broken_bonds(state: State, breakable: float) -> Iterator[tuple[int, str]]:
    """Yield the lanes with too many broken bonds."""
    broken = broken_bonds(state)
    if not broken.any():
        return
    for lane in np.flatnonzero(broken > breakable * cemented_bonds(state)).tolist():
        count = broken[lane]
        yield lane, f"{count} bonds broke within {state.steps} steps: the pulse changes the sample; lower amplitude"


def _find_steps_above_limit(state: State, motion: Floats, overlap: float) -> Iterator[tuple[int, str]]:
    """Yield the lanes whose step exceeds the limit at the present overlaps."""
    # Below a tenth of the mean overlap stiffness changes stay within the margin of the step.
    noticed = (motion > 0.1 * overlap) & (state.time_step > cheap_limit(state))
    if not noticed.any():
        return
    # Hertz contacts stiffen under load.
    limit = critical_time_step(state.scene, state.assembly, state.features, overlaps(state), wall_overlaps(state))
    for lane in np.flatnonzero(noticed & (state.time_step > limit)).tolist():
        problem = (
            f"the step of {state.time_step[lane]:.3g} s is above the stability limit of the pressed contacts "
            f"after {state.steps} steps, {limit[lane]:.3g} s: lower step_fraction or amplitude"
        )
        yield lane, problem


def _largest_translation(field: Floats) -> Floats:
    """(L,) largest absolute value of the translations in each lane; NaN if one of them is NaN."""
    # All components including rotation are reduced at once: a long contiguous row is much faster.
    translations: Floats = np.abs(field).max(axis=0)[:2]
    both: Floats = translations.max(axis=0)
    return both


def unbalanced_speed(state: State, amplitude: float) -> Floats:
    """(L,) rms speed of the disks by unbalanced forces alone, over the amplitude of the pulse.

    A disk with the net force F oscillates with about ``F / (m omega)``. Omega follows from the limit ``2 / omega`` of
    the Hertz contacts; bonds are far stiffer, but do not affect disks without a bond. The linear regime assumes a
    balanced reference state. `ValueError` if the speed exceeds 0.001.
    """
    lanes = state.features.lanes
    if state.features.linear:
        return np.zeros(lanes)
    # Without bonds all lanes have the same limit.
    pressed = replace(state.features, lanes=1, bonds=False, breakage=False, linear_group=False)
    swing = float(critical_time_step(state.scene, state.assembly, pressed)[0]) / 2.0
    speed, ahead = np.empty(lanes), look_undamped(state)
    for lane in range(lanes):
        force = length(*net_forces_from(state, ahead, lane)[:, :2].T)
        speed[lane] = float(np.sqrt(np.mean((force / state.scene.mass) ** 2))) * swing
    require(
        bool(np.all(speed <= 1e-3 * amplitude)),
        "amplitude",
        amplitude,
        f"unbalanced forces of the packing alone move its disks at {speed.max():.3g} m/s, more than "
        '0.001 of the pulse: choose a stronger pulse, law = "linear", or a packing with a '
        "smaller unbalanced_force_ratio",
    )
    return speed / amplitude


def _name_disk(state: State, values: Floats) -> str:
    """Describe the disk with the largest value, or the first one with NaN.

    The place identifies it, since the computed disks are renumbered.
    """
    disk = int(state.assembly.order[int(np.argmax(values))])
    return f"the disk at ({state.scene.x[disk]:.5g}, {state.scene.y[disk]:.5g}) m"


def cheap_limit(state: State) -> Floats:
    """Lower bound (L,) of the present stability limit, s, at a tenth of its cost.

    To the initial matrices of `stability.critical_time_step` each Hertz contact adds at most its own largest
    eigenvalue, ``max(k_n, 3 k_s)``. If stiff bonds limit the step, this is negligible at any load.
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
