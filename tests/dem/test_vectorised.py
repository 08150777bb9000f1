"""The machine code of the pair loop is vector code; this looks at the code, not at its speed."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from calcidem.dem.engine.assembly import near_pairs
from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.scene import Bonds, Regime, Scene
from calcidem.dem.engine.state import choose_features, start
from calcidem.dem.kernels.compiling import target_processor

LANES = 8
FEATURES = target_processor()[1]
REGISTER = "zmm" if "avx512f" in FEATURES else "ymm" if "avx2" in FEATURES else None
SCALAR_DIVIDER = ("divsd", "vdivsd", "sqrtsd", "vsqrtsd", "divss", "vdivss", "sqrtss", "vsqrtss")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(REGISTER is None, reason="this processor has neither AVX-512 nor AVX2"),
]


def assembly_reader() -> ModuleType:
    """Module of the benchmark that reads machine code; benchmarks are scripts, so it is loaded by its path."""
    path = Path(__file__).resolve().parents[2] / "benchmarks" / "limit" / "assembly.py"
    found = importlib.util.spec_from_file_location("limit_assembly", path)
    assert found is not None
    assert found.loader is not None
    module = importlib.util.module_from_spec(found)
    sys.modules["limit_assembly"] = module  # dataclasses look their module up by name
    found.loader.exec_module(module)
    return module


def small_state(regime: Regime, *, bonded: bool) -> State:
    """Nine disks on a square grid that touch, with damping."""
    radius = np.full(9, 1.0e-3)
    column, row = np.meshgrid(np.arange(3.0), np.arange(3.0))
    x, y = 1.999e-3 * column.ravel(), 1.999e-3 * row.ravel()
    bonds = Bonds(near_pairs(np.column_stack([x, y]), radius, 0.0)) if bonded else None
    scene = Scene(x, y, radius, bonds=bonds, damping=0.3)
    return start(scene, features=choose_features(scene, regime, LANES, breakage=False))


@pytest.mark.parametrize(
    ("regime", "bonded"),
    [
        pytest.param("finite", False, marks=pytest.mark.full),
        ("finite", True),
        pytest.param("linear", False, marks=pytest.mark.full),
    ],
)
def test_the_pair_loop_works_on_whole_vector_registers(regime: Regime, bonded: bool) -> None:
    """The pair loop computes on registers of full width, and no division or root in it is done lane by lane.

    Nowhere in the kernel is a multiply-add or an estimate, whose bits would depend on the processor.
    """
    reader = assembly_reader()
    text = reader.assembly_of(small_state(regime, bonded=bonded))
    assert {reader.kind_of(line) for line in text.splitlines()}.isdisjoint({"multiply-add", "estimate"})
    loop = reader.pair_loop(text, REGISTER)
    kinds = loop.kinds(REGISTER)
    # The shortest kernel (constant stiffness) has 31 operations: less is no vector code.
    assert kinds["other arithmetic"] >= 20
    assert kinds["load or store"] >= 4
    assert loop.scalar(SCALAR_DIVIDER) == []
