"""YADE on a scene: Mindlin contacts or cohesive frictional contacts with moments.

A script of the program `yade`, which brings the module `yade` along.
"""

import math
import sys

import numpy as np
from worker import Engine, serve
from yade import (
    Bo1_Sphere_Aabb,
    CohFrictMat,
    ForceResetter,
    FrictMat,
    Ig2_Sphere_Sphere_ScGeom,
    Ig2_Sphere_Sphere_ScGeom6D,
    InsertionSortCollider,
    InteractionLoop,
    Ip2_CohFrictMat_CohFrictMat_CohFrictPhys,
    Ip2_FrictMat_FrictMat_MindlinPhys,
    Law2_ScGeom6D_CohFrictPhys_CohesionMoment,
    Law2_ScGeom_MindlinPhys_Mindlin,
    NewtonIntegrator,
    O,
    utils,
)


class Yade(Engine):
    """One YADE scene, rebuilt at every reset."""

    def __init__(self, path: str) -> None:
        stored = np.load(path)
        self.problem = {name: stored[name] for name in stored.files}
        self.bonded = len(self.problem["bonds"]) > 0
        self.reset()

    def reset(self) -> None:
        """Set the scene up anew; every step is a full step of the leapfrog."""
        O.reset()
        problem = self.problem
        ratio = float(problem["poisson_ratio"])
        values = {
            "young": 2.0 * float(problem["shear_modulus"]) * (1.0 + ratio),
            "poisson": ratio,
            "density": float(problem["density"]),
            "frictionAngle": math.atan(float(problem["friction"])),
        }
        O.materials.append(
            CohFrictMat(isCohesive=True, momentRotationLaw=True, **values) if self.bonded else FrictMat(**values)
        )
        self.add_disks()
        O.dt = float(problem["time_step"])
        integrator = NewtonIntegrator(damping=float(problem["damping"]), gravity=(0, 0, 0))
        skin = 0.5 * float(
            problem["skin"] * problem["radius"].mean()
        )  # each box grows by it, so boxes touch at calcidem's skin
        O.engines = [
            ForceResetter(),
            InsertionSortCollider([Bo1_Sphere_Aabb()], verletDist=skin),
            InteractionLoop(*self.laws()),
            integrator,
        ]
        if self.bonded:
            self.make_bonds(integrator)

    def laws(self) -> tuple:
        """Geometry, physics and law of contacts."""
        if not self.bonded:
            law = Law2_ScGeom_MindlinPhys_Mindlin(preventGranularRatcheting=False)
            return (
                [Ig2_Sphere_Sphere_ScGeom(avoidGranularRatcheting=False)],
                [Ip2_FrictMat_FrictMat_MindlinPhys()],
                [law],
            )
        physics = Ip2_CohFrictMat_CohFrictMat_CohFrictPhys(setCohesionNow=True, setCohesionOnNewContacts=False)
        law = Law2_ScGeom6D_CohFrictPhys_CohesionMoment()
        return [Ig2_Sphere_Sphere_ScGeom6D(avoidGranularRatcheting=False)], [physics], [law]

    def add_disks(self) -> None:
        """Spheres that move in the plane only, with the mass and inertia of discs of unit thickness."""
        problem = self.problem
        mass = float(problem["density"]) * np.pi * problem["radius"] ** 2
        for index, radius in enumerate(problem["radius"]):
            body = utils.sphere((problem["x"][index], problem["y"][index], 0.0), radius)
            body.state.mass = mass[index]
            inertia = 0.5 * mass[index] * radius**2
            body.state.inertia = (inertia, inertia, inertia)
            body.state.blockedDOFs = "xyzXYZ" if problem["held"][index] else "zXY"
            O.bodies.append(body)
        self.set_velocities()

    def set_velocities(self) -> None:
        """Give the disks their first velocities."""
        for body, velocity, spin in zip(O.bodies, self.problem["velocity"], self.problem["spin"]):  # noqa: B905 - old numpy types
            body.state.vel = (velocity[0], velocity[1], 0.0)
            body.state.angVel = (0.0, 0.0, spin)

    def make_bonds(self, integrator) -> None:  # noqa: ANN001
        """Let one step without motion find the contacts, then give them the stiffness of the scene, unloaded."""
        integrator.dead = True
        O.step()
        integrator.dead = False
        normal, shear, bending = (float(value) for value in self.problem["bond_stiffness"])
        before = self.earlier_overlaps()
        for contact in O.interactions:
            physics = contact.phys
            physics.kn, physics.ks, physics.kr, physics.ktw = normal, shear, bending, bending
            physics.normalAdhesion = physics.shearAdhesion = 1.0e20
            physics.rollingAdhesion = physics.twistingAdhesion = 1.0e20
            physics.unp = before[contact.id1, contact.id2]
            physics.shearForce = (0.0, 0.0, 0.0)

    def earlier_overlaps(self) -> dict:
        """Overlaps one step before time zero, from where calcidem's bonds begin to count, too."""
        problem = self.problem
        x = problem["x"] - O.dt * problem["velocity"][:, 0]
        y = problem["y"] - O.dt * problem["velocity"][:, 1]
        overlaps = {}
        for first, second in problem["bonds"]:
            distance = math.hypot(x[second] - x[first], y[second] - y[first])
            depth = problem["radius"][first] + problem["radius"][second] - distance
            overlaps[first, second] = overlaps[second, first] = depth
        return overlaps

    def run(self, steps: int) -> None:
        """Advance."""
        O.run(steps, wait=True)

    def state(self) -> np.ndarray:
        """Positions and spins."""
        return np.array([[b.state.pos[0], b.state.pos[1], b.state.angVel[2]] for b in O.bodies])


serve(Yade, sys.argv[1:])
