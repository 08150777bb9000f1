"""Starting and advancing a scene, with control of the time step. States are values: advancing returns a new one.

A wave is advanced elsewhere (`wave/propagation.py`), from the state that `start` gives.

Present contacts, speeds and unbalanced forces set the limit; the step is a part of it. Regular checks reduce the step
with its limit and never increase it. A step fixed by the caller ends the run instead.

Impacts limit the step beyond the present stiffness.

Disks that barely touch have little stiffness, and a step based on it skips their collision. The overlap reached in the
collision counts, at present speeds or under unbalanced forces: loads, gravity, a lid. Hertz's law gives the duration
of such a contact (Landau & Lifshitz, Theory of Elasticity, section 9).
"""

from dataclasses import replace
from typing import NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from calcidem.dem.engine.assembly import aligned_zeros, assemble, install_forces, lanes_of_bits, share_assembly
from calcidem.dem.engine.fields import require
from calcidem.dem.engine.leapfrog import (
    State,
    StepControl,
    change_step,
    duplicate,
    look_ahead,
    no_recording,
    run_in_place,
    start_leapfrog,
)
from calcidem.dem.engine.portable import length, root
from calcidem.dem.engine.readout import hertz_energy, overlaps, stored_energy, wall_overlaps
from calcidem.dem.engine.scene import Law, Precision, Preload, Scene
from calcidem.dem.engine.stability import (
    critical_time_step,
    critical_time_step_of_disks,
    stiffest_contacts,
    stiffest_disks,
    sums_at_disks,
)
from calcidem.dem.kernels.layout import (
    GAIN,
    NORMAL,
    NORMAL_SPEED,
    ROTATION,
    SPEEDS,
    STIFFNESS,
    TARGET,
    TOP_SPEED,
    XY,
    Features,
    Floats,
    Integers,
    Motion,
    X,
    Y,
)


class _Instant(NamedTuple):
    """Present motion, forces and energies of a state, in double precision and memory order."""

    velocity: Floats
    force: Floats
    """(N, 3, L) velocities (m/s, rad/s), and net forces (N/m) and moments (N)."""
    overlap: Floats
    wall_overlap: Floats
    """(M, L) and (V, L) of the listed pairs, m; those of two held disks, which move nothing, count as none."""
    reaction: Floats
    """(W, 3, L) as in `layout.Walls`."""
    kinetic: Floats
    stored: Floats
    """(L,) energies, J/m, see `readout.Energies`."""


def _contact_durations(state: State, now: _Instant) -> tuple[Floats, Floats]:
    """Duration of the shortest contact that each disk may make, (N, L) s, and the fastest speed, (L,) m/s.

    Infinite for held disks, and for those whose contacts have stored far more energy. Infinite for all disks if no
    listed contact is loose.

    Notes
    -----
    Two disks of reduced mass m* that collide at a speed v touch for ``3.218 (m*^2 / (h^2 v))^(1/5)``. Each disk is
    assumed to hit an equal one, at the sum of its own speed and the fastest speed. A heavier partner or a wall prolongs
    the contact. An unbalanced force F adds the rebound speed of a contact compressed by it: ``v^2 = 1.6 F d / m`` with
    ``F = h d^1.5``. Hence v stays constant during a collision, and is positive for a disk at rest before it falls.
    """
    scene, assembly = state.scene, state.assembly
    radius = assembly.grains.radius.astype(float)
    inverse = assembly.grains.inverse_mass.astype(float)[:, None]
    coefficient = scene.sand.hertz_coefficient(radius, radius)[:, None]
    mass = scene.sand.density * np.pi * (radius * radius)[:, None]
    speed, push = (length(field[:, X], field[:, Y]) for field in (now.velocity, now.force))
    walls = _wall_speeds(state, now.reaction)
    fastest = np.maximum(speed.max(axis=0), walls.max(axis=0, initial=0.0))
    depth = root(push / coefficient, 3)
    released = 0.8 * push * depth * depth * (inverse > 0.0)
    approach = np.sqrt((speed + fastest) ** 2 + 2.0 * released / mass)
    ratio = 0.5 * mass / coefficient
    with np.errstate(divide="ignore"):
        duration = 3.2180 / root(approach / (ratio * ratio), 5)  # 2.943275 (5/4)^(2/5)
    # Impacts of a disk do not matter if they supply at most 1 % of the energy in its own contacts, nor if all listed
    # contacts are cemented.
    loose = (~lanes_of_bits(assembly.pairs.intact, state.features.lanes)).any(axis=0) | (
        len(assembly.wall_pairs.disk) > 0
    )
    own, _ = hertz_energy(assembly.pairs.hertz, now.overlap)
    at_walls, _ = hertz_energy(assembly.wall_pairs.hertz, now.wall_overlap)
    matters = (0.5 * mass * approach * approach > 1e-2 * sums_at_disks(assembly, own, at_walls)) & loose
    return np.where((inverse > 0.0) & matters, duration, np.inf), fastest


def _wall_speeds(state: State, reaction: Floats) -> Floats:
    """Speeds (W, L) of walls along their normals, with a servo those of the next step, m/s."""
    walls = state.assembly.walls
    gain, target, fastest = (walls.servo[:, column, None].astype(float) for column in (GAIN, TARGET, TOP_SPEED))
    held = reaction[:, STIFFNESS] > 0.0
    speed = (
        gain * np.abs(target - reaction[:, NORMAL]) / (np.where(held, reaction[:, STIFFNESS], 1.0) * state.time_step)
    )
    served = np.where(held, np.minimum(speed, fastest), fastest)
    return np.where(gain > 0.0, served, np.abs(walls.motion[:, NORMAL_SPEED].astype(float)))


SAFETY = 0.8  # default step over the critical time step
_QUIET_LOOK = 256  # most steps to the next check


class UnstableRunError(RuntimeError):
    """Unstable run with unreliable results; the message names step, disk and remedy."""


def step_limit(state: State) -> Floats:
    """Limit (L,) of the step at present overlaps, speeds and unbalanced forces, s."""
    stability = critical_time_step_of_disks(
        state.scene, state.assembly, state.features, overlaps(state), wall_overlaps(state)
    )
    if not is_watched(state):
        return stability
    limits, _ = _impact_limits(state, _instant(state, look_ahead(state)))
    return np.asarray(np.minimum(stability, limits.min(axis=0)))


def is_watched(state: State) -> bool:
    """Whether the step is checked: not with constant stiffnesses, nor if the caller checks it."""
    return not state.features.linear and state.control.per_contact > 0.0


def _impact_limits(state: State, now: _Instant) -> tuple[Floats, Floats]:
    """Step limit (N, L) by possible impacts and by the motion in a step, s, and fastest speed (L,), m/s."""
    limits, fastest = _contact_durations(state, now)
    with np.errstate(divide="ignore"):
        limits = limits / (SAFETY * state.control.per_contact)
        if state.features.search:
            # The acceleration of a disk by an unsupported load counts, too.
            load = state.assembly.grains.load.astype(float)[:, :, None]
            pull = np.minimum(_accelerations(state, load), _accelerations(state, now.force)).max(axis=0)
            # Four steps in flight may cross the skin from 0.35 of it (`leapfrog._reach`) to a half.
            # A disk that moves by a tenth of the smallest radius in a step counts as blown up.
            way = min(0.0375 * state.skin, 0.05 * float(np.min(state.scene.radius)))
            limits = np.minimum(limits, _time_across(way, fastest, pull))
    return limits, fastest


def _instant(state: State, ahead: State) -> _Instant:
    """Present motion, forces and energies of a state; ``ahead`` is the result of `look_ahead`."""
    scene, order = state.scene, state.assembly.order
    inertia = np.column_stack([scene.mass, scene.mass, scene.inertia])[order][:, :, None]
    velocity, later = state.motion.velocity.astype(float), ahead.motion.velocity.astype(float)
    before = velocity if state.steps else 0.0
    pairs, moves = state.assembly.pairs, state.assembly.grains.inverse_mass > 0.0
    overlap = overlaps(state)
    overlap = np.where((moves[pairs.first] | moves[pairs.second])[:, None], overlap, np.minimum(overlap, 0.0))
    wall_overlap = wall_overlaps(state)
    wall_overlap = np.where(moves[state.assembly.wall_pairs.disk, None], wall_overlap, np.minimum(wall_overlap, 0.0))
    return _Instant(
        velocity=velocity,
        force=(later - before) / state.time_step * inertia,
        overlap=overlap,
        wall_overlap=wall_overlap,
        reaction=ahead.assembly.walls.reaction.astype(float),
        kinetic=0.5 * (inertia * velocity * (later if state.steps else velocity)).sum(axis=(0, 1)),
        stored=stored_energy(scene, ahead.assembly, state.features, overlap, wall_overlap),
    )


def look(state: State) -> State:
    """Return the state with a step within its limit, one step later if the step changed; see `advance`."""
    if not is_watched(state):
        # An unstable run ends at the next check.
        return replace(state, control=replace(state.control, next_look=state.steps + 2000))
    ahead = look_ahead(state)
    now = _instant(state, ahead)
    limits, fastest = _impact_limits(state, now)
    control = _watch_energy(state, now, _watch_stability(state, now))
    limit = np.minimum(control.stability, limits.min(axis=0))
    control = replace(control, next_look=state.steps + _steps_to_look(state, now, limits, fastest))
    current = replace(state, critical_time_step=limit, control=control)
    if control.fixed:
        _refuse_step(current, now, limits)
        return current
    step = np.where(state.time_step > 0.5 * (1.0 + control.fraction) * limit, control.fraction * limit, state.time_step)
    return current if np.array_equal(step, state.time_step) else change_step(current, ahead, step)


def _watch_stability(state: State, now: _Instant) -> StepControl:
    """Return the control, with a new stability limit if a disk's contacts have become stiff enough to lower it."""
    control = state.control
    stiffness = stiffest_contacts(state.assembly, now.overlap, now.wall_overlap)
    # Below half of the limit only four times the stiffness can matter, above it a growth by 14 %.
    growth = np.where(state.time_step > 0.5 * control.stability, 1.14, 4.0)
    if np.isfinite(control.stiffness).all() and not (stiffness > growth * control.stiffness).any():
        return control
    limit = critical_time_step_of_disks(state.scene, state.assembly, state.features, now.overlap, now.wall_overlap)
    return replace(control, stability=limit, stiffness=stiffness)


def _steps_to_look(state: State, now: _Instant, limits: Floats, fastest: Floats) -> int:
    """Steps in which speeds and overlaps change little and no unlisted contact can form."""
    step, pull = state.time_step, _accelerations(state, now.force).max(axis=0)
    busy = (limits < np.inf).any()
    touching = now.overlap[now.overlap > 0.0]
    steps = [32 if busy else _QUIET_LOOK]
    if len(touching):
        # Motion by less than 0.3 of the usual overlap changes stiffnesses within the margin of the step.
        steps.append(max(32, _steps_in(_time_across(0.3 * float(np.median(touching)), fastest, 0.0), step)))
    if state.features.search:
        # Unlisted disks may approach each other by 1/20 of the skin; an unsupported disk at rest falls meanwhile.
        steps.append(_steps_in(_time_across(0.05 * state.skin, fastest, pull), step))
    return max(1, min(steps))


def _steps_in(time: Floats, step: Floats) -> int:
    """Whole steps in the shortest of the times (L,), s; none if a lane has blown up."""
    return int(min(float(np.nan_to_num(time / step).min()), _QUIET_LOOK))


def _time_across(way: float, speed: Floats, acceleration: Floats | float) -> Floats:
    """Time (L,) in which no disk exceeds a distance (m), s: ``way = v t + a t^2 / 2``."""
    with np.errstate(divide="ignore"):
        return np.asarray(2.0 * way / (speed + np.sqrt(speed * speed + 2.0 * way * acceleration)))


def _accelerations(state: State, force: Floats) -> Floats:
    """Accelerations (N, L) of the disks by forces (N, 3, L), m/s^2."""
    return np.asarray(length(force[:, X], force[:, Y]) * state.assembly.grains.inverse_mass.astype(float)[:, None])


def _watch_energy(state: State, now: _Instant, control: StepControl) -> StepControl:
    """Return the control with the largest energy so far.

    Raises
    ------
    UnstableRunError
        If the energy has grown by more than loads have supplied. The test does not apply if walls or held disks supply
        energy, bonds have broken, or shear forces are not rescaled, which creates energy.
    """
    load = state.assembly.grains.load.astype(float)[:, :, None]
    supplied = (load * state.motion.displacement).sum(axis=(0, 1))
    present = now.kinetic + now.stored
    if state.steps == 0:
        return replace(control, energy=np.stack([present, present]))
    largest = np.maximum(control.energy[1], np.abs(supplied))
    # A tenth of the largest energy is tolerated, and the kinetic energy of 1 kg at 1e-6 m/s.
    least = 0.5e-12 * float(np.sum(state.scene.mass))
    for lane in np.flatnonzero(present - supplied - control.energy[0] > 0.1 * largest + least).tolist():
        if _is_closed(state, now, lane):
            disk = int(np.argmax(length(now.velocity[:, X, lane], now.velocity[:, Y, lane])))
            raise UnstableRunError(
                f"after {state.steps} steps there are {present[lane]:.3g} J/m, at the start there were "
                f"{control.energy[0, lane]:.3g}, and loads have supplied {supplied[lane]:.3g}; the fastest is "
                f"{_describe_disk(state, disk)}: the step of {state.time_step[lane]:.3g} s is too long, choose a "
                "smaller time_step"
            )
    return replace(control, energy=np.stack([control.energy[0], np.maximum(largest, present)]))


def _is_closed(state: State, now: _Instant, lane: int) -> bool:
    """Whether only loads supply energy to a lane."""
    walls, pairs = state.assembly.walls, state.assembly.pairs
    still = not state.features.servo and not np.any(walls.motion[:, SPEEDS, lane])
    held = state.assembly.grains.inverse_mass == 0.0
    whole = bool(((pairs.cemented ^ pairs.intact) >> np.uint32(lane) & 1 == 0).all())
    return still and not np.any(now.velocity[held, :, lane]) and whole and state.features.rescaling


def _refuse_step(state: State, now: _Instant, limits: Floats) -> None:
    """Raise an `UnstableRunError` if a fixed step exceeds its limit."""
    stability = state.control.stability
    for lane in np.flatnonzero(
        # The limit of impacts is an estimate, so it may be exceeded by 5 %.
        (state.time_step > stability * (1.0 + 1e-9)) | (state.time_step > 1.05 * limits.min(axis=0))
    ).tolist():
        disk = int(np.argmin(limits[:, lane]))
        if stability[lane] < limits[disk, lane]:
            disks, squares = stiffest_disks(state.scene, state.assembly, state.features, now.overlap, now.wall_overlap)
            disk = int(disks[np.argmax(squares[:, lane])])
        raise UnstableRunError(
            f"time_step = {state.time_step[lane]:.3g} s: after {state.steps} steps the limit is "
            f"{state.critical_time_step[lane]:.3g} s, set by {_describe_disk(state, disk)}: start with a smaller one, "
            "or without, and it follows the limit"
        )


def refuse_blow_up(state: State) -> None:
    """Raise an `UnstableRunError` if a disk's velocity is NaN or too large."""
    velocity = state.motion.velocity
    leap = 0.1 * float(np.min(state.scene.radius)) if is_watched(state) else np.inf
    moved = np.abs(velocity[:, XY]) * state.time_step
    # Comparisons with NaN are false, so the valid case is tested.
    if (moved <= leap).all() and np.isfinite(velocity).all():
        return
    size = np.where(np.isfinite(velocity), np.abs(velocity), np.inf)
    size[:, ROTATION] = np.where(size[:, ROTATION] < np.inf, 0.0, np.inf)
    disk, component, lane = (int(place) for place in np.unravel_index(int(np.argmax(size)), size.shape))
    raise UnstableRunError(
        f"after {state.steps} steps {_describe_disk(state, disk)} moves at {velocity[disk, component, lane]:.3g} m/s, "
        f"more than a tenth of a radius in a step of {state.time_step[lane]:.3g} s: the run has blown up; "
        "choose a smaller time_step"
    )


def _describe_disk(state: State, disk: int) -> str:
    """Describe the scene's disk at a place in memory."""
    number = int(state.assembly.order[disk])
    return f"disk {number}, which began at ({state.scene.x[number]:.5g}, {state.scene.y[number]:.5g}) m"


SKIN = 0.2  # largest gap of listed pairs over the mean radius


def choose_features(
    scene: Scene, law: Law, lanes: int = 1, *, slip: bool = True, breakage: bool = True, account: bool = False
) -> Features:
    """Features for a scene and a contact law, see `start`."""
    require(law in get_args(Law), "law", law, f"choose one of {', '.join(get_args(Law))}")
    linear = law == "linear"
    bonds = scene.bonds is not None and len(scene.bonds.pairs) > 0
    group = bonds and scene.bonds is not None and bool(scene.bonds.cement.linear_modulus > 0.0)
    return Features(
        lanes=lanes,
        linear=linear,
        rotation=scene.rotation,
        bonds=bonds,
        linear_group=group,
        breakage=bonds and breakage and not linear,
        slip=slip and not linear,
        rescaling=scene.rescaling and not linear,
        damping=bool(np.any(np.asarray(scene.damping) > 0.0)),
        servo=any(wall.servo_force is not None for wall in scene.walls) and not linear,
        search=not linear,
        loads=scene.load is not None or any(scene.gravity),
        account=account and not linear,
        # Bundles of fewer disks save less than their preparation costs, at least 0.1 ms a call.
        bundles=lanes == 1 and scene.count >= 256,
        midpoint=not linear,
    )


def start(  # noqa: PLR0913 - entry to the engine: every departure from the default is a keyword
    scene: Scene,
    *,
    law: Law = "finite",
    features: Features | None = None,
    precision: Precision = "float64",
    time_step: Floats | float | None = None,
    step_fraction: float = SAFETY,
    velocity: Floats | None = None,
    spin: Floats | None = None,
    preload: Preload | None = None,
    skin_fraction: float | None = None,
    steps_per_contact: float | None = None,
    single: State | None = None,
) -> State:
    """State of a scene at time zero.

    `ValueError` if the time step is above the critical time step, or an array has the wrong shape.

    Parameters
    ----------
    scene
        Disks at their reference positions.
    law
        ``finite``: displacements of any size. ``linear``: fixed normals and stiffnesses.
    features
        Overrides the features of `choose_features`.
    precision
        Precision of all arrays of the kernel. ``float32`` suits waves in scenes at rest: positions are displacements
        from the reference, and steps that are less than 1e-4 of these lose digits.
    time_step
        Fixed step, s, one number or (L,). By default a part of the critical time step, which decreases with it.
    step_fraction
        Default step over the critical time step.
    velocity, spin
        (N, 2) m/s and (N,) rad/s at time zero.
    preload
        Shear forces of the reference state.
    skin_fraction
        Largest gap of listed pairs over the mean radius. Choose it small for small motion, since listed pairs cost
        time, and large for large motion, since relisting costs more. Default 0.2, or 0 without contact search.
    steps_per_contact
        Steps per shortest impact at the default step; default 25, or 36 with friction. With 0 the step follows the
        stability limit at the start and only the caller checks it later: for waves in scenes at rest.
    single
        One-lane state of the same scene without bonds and loads, with the same skin and preload. Reuse of its
        neighbours and constants saves half of the time.
    """
    chosen = features or choose_features(scene, law)
    require(precision in get_args(Precision), "precision", precision, f"choose one of {', '.join(get_args(Precision))}")
    dtype = np.dtype(precision)
    if skin_fraction is None:
        skin_fraction = SKIN if chosen.search else 0.0
    least = 1e-9 if chosen.search else 0.0  # what search has to see before it touches
    require(least <= skin_fraction < np.inf, "skin_fraction", skin_fraction, "give a positive part of the mean radius")
    per_contact = steps_per_contact or 0.0
    require(0.0 <= per_contact < np.inf, "steps_per_contact", steps_per_contact, "give a number of 0 or more")
    skin = skin_fraction * float(np.mean(scene.radius)) if not chosen.linear else 0.0
    assembly = None if single is None else share_assembly(single.assembly, scene, chosen.lanes)
    if assembly is None:
        centres = np.column_stack([scene.x, scene.y])[:, :, None]
        assembly = assemble(scene, centres, skin, chosen.lanes, dtype)
    else:
        preload = None  # already included
    behind = assembly.wall_pairs.overlap >= assembly.grains.radius[assembly.wall_pairs.disk]
    where = assembly.order[assembly.wall_pairs.disk[behind]].tolist()
    require(
        not where, "x, y", f"disks {where[:5]}", "place their centres on the side to which their walls' normals point"
    )
    install_forces(scene, assembly, chosen, preload)
    # An impact returns its energy to 5e-4 with 25 steps, to 1e-3 at the limit (20 steps). A sticking contact oscillates
    # in shear sqrt(3 k_s / k_n), about 1.6, times as fast as normal to it. After oblique impacts (radii up to 1 : 6)
    # velocities and rim speeds are accurate to 0.4 % of the impact speed with 36 steps, to 0.6 % with 25.
    usual = 36.0 if scene.sand.friction > 0.0 else 25.0
    # A fixed step justifies the cost of a tight bound; the bound of a checked step is recomputed often.
    watched = not chosen.linear and steps_per_contact != 0.0
    limit = (critical_time_step_of_disks if watched else critical_time_step)(scene, assembly, chosen)
    state = State(
        scene=scene,
        features=chosen,
        time_step=step_fraction * limit,
        critical_time_step=limit,
        control=StepControl(
            fraction=step_fraction,
            per_contact=usual if steps_per_contact is None else steps_per_contact,
            fixed=time_step is not None,
            next_look=0,
            stability=limit,
            stiffness=np.full(chosen.lanes, np.inf),
            began=(0, np.zeros(chosen.lanes)),
            energy=np.full((2, chosen.lanes), np.nan),
        ),
        steps=0,
        skin=skin,
        assembly=assembly,
        motion=_first_motion(scene, assembly.order, chosen.lanes, dtype, velocity, spin),
        origin=aligned_zeros((scene.count, 2, chosen.lanes), dtype),
        wall_origin=aligned_zeros((len(scene.walls), chosen.lanes), dtype),
        account=aligned_zeros((4, chosen.lanes), dtype),
    )
    if is_watched(state):
        limit = step_limit(state)
    shape = np.shape(time_step) if time_step is not None else ()
    require(shape in ((), (chosen.lanes,)), "time_step", shape, f"give one number or shape ({chosen.lanes},)")
    step = step_fraction * limit if time_step is None else np.broadcast_to(np.asarray(time_step, float), chosen.lanes)
    require(bool(np.all(step > 0.0)), "time_step", step.tolist(), "give a positive number of seconds")
    cure = f"above the critical time step of {limit.tolist()} s: choose a smaller one"
    require(bool(np.all(step <= limit)), "time_step", step.tolist(), cure)
    return replace(state, time_step=np.array(step, dtype=float), critical_time_step=limit)


def _first_motion(
    scene: Scene,
    order: Integers,
    lanes: int,
    dtype: npt.DTypeLike,
    velocity: Floats | None,
    spin: Floats | None,
) -> Motion:
    """Disks at their reference positions, with the given velocities."""
    shape = (scene.count, 3, lanes)
    motion = Motion(displacement=aligned_zeros(shape, dtype), velocity=aligned_zeros(shape, dtype))
    for name, values, components in (("velocity", velocity, XY), ("spin", spin, ROTATION)):
        if values is not None:
            wanted = (scene.count, 2) if name == "velocity" else (scene.count,)
            require(np.shape(values) == wanted, name, np.shape(values), f"give an array of shape {wanted}")
            require(bool(np.all(np.isfinite(values))), name, "NaN or infinite", "give finite numbers")
            motion.velocity[:, components] = np.asarray(values)[order][..., None]
    return motion


def advance(state: State, steps: int) -> State:
    """State after ``steps`` more steps; the given state is unchanged.

    The step decreases when stiffer contacts or faster disks require it, unless `start` fixed it. `UnstableRunError` if
    a fixed step exceeds its limit, a disk moves by NaN or over a tenth of a radius in a step, or energy is created.
    """
    require(steps >= 0 and steps == int(steps), "steps", steps, "give a whole number of 0 or more")
    end = state.steps + steps
    current = duplicate(state)
    while current.steps < end:
        if current.steps == 0 or current.steps >= current.control.next_look:
            current = look(current)
        if current.steps == 0:
            current = start_leapfrog(current)
        current = run_in_place(current, min(end, current.control.next_look) - current.steps, no_recording(state))
        refuse_blow_up(current)
    return current
