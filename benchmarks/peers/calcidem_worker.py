"""calcidem on a scene; arguments: scene file, law, lanes, precision, shear rescaling mode, start of the leapfrog."""

import sys
from dataclasses import replace

import numpy as np
from scenes import as_scene, load_problem, started
from worker import Engine, serve

from calcidem.dem.engine.leapfrog import State, no_recording, run_kernel, start_leapfrog
from calcidem.dem.engine.state import choose_features


class Calcidem(Engine):
    """The kernel, called as campaigns call it.

    With ``centred`` velocities belong to time zero, as in LAMMPS; without, to half a step before, as in YADE.
    """

    def __init__(self, path: str, law: str, lanes: str, precision: str, mode: str, velocities: str) -> None:
        self.problem = load_problem(path)
        self.rescaling, self.precision = mode == "1", precision
        scene = as_scene(self.problem, rescaling=self.rescaling)
        # Stiffnesses at the end of a step, as campaigns and the other programs have them.
        self.features = replace(choose_features(scene, law, int(lanes)), midpoint=False)  # type: ignore[arg-type]
        self.centred = velocities == "centred"
        self.velocity = "unset"
        self.reset()
        self.warm_up()

    def reset(self) -> None:
        """Make the state of time zero; every lane starts the same."""
        self.current: State = started(
            self.problem,
            self.features,
            self.precision,  # type: ignore[arg-type]
            rescaling=self.rescaling,
        )
        self.first = self.centred

    def warm_up(self) -> None:
        """Compile."""
        run_kernel(self.current, 2, no_recording(self.current))
        self.reset()

    def run(self, steps: int) -> None:
        """Advance in place; a scene whose neighbours change is not one for this comparison."""
        if self.first:
            self.current = start_leapfrog(self.current)
            self.first, steps = False, steps - 1
        done = run_kernel(self.current, steps, no_recording(self.current))
        if done < steps:
            raise RuntimeError(f"the pair list ran out after {done} of {steps} steps: lower the speed of the scene")
        self.current = replace(self.current, steps=self.current.steps + done)

    def state(self) -> np.ndarray:
        """Positions and spins."""
        return np.column_stack([self.current.position(), self.current.spin()])


if __name__ == "__main__":
    serve(lambda path: Calcidem(path, *sys.argv[2:]), sys.argv[1:])
