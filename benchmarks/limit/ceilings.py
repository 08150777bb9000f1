"""What one core of this machine can do at most, measured with loops of lane vectors."""

from collections.abc import Callable
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
from numba import njit

from calcidem.dem.engine.assembly import aligned_zeros
from calcidem.dem.kernels.lanes import Vector, load, square_root, store
from calcidem.dem.kernels.layout import Floats

LANES = 8
WORK_SECONDS = 0.15
FMA_LATENCY = 4  # cycles, of every x86 core since 2015 (Intel from Skylake, AMD from Zen); gives the clock


@dataclass(frozen=True)
class Ceilings:
    """Measured rates of one core; vectors are eight doubles.

    Attributes
    ----------
    clock
        GHz, from the latency of dependent multiply-adds.
    multiply_add, division, square_root
        Nanoseconds of one independent vector operation.
    streams
        GB/s read plus written by a loop that scales an array in place, for each working set in bytes.
    """

    clock: float
    multiply_add: float
    division: float
    square_root: float
    streams: dict[int, float]


@njit(error_model="numpy")
def chained(values: Vector, rounds: int) -> None:
    """One chain of dependent multiply-adds."""
    a, b, c = load(values, (0,), LANES), load(values, (1,), LANES), load(values, (2,), LANES)
    for _ in range(rounds):
        a = a * b + c
    store(values, (0,), a)


@njit(error_model="numpy")
def multiply_adds(values: Vector, rounds: int) -> None:
    """Twelve independent chains: more than latency times two units."""
    a0, a1, a2 = load(values, (0,), LANES), load(values, (1,), LANES), load(values, (2,), LANES)
    a3, a4, a5 = load(values, (3,), LANES), load(values, (4,), LANES), load(values, (5,), LANES)
    a6, a7, a8 = load(values, (6,), LANES), load(values, (7,), LANES), load(values, (8,), LANES)
    a9, a10, a11 = load(values, (9,), LANES), load(values, (10,), LANES), load(values, (11,), LANES)
    b, c = load(values, (12,), LANES), load(values, (13,), LANES)
    for _ in range(rounds):
        a0, a1, a2, a3 = a0 * b + c, a1 * b + c, a2 * b + c, a3 * b + c
        a4, a5, a6, a7 = a4 * b + c, a5 * b + c, a6 * b + c, a7 * b + c
        a8, a9, a10, a11 = a8 * b + c, a9 * b + c, a10 * b + c, a11 * b + c
    total = ((a0 + a1) + (a2 + a3)) + ((a4 + a5) + (a6 + a7)) + ((a8 + a9) + (a10 + a11))
    store(values, (0,), total)


@njit(error_model="numpy")
def divisions(values: Vector, rounds: int) -> None:
    """Four independent chains of divisions."""
    a0, a1 = load(values, (0,), LANES), load(values, (1,), LANES)
    a2, a3, b = load(values, (2,), LANES), load(values, (3,), LANES), load(values, (4,), LANES)
    for _ in range(rounds):
        a0, a1, a2, a3 = b / a0, b / a1, b / a2, b / a3
    store(values, (0,), (a0 + a1) + (a2 + a3))


@njit(error_model="numpy")
def square_roots(values: Vector, rounds: int) -> None:
    """Four independent chains of square roots."""
    a0, a1 = load(values, (0,), LANES), load(values, (1,), LANES)
    a2, a3 = load(values, (2,), LANES), load(values, (3,), LANES)
    for _ in range(rounds):
        a0, a1, a2, a3 = square_root(a0), square_root(a1), square_root(a2), square_root(a3)
    store(values, (0,), (a0 + a1) + (a2 + a3))


@njit(error_model="numpy")
def scale(values: Vector, rounds: int) -> None:
    """Scale an array in place, again and again."""
    factor = load(values, (0,), LANES) * 0.0 + 1.0
    for _ in range(rounds):
        for row in range(values.shape[0]):
            store(values, (row,), load(values, (row,), LANES) * factor)


def seconds_of_a_round(function: Callable[[Any, int], None], rows: int) -> float:
    """Best CPU seconds of one round out of five runs."""
    values = aligned_zeros((rows, LANES), np.float64)
    values[...] = 1.0 + 1.0e-3 * (np.arange(rows)[:, None] % 7)
    function(values, 1)
    rounds = 1
    while (spent := timed(function, values, rounds)) < WORK_SECONDS:
        rounds = max(2 * rounds, int(rounds * 1.2 * WORK_SECONDS / max(spent, 1e-6)) if spent > 1e-3 else 0)  # noqa: PLR2004 - clock resolution
    return min(timed(function, values, rounds) for _ in range(5)) / rounds


def timed(function: Callable[[Any, int], None], values: Floats, rounds: int) -> float:
    """CPU seconds of some rounds."""
    before = process_time()
    function(values, rounds)
    return process_time() - before


def measure_ceilings() -> Ceilings:
    """Measure everything; about ten seconds."""
    sizes = [24 * 1024, 1024 * 1024, 4 * 1024 * 1024, 16 * 1024 * 1024, 256 * 1024 * 1024]
    row = LANES * 8
    return Ceilings(
        clock=FMA_LATENCY * 1e-9 / seconds_of_a_round(chained, 3),
        multiply_add=1e9 * seconds_of_a_round(multiply_adds, 14) / 12,
        division=1e9 * seconds_of_a_round(divisions, 5) / 4,
        square_root=1e9 * seconds_of_a_round(square_roots, 4) / 4,
        streams={size: 2e-9 * size / seconds_of_a_round(scale, size // row) for size in sizes},
    )
