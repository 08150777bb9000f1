"""Properties of the processes of a run on which bits could depend."""

import ctypes
import platform
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from importlib import import_module
from types import ModuleType

from calcidem.app.campaign.provenance import library_versions
from calcidem.app.config.schema import PHYSICS_VERSION
from calcidem.dem.kernels.compiling import target_processor
from calcidem.storage.records import WorkerRecord

PORTABLE_ARCHITECTURES = ("x86_64", "aarch64")
"""Families of processors; within each all bits are the same, see `_describe_doubt`."""

_OTHER_NAMES = {"amd64": "x86_64", "arm64": "aarch64"}
"""Names of processor families on Windows and macOS, and on Linux."""

_CORE_FUNCTIONS = ("scipy_openblas_get_corename64_", "openblas_get_corename64_", "openblas_get_corename")
"""Functions of OpenBLAS that return its processor, in present and earlier wheels of numpy, and in other installations.
"""


@cache  # cached, since a process does not change
def describe_worker(rank: int) -> WorkerRecord:
    """Description of this process."""
    processor, features = target_processor()
    machine = platform.machine().lower()
    return WorkerRecord(
        ranks=(rank,),
        hosts=(platform.node(),),
        architecture=_OTHER_NAMES.get(machine, machine),
        processor=processor,
        features=features,
        blas_core=_blas_core(),
        numpy_simd=_numpy_simd(),
        versions=library_versions() | {"physics": str(PHYSICS_VERSION)},
    )


def _numpy_core() -> ModuleType:
    """The module of numpy in machine code, where numpy has it since version 2, or else before."""
    try:
        return import_module("numpy._core._multiarray_umath")
    except ImportError:
        return import_module("numpy.core._multiarray_umath")


def _numpy_simd() -> tuple[str, ...]:
    """Instruction sets beyond numpy's baseline that numpy uses here; empty if unknown."""
    core = _numpy_core()
    found = getattr(core, "__cpu_features__", {})
    return tuple(name for name in getattr(core, "__cpu_dispatch__", ()) if found.get(name))


def _blas_core() -> str | None:
    """Processor for which numpy's OpenBLAS has chosen its kernels; None for another BLAS, or if unknown."""
    try:
        library = ctypes.CDLL(str(_numpy_core().__file__))  # linked libraries are searched, too
    except OSError:
        return None
    function = next((getattr(library, name) for name in _CORE_FUNCTIONS if hasattr(library, name)), None)
    if function is None:
        return None
    function.restype = ctypes.c_char_p
    core: bytes | None = function()
    return None if core is None else core.decode("ascii", "replace")


def group_workers(workers: Iterable[WorkerRecord]) -> tuple[WorkerRecord, ...]:
    """One record for all equal workers, with their ranks and hosts."""
    groups: list[WorkerRecord] = []
    for worker in workers:
        alike = next(
            (i for i, group in enumerate(groups) if replace(worker, ranks=group.ranks, hosts=group.hosts) == group),
            None,
        )
        if alike is None:
            groups.append(worker)
        else:
            group = groups[alike]
            hosts = tuple(dict.fromkeys((*group.hosts, *worker.hosts)))
            groups[alike] = replace(group, ranks=(*group.ranks, *worker.ranks), hosts=hosts)
    return tuple(groups)


def _differing_versions(workers: Sequence[WorkerRecord]) -> tuple[str, ...]:
    """Libraries of which these workers have several versions."""
    names = dict.fromkeys(name for worker in workers for name in worker.versions)
    return tuple(name for name in names if len({worker.versions.get(name) for worker in workers}) > 1)


def _describe_doubt(workers: Sequence[WorkerRecord]) -> str:
    """Reason why a cell could have different bits on these workers; empty without one.

    The sources fix the order of the IEEE 754 arithmetic, and calcidem has its own functions. So bits depend neither on
    features of the processor, nor on BLAS, numpy's vector functions, the C library, or versions of libraries.
    `tests/dem/bits` compares them on x86-64. By construction aarch64 has the same bits, but a campaign on both at once
    was not compared.
    """
    architectures = sorted({worker.architecture for worker in workers})
    if len(architectures) > 1:
        return f"there is no comparison of the bits of {' and '.join(architectures)}"
    if not set(architectures) <= set(PORTABLE_ARCHITECTURES):
        return f"there is no comparison of the bits of different processors of {architectures[0]}"
    ours = [name for name in ("physics", "calcidem") if name in _differing_versions(workers)]
    return f"they have several versions of {' and '.join(ours)}" if ours else ""


def describe_unlike(workers: Sequence[WorkerRecord]) -> str:
    """Sentence for a run whose workers are of several kinds, a warning if bits could differ; empty for one kind."""
    if len(workers) == 1:
        return ""
    several = _differing_versions(workers)
    kinds = "; ".join(
        ", ".join([worker.kind, *(f"{name} {worker.versions.get(name, 'none')}" for name in several)])
        + f" on {worker.places}"
        for worker in workers
    )
    if doubt := _describe_doubt(workers):
        return (
            f"Warning: the ranks are not alike, and {doubt}, so a cell could have other bits on one than on another: "
            f"{kinds}. Use machines of one kind, with one installation."
        )
    return f"The ranks are not alike, but no bit of a result depends on it: {kinds}."
