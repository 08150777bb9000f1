"""Guards of a running wave: what makes a sample's numbers untrustworthy, looked for at every chunk of the record.

An unstable explicit scheme grows by a constant factor each step: 1 % above the limit a velocity doubles in three
steps, so whatever starts between two looks is beyond every bound at the second.
"""

import numpy as np

from calcidem.dem.kernels.layout import Floats
from calcidem.dem.material import require
from calcidem.dem.readout import net_forces, overlaps, wall_overlaps
from calcidem.dem.stability import critical_time_step
from calcidem.dem.state import State

BLOW_UP = 30.0  # velocity over the amplitude of the pulse at which a run has gone wrong; waves stay below about 5
RESTLESS = 1e-3  # velocity that unbalanced forces make over the amplitude of the pulse
NOTICEABLE = 0.1  # motion over mean overlap below which stiffnesses change by less than the margin of the step


def problem_of(state: State, lane: int, amplitude: float, overlap: float) -> str:
    """Why a lane cannot be trusted any more, empty if it can.

    Parameters
    ----------
    state, lane
        What to look at.
    amplitude
        Of the pulse, m/s; nothing moves much faster in a sample that was at rest.
    overlap
        Mean overlap of the contacts at the start, m.
    """
    speed = np.abs(state.motion.velocity[:, :2, lane]).max(axis=1)
    # NaN compares with nothing, so it is asked for by what it is not.
    if not speed.max() <= BLOW_UP * amplitude:
        return f"{named(state, speed)} moves at {speed.max():.3g} m/s after {state.steps} steps"
    motion = np.abs(state.motion.displacement[:, :2, lane]).max(axis=1)
    if state.features.linear:
        return ""
    if not state.features.search and state.features.finite and motion.max() > 0.5 * state.skin:
        return f"{named(state, motion)} moved {motion.max():.3g} m, out of reach of its list of neighbours"
    broken = state.assembly.pairs.cemented & ~state.assembly.pairs.intact
    count = int(np.count_nonzero(broken >> np.uint32(lane) & 1))
    if count:
        return f"{count} bonds broke within {state.steps} steps: the pulse changes the sample; lower wave.amplitude"
    if motion.max() > NOTICEABLE * overlap:
        limit = float(present_limit(state)[lane])
        if state.time_step[lane] > limit:
            return (
                f"the step of {state.time_step[lane]:.3g} s is above the stability limit of the pressed contacts "
                f"after {state.steps} steps, {limit:.3g} s: lower wave.step_fraction or wave.amplitude"
            )
    return ""


def refuse_restless(state: State, amplitude: float) -> None:
    """Raise a `ValueError` if unbalanced forces alone would move the disks of a sample nearly as a pulse does.

    A disk with the net force F swings with about ``F / (m omega)``, and the stability limit is near ``2 / omega``.
    The linear regime takes the reference state for balanced.
    """
    if state.features.linear:
        return
    for lane in range(state.features.lanes):
        force = np.hypot(*net_forces(state, lane)[:, :2].T)
        speed = float(np.sqrt(np.mean((force / state.scene.mass) ** 2))) * float(state.limit[lane]) / 2.0
        require(
            speed <= RESTLESS * amplitude,
            "amplitude",
            amplitude,
            f"unbalanced forces of the packing alone move its disks at {speed:.3g} m/s, more than {RESTLESS:g} of the "
            'pulse: choose a stronger pulse, regime = "linear", or a smaller packing.balance',
        )


def named(state: State, values: Floats) -> str:
    """Name of the disk with the largest value; the first that is not a number, if there is one."""
    return f"disk {int(state.assembly.order[int(np.argmax(values))])}"


def present_limit(state: State) -> Floats:
    """Stability limit at the present overlaps, (L,) s: Hertz contacts stiffen under load."""
    return critical_time_step(state.scene, state.assembly, state.features, overlaps(state), wall_overlaps(state))
