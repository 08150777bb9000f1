"""Settings under which a new process takes this computer for another processor.

Numba, NumPy, OpenBLAS and the C library each look for themselves, so each is told. Only what the real processor has can
be pretended; `playable` says which of the processors that leaves.
"""

import os
from importlib import import_module

import numpy as np
from llvmlite.binding import get_host_cpu_features

SSE2 = ("cmov", "cx8", "fxsr", "mmx", "sse", "sse2", "64bit")
SSE4 = (*SSE2, "cx16", "sahf", "popcnt", "sse3", "ssse3", "sse4.1", "sse4.2")
AVX2 = (*SSE4, "avx", "xsave", "avx2", "bmi", "bmi2", "f16c", "lzcnt", "movbe")
FMA = (*AVX2, "fma")
AVX512 = (*FMA, "avx512f", "avx512cd", "avx512bw", "avx512dq", "avx512vl")

NO_FMA = "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F"
PROCESSORS = {
    # name: what LLVM calls it, its features, core of OpenBLAS, levels that NumPy may use, tunables of glibc
    "SSE2": ("x86-64", SSE2, "Nehalem", (), NO_FMA),
    "SSE4": ("nehalem", SSE4, "Nehalem", (), NO_FMA),
    "AVX2 without FMA": ("haswell", AVX2, "Sandybridge", (), NO_FMA),
    "AVX2": ("haswell", FMA, "Haswell", ("AVX2", "FMA3", "X86_V3"), ""),
    "AVX2, Zen": ("znver2", FMA, "Zen", ("AVX2", "FMA3", "X86_V3"), ""),
    "AVX-512": (
        "skylake-avx512",
        AVX512,
        "SkylakeX",
        ("AVX2", "FMA3", "X86_V3", "AVX512F", "AVX512_SKX", "X86_V4"),
        "",
    ),
    "as it is": None,
}


def playable() -> list[str]:
    """Names of the processors that this computer can play."""
    real = get_host_cpu_features()
    return [name for name, kind in PROCESSORS.items() if kind is None or all(real.get(flag) for flag in kind[1])]


def environment(name: str) -> dict[str, str]:
    """Environment of a process that runs on a processor."""
    base = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    kind = PROCESSORS[name]
    if kind is None:
        return base
    llvm_name, features, core, levels, tunables = kind
    switches = [("+" if flag in features else "-") + flag for flag in get_host_cpu_features()]
    return {
        **base,
        "NUMBA_CPU_NAME": llvm_name,
        "NUMBA_CPU_FEATURES": ",".join(switches),
        "OPENBLAS_CORETYPE": core,
        "NPY_DISABLE_CPU_FEATURES": " ".join(level for level in dispatched() if level not in levels),
        "GLIBC_TUNABLES": tunables,
    }


def dispatched() -> list[str]:
    """Levels above its baseline for which this NumPy has code, and which this computer has."""
    core = import_module("numpy._core._multiarray_umath" if hasattr(np, "_core") else "numpy.core._multiarray_umath")
    return [level for level in core.__cpu_dispatch__ if core.__cpu_features__.get(level)]
