"""YADE on a whole cell: the script that the program `yade` runs; arguments: the cell's file, the file of its signals.

Cemented contacts, and in the linear law all contacts, are `CohFrictPhys` with stiffnesses of their own; sand contacts
of the finite law are `MindlinPhys`. A wall is one large held sphere behind each disk that touches it. Two integrators have
the two damping factors.
"""

import math
import sys

import numpy as np
from yade import (
    Bo1_Sphere_Aabb,
    CohFrictMat,
    ForceResetter,
    FrictMat,
    Ig2_Sphere_Sphere_ScGeom6D,
    InsertionSortCollider,
    InteractionLoop,
    Ip2_CohFrictMat_CohFrictMat_CohFrictPhys,
    Ip2_FrictMat_FrictMat_MindlinPhys,
    Law2_ScGeom6D_CohFrictPhys_CohesionMoment,
    Law2_ScGeom_MindlinPhys_Mindlin,
    NewtonIntegrator,
    O,
    PyRunner,
    utils,
)

with np.load(sys.argv[1]) as stored:
    CELL = {name: stored[name] for name in stored.files}
COUNT = len(CELL["x"])
LINEAR = str(CELL["law"]) == "linear"
ENDLESS = 1.0e30
SKIN = 0.05 * float(CELL["radius"].mean())
FLAT, FLATTER = 3.0, 30.0
"""Radii of the spheres that stand for walls, and for the transmitter, over those of their disks.

They turn as disks slide along them, which walls do not: with equal radii signals were off by 1e-3 for it. Large spheres
are near many disks, which costs time.
"""
EVERYBODY = 1 << 10  # bodies of no common group do not touch
DRIVEN: list = []


def materials() -> tuple:
    """Sand whose contacts are Hertz-Mindlin's, and sand whose contacts are springs."""
    ratio = float(CELL["poisson_ratio"])
    values = {
        "young": 2.0 * float(CELL["shear_modulus"]) * (1.0 + ratio),
        "poisson": ratio,
        "density": float(CELL["density"]),
        "frictionAngle": math.atan(float(CELL["friction"])),
    }
    return FrictMat(**values), CohFrictMat(isCohesive=True, momentRotationLaw=True, **values)


def make_of(material) -> None:  # noqa: ANN001 - YADE has no types
    """Let contacts that are made from now on be of this material."""
    for body in O.bodies:
        body.mat = material


def add_disks() -> list:
    """Spheres that move in the plane, with mass and inertia of disks, grouped by their damping; return the factors."""
    factors = sorted(set(CELL["damping"].tolist()))
    for index, radius in enumerate(CELL["radius"].tolist()):
        body = utils.sphere((CELL["x"][index], CELL["y"][index], 0.0), radius)
        body.state.mass = CELL["mass"][index]
        inertia = 0.5 * body.state.mass * radius**2
        body.state.inertia = (inertia, inertia, inertia)
        body.state.blockedDOFs = "zXY" if CELL["free"][index] else "xyzXYZ"
        body.groupMask = EVERYBODY | 1 << factors.index(CELL["damping"][index])
        O.bodies.append(body)
        force_x, force_y, moment = CELL["load"][index].tolist()
        if CELL["free"][index] and (force_x or force_y or moment):
            O.forces.setPermF(index, (force_x, force_y, 0.0))
            O.forces.setPermT(index, (0.0, 0.0, moment))
    return factors


def add_walls() -> list:
    """Large held spheres behind the disks that touch walls, as far in front of them as the walls are."""
    numbers = []
    for disk, normal, overlap, driven in zip(
        CELL["wall_disk"].tolist(),
        CELL["wall_normal"],
        CELL["wall_overlap"].tolist(),
        CELL["wall_driven"].tolist(),
        strict=True,
    ):
        radius = CELL["radius"][disk]
        flat = FLATTER if driven else FLAT
        apart = ((1.0 + flat) * radius - overlap) * normal
        body = utils.sphere((CELL["x"][disk] - apart[0], CELL["y"][disk] - apart[1], 0.0), flat * radius)
        body.state.blockedDOFs = "xyzXYZ"
        body.groupMask = EVERYBODY | 1
        numbers.append(O.bodies.append(body))
        if driven:
            DRIVEN.append(O.bodies[numbers[-1]])
    return numbers


def make_springs(pairs: list) -> None:
    """Put contacts of constant stiffness in the place of those that the first step found."""
    for first, second in pairs:
        if O.interactions.has(first, second):
            O.interactions.erase(first, second)
        utils.createInteraction(first, second)


def set_springs(pairs: list, stiffness: "np.ndarray", normal: "np.ndarray", shear: "np.ndarray") -> None:
    """Give contacts their stiffness, normal and shear (N/m) and rotation (N m), and the forces that they begin with."""
    for (first, second), values, push, drag in zip(
        pairs, stiffness.tolist(), normal.tolist(), shear.tolist(), strict=True
    ):
        contact = O.interactions[first, second]
        physics = contact.phys
        physics.kn, physics.ks, physics.kr = values
        physics.ktw = 0.0
        physics.normalAdhesion = physics.shearAdhesion = ENDLESS
        physics.rollingAdhesion = physics.twistingAdhesion = ENDLESS
        physics.unp = contact.geom.penetrationDepth - push / physics.kn
        physics.shearForce = shear_vector(contact, drag)
        physics.moment_bending = physics.moment_twist = (0.0, 0.0, 0.0)


def set_shear(pairs: list, shear: "np.ndarray") -> list:
    """Contacts of sand, that begin with given shear forces."""
    contacts = [O.interactions[first, second] for first, second in pairs]
    for contact, drag in zip(contacts, shear.tolist(), strict=True):
        contact.phys.shearForce = contact.phys.shearElastic = shear_vector(contact, drag)
    return contacts


def shear_vector(contact, drag: float) -> tuple:  # noqa: ANN001 - YADE has no types
    """Shear force on the second body; seen from the other end both tangent and force turn round."""
    normal = contact.geom.normal
    return (-drag * normal[1], drag * normal[0], 0.0)


def set_up() -> None:
    """Bodies, contacts and engines."""
    factors, behind = add_disks(), add_walls()
    bond_law, sand_law = Law2_ScGeom6D_CohFrictPhys_CohesionMoment(), Law2_ScGeom_MindlinPhys_Mindlin()
    cohesive = Ip2_CohFrictMat_CohFrictMat_CohFrictPhys(setCohesionNow=False, setCohesionOnNewContacts=True)
    integrators = [
        NewtonIntegrator(damping=factor, gravity=(0, 0, 0), mask=1 << place) for place, factor in enumerate(factors)
    ]
    O.dt = float(CELL["time_step"])
    O.engines = [
        ForceResetter(),
        InsertionSortCollider([Bo1_Sphere_Aabb()], verletDist=SKIN),
        InteractionLoop(
            [Ig2_Sphere_Sphere_ScGeom6D(avoidGranularRatcheting=False)],
            [Ip2_FrictMat_FrictMat_MindlinPhys(), cohesive],
            [bond_law, sand_law],
        ),
        PyRunner(command="drive()", iterPeriod=1),
        *integrators,
        PyRunner(command="record()", iterPeriod=1),
    ]
    sand, cemented_sand = materials()
    make_of(sand)
    step_at_rest(integrators)
    at_walls = list(zip(behind, CELL["wall_disk"].tolist(), strict=True))
    pairs, springs = CELL["pairs"].tolist(), np.flatnonzero(CELL["cemented"] | LINEAR)
    bonds = [pairs[i] for i in springs]
    make_of(cemented_sand)
    make_springs(bonds + at_walls * LINEAR)
    # Shear forces are taken away in the first step of a contact, so they are set after it.
    step_at_rest(integrators)
    make_of(sand)
    set_springs(bonds, *(CELL[name][springs] for name in ("stiffness", "normal_force", "shear_force")))
    nothing = np.zeros(len(at_walls))
    if LINEAR:
        set_springs(at_walls, np.column_stack([CELL["wall_stiffness"], nothing]), nothing, nothing)
        return
    rest = np.flatnonzero(~CELL["cemented"])
    set_shear([pairs[i] for i in rest], CELL["shear_force"][rest])
    for place, contact in enumerate(set_shear(at_walls, nothing)):
        contact.phys.kno, contact.phys.kso = CELL["wall_hertz"][place], CELL["wall_shear_hertz"][place]
        contact.phys.tangensOfFrictionAngle = CELL["wall_friction"][place]


def step_at_rest(integrators: list) -> None:
    """Let one step without motion find contacts and their laws."""
    for engine in integrators:
        engine.dead = True
    O.step()
    O.forces.f(0, sync=True)  # forces that nobody has asked for are not taken back
    for engine in integrators:
        engine.dead = False


def drive() -> None:
    """Give the transmitter its velocity in the middle of this step."""
    cycle = min(1.0, max(0.0, float(CELL["frequency"]) * (O.iter - START + 0.5) * O.dt))
    speed = float(CELL["amplitude"]) * (1.0 - math.cos(2.0 * math.pi * cycle))
    for body in DRIVEN:
        body.state.vel = (0.0, speed, 0.0)


def record() -> None:
    """Write down the mean velocities of the groups at the end of every stride-th step."""
    if O.iter < START or (O.iter - START + 1) % STRIDE:
        return
    velocity = np.array([STATES[disk].vel for disk in LISTENERS], dtype=float)
    means = np.add.reduceat(velocity, CELL["groups"][:-1], axis=0) / np.diff(CELL["groups"])[:, None]
    SIGNALS.append(means[:, [1, 0]].T)


SIGNALS: list = []
STRIDE, LISTENERS = int(CELL["stride"]), CELL["listeners"].tolist()
START = 2  # steps at rest
set_up()
STATES = [body.state for body in O.bodies]
O.run(STRIDE * int(CELL["samples"]), wait=True)
np.save(sys.argv[2], np.moveaxis(np.array(SIGNALS), 0, 2))
