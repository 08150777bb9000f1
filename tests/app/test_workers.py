"""What the processes of a run are: described by what bits could depend on, compared, told and stored."""

import json
import os
import platform
import subprocess
import sys
from dataclasses import replace

import pytest
from places import CHECKOUT

from calcidem.app.campaign.workers import _describe_doubt, describe_unlike, describe_worker, group_workers
from calcidem.storage.records import WorkerRecord

DESCRIBE = """
import json
from dataclasses import asdict
from calcidem.app.campaign.workers import describe_worker
print(json.dumps(asdict(describe_worker(0))))
"""

ZEN = WorkerRecord(
    ranks=(0,),
    hosts=("a",),
    architecture="x86_64",
    processor="znver4",
    features=("avx512f",),
    blas_core="Zen",
    numpy_simd=("X86_V3", "X86_V4"),
    versions={"calcidem": "0.1.0", "physics": "1", "numpy": "2.4.6"},
)
INTEL = replace(ZEN, ranks=(1,), hosts=("b",), processor="skylake-avx512", blas_core="SkylakeX")


def described(**variables: str) -> WorkerRecord:
    """What a process with these variables says that it is."""
    environment = os.environ | {"PYTHONPATH": str(CHECKOUT)} | variables
    done = subprocess.run([sys.executable, "-c", DESCRIBE], check=True, capture_output=True, text=True, env=environment)
    return WorkerRecord(**json.loads(done.stdout))


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() != "x86_64", reason="the settings name processors of x86-64")
def test_settings_of_the_libraries_are_seen() -> None:
    """The names are those that LLVM, OpenBLAS and numpy go by, whatever made them choose; the rest stays."""
    own = described()
    assert own == describe_worker(0)
    other = described(
        NUMBA_CPU_NAME="nehalem", NUMBA_CPU_FEATURES="+sse4.2,-avx", OPENBLAS_CORETYPE="Nehalem", NUMBA_DISABLE_JIT="1"
    )
    assert (other.processor, other.features, other.blas_core) == ("nehalem", ("sse4.2",), "Nehalem")
    assert replace(other, processor=own.processor, features=own.features, blas_core=own.blas_core) == own
    if own.numpy_simd:
        off = [*own.numpy_simd, *os.environ.get("NPY_DISABLE_CPU_FEATURES", "").split()]
        assert described(NPY_DISABLE_CPU_FEATURES=" ".join(off)).numpy_simd == ()


def test_alike_workers_are_described_once() -> None:
    """Workers that differ only in where they are have one record, with all ranks and each host once."""
    workers = (ZEN, INTEL, replace(ZEN, ranks=(2,)), replace(ZEN, ranks=(3,), hosts=("c",)))
    assert group_workers(workers) == (replace(ZEN, ranks=(0, 2, 3), hosts=("a", "c")), INTEL)


def test_one_kind_of_workers_is_nothing_to_tell() -> None:
    """A run on equal machines says nothing."""
    assert describe_unlike([ZEN]) == ""


def test_other_processors_and_libraries_change_no_bit() -> None:
    """Processors, BLAS, numpy's level and versions of libraries may differ: it is said that no bit depends on them."""
    told = describe_unlike([ZEN, replace(INTEL, numpy_simd=(), versions=ZEN.versions | {"numpy": "1.26.0"})])
    assert told.startswith("The ranks are not alike, but no bit of a result depends on it: ")
    assert "znver4 (x86_64, 1 features), OpenBLAS Zen, numpy X86_V4, numpy 2.4.6 on a; " in told
    assert told.endswith("skylake-avx512 (x86_64, 1 features), OpenBLAS SkylakeX, numpy baseline, numpy 1.26.0 on b.")


@pytest.mark.parametrize(
    ("workers", "reason"),
    [
        ([ZEN, replace(ZEN, versions=ZEN.versions | {"calcidem": "0.2.0"})], "several versions of calcidem"),
        ([ZEN, replace(ZEN, versions=ZEN.versions | {"physics": "2"})], "several versions of physics"),
        ([ZEN, replace(ZEN, architecture="aarch64")], "there is no comparison of the bits of aarch64 and x86_64"),
        (
            [replace(ZEN, architecture="riscv64"), replace(INTEL, architecture="riscv64")],
            "there is no comparison of the bits of different processors of riscv64",
        ),
    ],
)
def test_doubts_are_told(workers: list[WorkerRecord], reason: str) -> None:
    """Several versions of calcidem or its physics, and processors that nobody has compared, are a warning."""
    assert reason in _describe_doubt(workers)
    assert describe_unlike(workers).startswith("Warning: the ranks are not alike, and ")
    assert reason in describe_unlike(workers)


def test_many_hosts_are_counted() -> None:
    """Of a hundred machines three are named."""
    many = replace(ZEN, hosts=tuple(f"n{i}" for i in range(100)))
    assert " on n0, n1, n2 and 97 more; " in describe_unlike([many, INTEL])
