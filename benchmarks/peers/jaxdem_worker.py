"""JaxDEM on a scene: disks with linear springs, dashpots capped by friction, no history, in double precision.

Arguments: scene file, samples. One sample has a neighbour list; several are batched with `vmap`, for which JaxDEM advises
its cell list, as a conditional rebuild would be made at each step.
"""

import os
import sys

os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import jaxdem
import numpy as np
from worker import Engine, serve


class JaxDEM(Engine):
    """A batch of equal samples."""

    def __init__(self, path: str, samples: str) -> None:
        with np.load(path) as stored:
            self.problem = {name: stored[name] for name in stored.files}
        self.samples = int(samples)
        self.reset()

    def reset(self) -> None:
        """Make the state of time zero."""
        problem = self.problem
        young = 2.0 * float(problem["shear_modulus"]) * (1.0 + float(problem["poisson_ratio"]))
        grain = jaxdem.materials.ElasticFriction(
            young=young,
            poisson=float(problem["poisson_ratio"]),
            mu=float(problem["friction"]),
            e=1.0,
            mu_r=0.0,
            density=float(problem["density"]),
        )
        radius = problem["radius"]
        mass = float(problem["density"]) * np.pi * radius**2
        state = jaxdem.State.create(
            pos=np.column_stack([problem["x"], problem["y"]]),
            vel=problem["velocity"],
            ang_vel=problem["spin"][:, None],
            rad=radius,
            mass=mass,
            inertia=(0.5 * mass * radius**2)[:, None],
            fixed=problem["held"],
        )
        cutoff, skin = 2.0 * float(radius.max()), float(problem["skin"] * radius.mean())
        lists = {"collider_type": "CellList"}
        if self.samples == 1:
            lists = {
                "collider_type": "NeighborList",
                "collider_kw": {"cutoff": cutoff, "skin": skin, "max_neighbors": 12},
            }
        system = jaxdem.System.create(
            state=state,
            dt=float(problem["time_step"]),
            force_model_type="cundallstrack",
            mat_table=jaxdem.MaterialTable.from_materials([grain]),
            **lists,
        )
        if self.samples > 1:
            state, system = (type(one).stack([one] * self.samples) for one in (state, system))
        self.current = state, system

    def run(self, steps: int) -> None:
        """Advance all samples."""
        self.current = jaxdem.System.step(*self.current, n=jnp.asarray(steps))
        jax.block_until_ready(self.current)

    def state(self) -> np.ndarray:
        """Positions and spins of the first sample."""
        state = self.current[0]
        position, spin = (
            np.asarray(array).reshape(-1, len(self.problem["x"]), width)[0]
            for array, width in ((state.pos, 2), (state.ang_vel, 1))
        )
        return np.column_stack([position, spin])


if __name__ == "__main__":
    serve(lambda path: JaxDEM(path, *sys.argv[2:]), sys.argv[1:])
