"""The machine code of the kernel is vector code of plain operations; this looks at the code, not at its speed."""

import re
from functools import cache
from typing import Any

import assembly
import numpy as np
import pytest
from numba.core import config
from numba.core.codegen import get_host_cpu_features

from calcidem.dem.engine.assembly import near_pairs
from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.scene import Bonds, Law, Scene
from calcidem.dem.engine.state import choose_features, start

LANES = 8
FEATURES = [part[1:] for part in (config.CPU_FEATURES or get_host_cpu_features()).split(",") if part[0] == "+"]
REGISTER = "zmm" if "avx512f" in FEATURES else "ymm" if "avx2" in FEATURES else None
SCALAR_DIVIDER = ("divsd", "vdivsd", "sqrtsd", "vsqrtsd", "divss", "vdivss", "sqrtss", "vsqrtss")

CONTRACTED = r"\t(v?fn?m(add|sub)|fml[as]|v?rsqrt|v?rcp|frsqrt|frecp)"
"""Multiply-adds and estimates of x86-64 and aarch64."""

pytestmark = pytest.mark.slow


def small_state(law: Law, *, bonded: bool) -> State:
    """Nine disks on a square grid that touch, with damping."""
    radius = np.full(9, 1.0e-3)
    column, row = np.meshgrid(np.arange(3.0), np.arange(3.0))
    x, y = 1.999e-3 * column.ravel(), 1.999e-3 * row.ravel()
    bonds = Bonds(near_pairs(np.column_stack([x, y]), radius, 0.0)) if bonded else None
    scene = Scene(x, y, radius, bonds=bonds, damping=0.3)
    return start(scene, features=choose_features(scene, law, LANES, breakage=False))


kernels = pytest.mark.parametrize(
    ("law", "bonded"),
    [
        pytest.param("finite", False, marks=pytest.mark.full),
        pytest.param("finite", True, marks=pytest.mark.full),
        pytest.param("linear", False, marks=pytest.mark.full),
    ],
)


@cache
def fresh_kernel(law: Law, bonded: bool) -> Any:  # noqa: ANN401 - a function of numba
    """Kernel of that grid, compiled once for the tests of this file."""
    return assembly.fresh_kernel(small_state(law, bonded=bonded))


@kernels
@pytest.mark.skipif(REGISTER is None, reason="this processor has neither AVX-512 nor AVX2")
def test_the_pair_loop_works_on_whole_vector_registers(law: Law, bonded: bool) -> None:
    """The pair loop computes on registers of full width, and no division or root in it is done lane by lane."""
    loop = assembly.pair_loop(assembly.assembly_of(fresh_kernel(law, bonded)), REGISTER)
    kinds = loop.kinds(REGISTER)
    # The shortest kernel (constant stiffness) has 31 operations: less is no vector code.
    assert kinds["other arithmetic"] >= 20
    assert kinds["load or store"] >= 4
    assert loop.scalar(SCALAR_DIVIDER) == []


@kernels
def test_no_operation_depends_on_the_processor(law: Law, bonded: bool) -> None:
    """Nowhere in the kernel is a multiply-add or an estimate, neither here nor in what LLVM makes of it for aarch64."""
    kernel = fresh_kernel(law, bonded)
    here, there = assembly.assembly_of(kernel), assembly.assembly_for("aarch64-unknown-linux-gnu", kernel)
    for text, product in ((here, r"\tv?mulpd\s"), (there, r"\tfmul\s")):
        assert re.search(product, text)
        assert re.search(CONTRACTED, text) is None
