"""The bits of a sample are the same on every processor."""

import json
import math
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from calcidem.dem.engine import portable
from calcidem.dem.engine.stability import _largest_eigenvalue

pytestmark = pytest.mark.slow

FOLDER = Path(__file__).parent / "bits"
sys.path.insert(0, str(FOLDER))
from processors import environment, playable  # noqa: E402 - a helper beside the tests


def hashes_on(processors: list[str], *options: str) -> dict[str, dict[str, str]]:
    """What the program prints on each of several processors, all at once."""
    command = [sys.executable, str(FOLDER / "program.py"), "small", *options]
    running = {
        name: subprocess.Popen(command, env=environment(name), stdout=subprocess.PIPE, text=True) for name in processors
    }
    found = {}
    for name, process in running.items():
        text, _ = process.communicate()
        assert process.returncode == 0, name
        found[name] = {line.split(" ", 1)[1]: line.split(" ", 1)[0] for line in text.splitlines()}
    return found


def expected() -> dict[str, str]:
    """Hashes kept in the tree."""
    return dict(json.loads((FOLDER / "hashes.json").read_text()))


def test_this_processor_gives_the_bits_that_are_kept() -> None:
    """Packing, cement, steps, signals and velocities of 280 disks have the bits that are kept in the tree.

    Here with the linear law; with the other only with ``-m full``.
    """
    kept, name = expected(), "as it is"
    found = hashes_on([name], "--laws", "linear", "--lanes", "8", "--contents", "2.55")[name]
    assert found == {key: kept[key] for key in found}


@pytest.mark.full
@pytest.mark.parametrize("processor", playable())
def test_every_processor_gives_the_bits_that_are_kept(processor: str) -> None:
    """The same for every processor that this computer can play, one and eight lanes, with and without cement."""
    assert hashes_on([processor])[processor] == expected()


@pytest.mark.full
def test_an_emulated_aarch64_gives_the_bits_that_are_kept(tmp_path: Path) -> None:
    """One case with the finite law, from the packing to the velocity; numba compiles for aarch64.

    The variable AARCH64_FOLDER names the folder of a former call, which saves making it.
    """
    if shutil.which("apt-get") is None or platform.freedesktop_os_release().get("VERSION_CODENAME") != "bookworm":
        pytest.skip("QEMU and Python for aarch64 are taken from Debian 12, and this is another system")
    script = FOLDER.parents[2] / "benchmarks" / "bits" / "on_aarch64.sh"
    run = [str(script), os.environ.get("AARCH64_FOLDER", str(tmp_path))]
    asked = [*run, "-c", "import platform; print(platform.machine())"]
    made = subprocess.run(asked, check=False, capture_output=True, text=True)
    if made.returncode != 0:
        pytest.skip(f"no emulated aarch64: {made.stderr.strip().splitlines()[-1]}")
    assert made.stdout.strip() == "aarch64"
    case = ("--laws", "finite", "--lanes", "8", "--contents", "2.55")
    done = subprocess.run(
        [*run, str(FOLDER / "program.py"), "small", *case], check=True, capture_output=True, text=True
    )
    found = {line.split(" ", 1)[1]: line.split(" ", 1)[0] for line in done.stdout.splitlines()}
    kept = expected()
    assert found == {key: kept[key] for key in found}
    assert len(found) == 6


def in_last_places(values: np.ndarray, exact: np.ndarray) -> float:
    """Largest error in units in the last place."""
    return float(np.max(np.abs(values - exact) / np.spacing(np.abs(exact).astype(float))))


def test_sines_are_good_to_two_units_in_the_last_place() -> None:
    """Sine of turns from -1 to 1, against long double, and exactly at quarters."""
    turns = np.random.default_rng(1).uniform(-1.0, 1.0, 20_000)
    quarters = np.round(4.0 * turns)
    rest = 2.0 * np.pi * np.longdouble(1.0) * (turns - quarters / 4.0) + np.longdouble(2.4492935982947064e-16) * (
        turns - quarters / 4.0
    )
    exact = np.where(quarters % 2 == 0, np.sin(rest), np.cos(rest)) * np.where(quarters % 4 >= 2, -1.0, 1.0)
    assert in_last_places(portable.sine_of_turns(turns), exact) < 2.0
    assert portable.sine_of_turns([0.0, 0.25, 0.5, 0.75, 1.0, -0.25]).tolist() == [0.0, 1.0, 0.0, -1.0, 0.0, -1.0]


def test_cosines_and_sines_of_any_number_of_turns_are_good_to_two_units() -> None:
    """Of the fraction of a turn, which is exact, against long double; exactly at quarters, on either side of zero."""
    turns = np.random.default_rng(6).uniform(-1000.0, 1000.0, 20_000)
    part = turns - np.floor(turns)
    quarters = np.round(4.0 * part).astype(int)
    rest = 8.0 * np.arctan(np.longdouble(1.0)) * (part - quarters / 4.0)
    sine, cosine = np.sin(rest), np.cos(rest)
    found = portable.cosine_and_sine(turns)
    assert in_last_places(found[0], np.choose(quarters % 4, [cosine, -sine, -cosine, sine])) < 2.0
    assert in_last_places(found[1], np.choose(quarters % 4, [sine, cosine, -sine, -cosine])) < 2.0
    cosines, sines = portable.cosine_and_sine([0.0, 0.25, 0.5, 0.75, 1.0, -0.25, 7.5, -3.75])
    assert cosines.tolist() == [1.0, 0.0, -1.0, 0.0, 1.0, 0.0, -1.0, 0.0]
    assert sines.tolist() == [0.0, 1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0]


def test_exponentials_are_good_to_two_units() -> None:
    """Against long double, over the whole range and where the reduced argument changes sign."""
    for reach in (0.4, 20.0, 700.0):
        value = np.random.default_rng(7).uniform(-reach, reach, 20_000)
        assert in_last_places(portable.exponential(value), np.exp(value.astype(np.longdouble))) < 2.0
    assert portable.exponential(0.0) == 1.0


def test_arcsines_lengths_and_powers_are_good_to_the_last_places() -> None:
    """Against long double, as the docstrings say."""
    x, y = np.random.default_rng(2).uniform(1e-6, 1.0, (2, 20_000))
    long_x, long_y = x.astype(np.longdouble), y.astype(np.longdouble)
    assert in_last_places(portable.arc_sine(x), np.arcsin(long_x)) < 3.0
    assert portable.arc_sine([0.0, 1.0]).tolist() == [0.0, math.pi / 2.0]
    assert in_last_places(portable.length(x, y), np.hypot(long_x, long_y)) < 1.5
    assert in_last_places(portable.three_halves(x), long_x * np.sqrt(long_x)) < 1.5
    degrees = np.linspace(0.0, 89.0, 90)
    tangents = [portable.tangent_of_degrees(float(value)) for value in degrees]
    np.testing.assert_allclose(tangents, np.tan(np.radians(degrees)), rtol=1e-13, atol=0.0)


def test_largest_eigenvalues_are_bounds_good_to_a_trillionth() -> None:
    """Never below LAPACK's and above by 1e-12 at most, with stiffnesses that differ by 1e11, and for zero matrices."""
    generator = np.random.default_rng(4)
    for springs in (1, 2, 5):
        directions = generator.normal(size=(5_000, springs, 3))
        stiffness = 10.0 ** generator.uniform(0.0, 11.0, (5_000, springs))
        matrices = np.einsum("nk,nki,nkj->nij", stiffness, directions, directions)
        entries = {(i, j): matrices[:, i, j] for i in range(3) for j in range(i, 3)}
        ratio = _largest_eigenvalue(entries) / np.linalg.eigvalsh(matrices)[:, -1]
        assert ratio.min() > 1.0
        assert ratio.max() < 1.0 + 2e-12
    assert _largest_eigenvalue({entry: np.zeros(2) for entry in entries}).tolist() == [0.0, 0.0]


def pairwise(values: list[float]) -> float:
    """NumPy's sum of a contiguous array, written out."""
    if len(values) < 8:
        total = 0.0
        for value in values:
            total += value
        return total
    if len(values) <= 128:
        parts = values[:8]
        whole = len(values) - len(values) % 8
        for begin in range(8, whole, 8):
            parts = [part + value for part, value in zip(parts, values[begin : begin + 8], strict=True)]
        total = ((parts[0] + parts[1]) + (parts[2] + parts[3])) + ((parts[4] + parts[5]) + (parts[6] + parts[7]))
        for value in values[whole:]:
            total += value
        return total
    half = len(values) // 2
    half -= half % 8
    return pairwise(values[:half]) + pairwise(values[half:])


def test_the_sum_of_an_array_has_a_fixed_order() -> None:
    """`np.sum` of a contiguous array is the pairwise sum, to the last bit, whatever vectors the processor has."""
    generator = np.random.default_rng(5)
    for size in (3, 8, 100, 129, 4663):
        values = generator.normal(size=size) * 10.0 ** generator.uniform(-8.0, 8.0, size)
        assert float(np.sum(values)) == pairwise(values.tolist())
