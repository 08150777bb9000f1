"""A kernel means the same with and without the compiler, in both precisions.

NumPy widens single precision where a double of NumPy takes part (NEP 50), a lane vector of the compiler never does.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

PROGRAM = """
import json
import sys
from dataclasses import replace

import numpy as np

sys.path.insert(0, {folder!r})
from scenes import ACCOUNT, BONDED, GROUPED, LINEAR, SERVO, SOFT_CEMENT, jumble, throw

from calcidem.dem.engine.leapfrog import no_recording, run_in_place
from calcidem.dem.engine.state import start

weak = replace(SOFT_CEMENT, tensile_strength=4e5, cohesion=3e5)
bundled = replace(BONDED, bundles=True)
recording = replace(GROUPED, recording=True, driven=True, account=True)
# Each with its share of bonds. The last are those of cells; they record the mean of three disks.
cases = [(ACCOUNT, 0.0), (GROUPED, 0.6), (LINEAR, 0.6), (bundled, 0.6), (recording, 0.6)]
if {is_wide}:  # two lanes are never taken for a number; a bundle is of one
    cases = [(replace(features, lanes=1 if features.bundled else 2), bonded) for features, bonded in cases]
    cases += [(SERVO, 0.0), (replace(GROUPED, midpoint=False), 0.6)]


def run(case, precision):
    features, bonded = case
    scene = jumble(5, 5, damping=0.3, share_bonded=bonded, **({{"cement": weak}} if bonded else {{}}))
    velocity, spin = throw(scene, 5)
    state = start(scene, features=features, velocity=velocity, spin=spin, step_fraction=0.1, precision=precision)
    kind, rows = state.motion.velocity.dtype, (25, features.lanes)
    told = no_recording(state)
    if features.recording:
        told = told._replace(
            drive=np.linspace(0.0, 0.1, 25, dtype=kind)[:, None].repeat(features.lanes, axis=1),
            driven_disks=np.array([0]),
            stride=1,
            listeners=np.array([1, 2, 3]),
            groups=np.array([0, 3]),
            samples=np.zeros((25, 1, features.lanes), kind),
        )
    state = run_in_place(state, 25, told)
    arrays = state.motion.displacement, state.motion.velocity, state.account, told.samples
    return [array.astype(float).tolist() for array in arrays] + [state.assembly.pairs.intact.tolist()]
"""

COMPARE = "print(json.dumps([run(case, sys.argv[1]) for case in cases]))"

WATCH = """
wide = set()

def watch(frame, event, value):
    code = frame.f_code
    if event == "return" and "/dem/kernels/" in code.co_filename and "lanes.py" not in code.co_filename:
        for name, found in (*frame.f_locals.items(), ("what is returned", value)):
            if getattr(found, "dtype", None) == np.float64 and getattr(found, "ndim", 0) < 2:
                wide.add(f"{code.co_name}: {name}")
    if event == "return" and code.co_name == "store" and frame.f_locals["value"].dtype == np.float64:
        wide.add(f"{frame.f_back.f_code.co_name}: what is stored")

sys.setprofile(watch)
for case in cases:
    run(case, "float32")
sys.setprofile(None)
print(json.dumps(sorted(wide)))
"""


def results(program: str, *words: str, jit: bool) -> object:
    """What the program prints with the compiler on or off."""
    program = PROGRAM.format(folder=str(Path(__file__).parent), is_wide=not jit and program == WATCH) + program
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "0" if jit else "1"}
    command = [sys.executable, "-c", program, *words]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.mark.full
@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_the_kernel_without_the_compiler_computes_the_same(precision: str) -> None:
    """With NUMBA_DISABLE_JIT=1 the kernel is plain Python on NumPy arrays and gives the same bits."""
    assert results(COMPARE, precision, jit=True) == results(COMPARE, precision, jit=False)


def test_single_precision_stays_single() -> None:
    """Without the compiler no number of a lane becomes a double in any function of the kernels."""
    assert results(WATCH, jit=False) == []
