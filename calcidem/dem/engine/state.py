"""Starting and advancing a scene. States are values: advancing returns a new one."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from calcidem.dem.engine.assembly import aligned_zeros, assemble, share_assembly
from calcidem.dem.engine.fields import require
from calcidem.dem.engine.histories import install_forces
from calcidem.dem.engine.leapfrog import State, StepControl, duplicate, no_recording, run_in_place, start_leapfrog
from calcidem.dem.engine.scene import Precision, Preload, Regime, Scene
from calcidem.dem.engine.stability import critical_time_step, critical_time_step_of_disks
from calcidem.dem.engine.step_control import SAFETY, is_watched, look, refuse_blow_up, step_limit
from calcidem.dem.kernels.features import Features
from calcidem.dem.kernels.layout import ROTATION, XY, Floats, Integers, Motion

SKIN = 0.2  # largest gap of listed pairs over the mean radius


def choose_features(
    scene: Scene, regime: Regime, lanes: int = 1, *, slip: bool = True, breakage: bool = True, account: bool = False
) -> Features:
    """Features for a scene and a regime: ``finite``, ``small`` (fixed geometry) or ``linear`` (fixed stiffness)."""
    linear = regime == "linear"
    bonds = scene.bonds is not None and len(scene.bonds.pairs) > 0
    group = bonds and scene.bonds is not None and bool(scene.bonds.cement.linear_modulus > 0.0)
    return Features(
        lanes=lanes,
        finite=regime == "finite",
        linear=linear,
        rotation=scene.rotation,
        bonds=bonds,
        linear_group=group,
        breakage=bonds and breakage and not linear,
        slip=slip and not linear,
        rescaling=scene.rescaling and not linear,
        damping=bool(np.any(np.asarray(scene.damping) > 0.0)),
        servo=any(wall.servo_force is not None for wall in scene.walls) and not linear,
        search=regime == "finite",
        loads=scene.load is not None or any(scene.gravity),
        account=account and not linear,
        # Bundles of fewer disks save less than their preparation costs, at least 0.1 ms a call.
        bundles=lanes == 1 and scene.count >= 256,
        midpoint=not linear,
    )


def start(  # noqa: PLR0913 - entry to the engine: every departure from the default is a keyword
    scene: Scene,
    *,
    regime: Regime = "finite",
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
    regime
        ``finite``: displacements of any size. ``small``: fixed normals. ``linear``: fixed normals and stiffnesses.
    features
        Overrides the features of `choose_features`.
    precision
        Precision of all arrays of the kernel.
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
    chosen = features or choose_features(scene, regime)
    dtype = np.dtype(precision)
    if skin_fraction is None:
        skin_fraction = SKIN if chosen.search else 0.0
    skin = skin_fraction * float(np.mean(scene.radius)) if chosen.finite else 0.0
    assembly = None if single is None else share_assembly(single.assembly, scene, chosen.lanes)
    if assembly is None:
        centres = np.column_stack([scene.x, scene.y])[:, :, None]
        assembly = assemble(scene, centres, skin, chosen.lanes, dtype)
    else:
        preload = None  # already included
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
            overlap=np.full((2, chosen.lanes), np.inf),
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
