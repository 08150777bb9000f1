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
from scenes import ACCOUNT, BONDED, GROUPED, LINEAR, SOFT_CEMENT, jumble, throw

from calcidem.dem.engine.state import advance, start

results = []
weak = replace(SOFT_CEMENT, tensile_strength=4e5, cohesion=3e5)
small, bundled = replace(GROUPED, finite=False, search=False), replace(BONDED, bundles=True)
cases = (ACCOUNT, 0.0), (GROUPED, 0.6), (small, 0.6), (LINEAR, 0.6), (bundled, 0.6)
for features, bonded in cases:
    scene = jumble(5, 5, damping=0.3, share_bonded=bonded, **({{"cement": weak}} if bonded else {{}}))
    velocity, spin = throw(scene, 5)
    state = advance(start(scene, features=features, velocity=velocity, spin=spin, step_fraction=0.1), 25)
    results.append(
        [state.motion.displacement.tolist(), state.motion.velocity.tolist(), state.account.tolist(),
         state.assembly.pairs.intact.tolist()]
    )
print(json.dumps(results))
"""


def results(jit: bool) -> list[list[list[float]]]:
    """What the program prints with the compiler on or off."""
    program = PROGRAM.format(folder=str(Path(__file__).parent))
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "0" if jit else "1"}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)  # type: ignore[no-any-return]


@pytest.mark.full
def test_the_kernel_without_the_compiler_computes_the_same() -> None:
    """With NUMBA_DISABLE_JIT=1 the kernel is plain Python on NumPy arrays and gives the same bits."""
    assert results(jit=True) == results(jit=False)
