"""The clock of the compiler."""

import pytest
from numba import config

from calcidem.dem.kernels.compiling import compile_function, seconds_compiling


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled")
def test_compiling_has_a_clock_of_its_own() -> None:
    """It runs while a function is compiled for its arguments, and stands still when that is called again."""

    @compile_function()
    def twice(value: float) -> float:
        return 2.0 * value

    before = seconds_compiling()
    assert twice(1.5) == 3.0
    after = seconds_compiling()
    assert twice(2.5) == 5.0
    assert before < after == seconds_compiling()
