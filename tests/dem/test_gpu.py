"""A GPU computes the bits of the processor; here numba's CUDA simulator stands for it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import json
import sys
from dataclasses import replace

import numpy as np

sys.path.insert(0, {folder!r})
from scenes import BONDED, GROUPED, LINEAR, SOFT_CEMENT, jumble, throw

from calcidem.dem.kernels.gpu import gpu_card
from calcidem.dem.engine.leapfrog import no_recording, run_in_place
from calcidem.dem.engine.state import start
from calcidem.dem.kernels.gpu import GpuError

weak = replace(SOFT_CEMENT, tensile_strength=4e5, cohesion=3e5)


def begin(features, precision, steps, skin=None):
    # Two samples of a dozen disks in moving walls, with different bonds, and a driven disk.
    features = replace(features, lanes=2, recording=True, driven=True)
    scene = jumble(5, 12, damping=0.3, share_bonded=0.6, cement=weak)
    velocity, spin = throw(scene, 5)
    options = dict(velocity=velocity, spin=spin, precision=precision, skin_fraction=skin, steps_per_contact=0.0)
    state = start(scene, features=features, **options)
    kind = state.motion.velocity.dtype
    told = no_recording(state)._replace(
        drive=np.ascontiguousarray(np.outer(np.linspace(0.0, 0.1, steps), [1.0, 2.0]).astype(kind)),
        driven_disks=np.array([0]),
        stride=2,
        listeners=np.array([1, 2, 3]),
        groups=np.array([0, 1, 3]),
        axes=np.array([0, 1]),
        samples=np.zeros((steps // 2, 3, 2), kind),
    )
    return state, told


def run(state, told, *kernel):
    lists = state.assembly.pairs.first
    state = run_in_place(state, len(told.drive), told, *kernel)
    arrays = *state.motion, told.samples, state.assembly.pairs.intact, state.assembly.walls.motion
    return [array.astype(float).tolist() for array in arrays], state.assembly.pairs.first is not lists
"""

COMPARE = """
import calcidem.dem.kernels.gpu.card as card_module

gpu_card().choose(0)
for features, precision, steps, skin, bytes_of_a_block in {cases}:
    card_module._shared_memory = lambda: bytes_of_a_block
    kernel = gpu_card().GpuSteps()
    card, is_renewed = run(*begin(features, precision, steps, skin), kernel.advance)
    processor, _ = run(*begin(features, precision, steps, skin))
    print(json.dumps([card == processor, is_renewed, bool(np.abs(card[0]).max() > 0.0)]))
"""

PROVE = """
import calcidem.dem.kernels.gpu.card as card

print(run(*begin(BONDED, "float32", 4), gpu_card().GpuSteps()) == run(*begin(BONDED, "float32", 4)))
correct = card._receive


def flip_a_bit(system, sent, names):
    correct(system, sent, names)
    system.motion.velocity[7, 0] = np.nextafter(system.motion.velocity[7, 0], np.float32(1.0))


card._receive = flip_a_bit
card._proved.clear()
try:
    run(*begin(BONDED, "float32", 4), gpu_card().GpuSteps())
except GpuError as error:
    print(error)
"""


def simulate(program: str) -> list[str]:
    """Lines that a program prints on the simulator, whose variable must be set before numba is imported."""
    environment = {**os.environ, "NUMBA_ENABLE_CUDASIM": "1", "NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-c", PROGRAM.format(folder=str(Path(__file__).parent)) + program]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


# The samples leave a list with so small a skin, in mean radii, at different steps.
# The motion of twelve disks takes 576 bytes in doubles.
FEW = '(LINEAR, "float64", 12, None, 575), (BONDED, "float32", 24, 1e-2, 48000)'
OTHERS = (
    '(LINEAR, "float32", 24, None, 48000), (BONDED, "float64", 24, 1e-2, 48000), (GROUPED, "float32", 24, None, 0), '
    '(LINEAR, "float64", 12, None, 576)'
)


@pytest.mark.slow
@pytest.mark.parametrize("cases", [FEW, pytest.param(OTHERS, marks=pytest.mark.full)])
def test_a_simulated_gpu_computes_the_bits_of_the_kernel(cases: str) -> None:
    """Motion, record, bonds and walls have the same bits, also where lists are renewed at different steps."""
    found = [json.loads(line) for line in simulate(COMPARE.format(cases=f"({cases})"))]
    assert found == [[True, "1e-2" in case, True] for case in cases.split("), ")]


@pytest.mark.full
def test_a_gpu_with_another_bit_is_refused() -> None:
    """The first use of a kernel is compared with the processor: equal bits pass, one other bit does not."""
    passed, refused = simulate(PROVE)
    assert passed == "True"
    assert "1 of 72 in velocity" in refused
    assert "leave gpu out" in refused
