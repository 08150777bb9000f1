"""Shared by all tests: a small campaign that is really packed, cemented and measured, once for a whole session."""

import fcntl
import os
import pwd
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from calcidem.app.campaign.cells import cell_result
from calcidem.app.campaign.packing import packing_from_bytes, packing_record
from calcidem.app.config.schema import Calibration, CampaignPlan, Configuration, Excitation, FrequencyTable
from calcidem.app.report.page import write_report
from calcidem.dem.kernels import steps
from calcidem.dem.sample.cement import CementRule
from calcidem.dem.sample.packing import Packing, PackingRule
from calcidem.dem.wave.experiment import WaveRule
from calcidem.dem.wave.measurement import measure
from calcidem.ends import CellStatus
from calcidem.storage.records import CampaignRecord, CellKey, CellResult, RunRecord, canonical_json
from calcidem.storage.sql.store import Store

sys.path.append(str(Path(__file__).parent))  # marked_processes.py and others, which tests use
from places import SMALL_PACKING, MakeOnce

settings.register_profile("untimed", deadline=None)  # how long an example takes is no property of the program
settings.load_profile("untimed")

SEEDS = (1, 2, 3, 4, 5, 6)
CONTENTS = (0.0, 0.34, 0.66, 2.55, 5.0, 9.0)
NOT_COMPUTED = (6, 0.34)
FAILED = (6, 9.0)


ROOM_OF_A_SERVER = 1e9
"""Bytes that a PostgreSQL server with the databases of a few tests may need; it begins with 60 MB."""

CALLERS = ("CALCIDEM_", "PG", "SLURM_", "XDG_")
"""Beginnings of the names of variables that would let a test see what its caller does."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take long, so that of several processes none works on alone in the end."""
    files = [{item.path for item in items if item.get_closest_marker(name)} for name in ("mpi", "slow")]
    items.sort(key=lambda item: [item.path not in long for long in files])


@contextmanager
def _own_folders() -> Iterator[pytest.MonkeyPatch]:
    """Work in a new folder, with another one as home; subprocesses do so, too."""
    with (
        tempfile.TemporaryDirectory(prefix="calcidem-test-", ignore_cleanup_errors=True) as folder,
        pytest.MonkeyPatch.context() as patch,
    ):
        for name in ("work", "home"):
            (Path(folder) / name).mkdir()
        patch.chdir(Path(folder) / "work")
        patch.setenv("HOME", str(Path(folder) / "home"))
        yield patch


@pytest.fixture(scope="session", autouse=True)
def _own_session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let fixtures that many tests share see neither the tree's results nor the caller's variables, caches and home."""
    with _own_folders() as patch:
        for name in os.environ:
            if name.startswith(CALLERS):
                patch.delenv(name)
        # Kernels stay where numba keeps them, beside the sources; fonts are listed once for all tests.
        patch.setenv("MPLCONFIGDIR", str(tmp_path_factory.mktemp("matplotlib")))
        yield


@pytest.fixture(scope="session", autouse=True)
def _compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let one process of pytest-xdist compile a kernel, and the others wait and load it."""
    place, alone = _shared_folder(tmp_path_factory), steps.advance_steps.compile

    def compile_or_load(signature: object) -> object:
        with (place / f"kernel-{sha256(str(signature).encode()).hexdigest()}").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            return alone(signature)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(steps.advance_steps, "compile", compile_or_load)
        yield


def _shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of all processes of pytest-xdist."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture(autouse=True)
def _own_surroundings(_own_session: None) -> Iterator[None]:
    """Let each test begin in an empty folder, with an empty home, and without signals that its caller ignores."""
    for number in (signal.SIGINT, signal.SIGHUP):  # as a shell's `&` and nohup do
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    with _own_folders():
        yield


@pytest.fixture(scope="session")
def small_packing(small_configuration: Configuration) -> Packing:
    """Give a packing of 280 disks, the same bits on every machine."""
    return packing_from_bytes(SMALL_PACKING.read_bytes(), small_configuration.packing_hash)


@pytest.fixture(scope="session")
def small_configuration() -> Configuration:
    """Give the configuration of `small_database`: 280 disks, 6 seeds and 6 contents."""
    return Configuration(
        campaign=CampaignPlan(name="small", seeds=SEEDS, contents=CONTENTS),
        packing=PackingRule(width=0.03, height=0.06, unbalanced_force_ratio=1e-5),
        calibration=Calibration(wave_stiffness_factor=13.0),
        pattern=CementRule(p_share=0.77),
        wave=WaveRule(
            transmitter_half_width=0.01, receiver_half_width=0.012, boundary_thickness=0.012, listening_depth=0.006
        ),
        # Three times those of the paper: on the short way of this box near field hides the arrival of longer waves.
        excitation=Excitation(FrequencyTable(CONTENTS, (12e3, 21e3, 24e3, 24e3, 45e3, 75e3))),
    )


@pytest.fixture(scope="session")
def make_once(tmp_path_factory: pytest.TempPathFactory) -> MakeOnce:
    """Give a function that fills a folder in the first process of pytest-xdist that needs it."""
    place = _shared_folder(tmp_path_factory)

    def make(name: str, fill: Callable[[Path], object]) -> Path:
        finished, begun = place / name, place / f"{name}-begun"
        with (place / f"{name}-lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not finished.exists():
                shutil.rmtree(begun, ignore_errors=True)
                begun.mkdir()
                fill(begun)
                begun.rename(finished)
        return finished

    return make


@pytest.fixture(scope="session")
def small_database(make_once: MakeOnce, small_configuration: Configuration, small_packing: Packing) -> Path:
    """Give the database of a small campaign in which one cell was not computed and one failed."""
    folder = make_once("campaign", lambda path: _fill_database(path / "small.db", small_configuration, small_packing))
    return folder / "small.db"


def _fill_database(path: Path, small_configuration: Configuration, small_packing: Packing) -> None:
    experiment = small_configuration.experiment(small_packing)
    now = datetime.now(UTC)
    with Store(path) as store:
        store.begin_campaign(
            CampaignRecord(
                small_configuration.hash,
                "small",
                canonical_json(small_configuration.physics),
                CONTENTS,
                SEEDS,
                now,
            )
        )
        run = RunRecord({"python": "3", "calcidem": "test"}, "here", "some CPU", 1, "pytest", now)
        store.begin_run(run)
        store.save_packing(packing_record(small_packing, index=0, packing_hash=small_configuration.packing_hash))
        for content in CONTENTS:
            measured = measure(experiment, content, SEEDS)
            store.record_results(
                cell_result(measurement, experiment, store_sections=True)
                for measurement in measured
                if (measurement.seed, content) not in {NOT_COMPUTED, FAILED}
            )
        store.record_results([CellResult(CellKey(*FAILED), CellStatus.FAILED, "the worker ran out of memory")])
        store.end_run("complete", datetime.now(UTC))


@pytest.fixture(scope="session")
def small_report(small_database: Path, make_once: MakeOnce) -> Path:
    """Give the report of the small campaign."""
    return make_once("report", lambda path: write_report(small_database, path / "report.html")) / "report.html"


@pytest.fixture(scope="session")
def postgresql_socket() -> Iterator[Path]:
    """Run a PostgreSQL server of its own and give the folder of its socket."""
    initdb = shutil.which("initdb") or next(
        (str(p) for p in sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))), None
    )
    if initdb is None:
        pytest.skip("PostgreSQL is not installed (Debian: apt-get install postgresql)")
    pytest.importorskip("psycopg", reason="the PostgreSQL driver is not installed (pip install 'psycopg[binary]')")
    user: dict[str, Any] = {}
    if os.geteuid() == 0:  # the server refuses to run as root
        try:
            user["user"] = pwd.getpwnam("postgres").pw_name
        except KeyError:
            pytest.skip("running as root without the user 'postgres' that Debian's package brings")
    # Most of its time is that of the disk for new databases; in memory a test of it takes a fifth.
    memory = Path("/dev/shm")  # noqa: S108 - mkdtemp makes a folder of its own in it
    fits = memory.is_dir() and shutil.disk_usage(memory).free > ROOM_OF_A_SERVER
    folder = Path(tempfile.mkdtemp(prefix="calcidem-pg-", dir=memory if fits else None))
    if user:
        shutil.chown(folder, **user)
    control = [str(Path(initdb).with_name("pg_ctl")), "-D", str(folder / "data"), "-w"]
    options = f"-k {folder} -c listen_addresses='' -c fsync=off -c max_connections=20"

    def run(*command: str) -> None:
        subprocess.run(command, check=True, cwd=folder, stdout=subprocess.DEVNULL, **user)

    run(initdb, "-D", str(folder / "data"), "-U", "postgres", "--no-sync")
    run(*control, "-l", str(folder / "log"), "-o", options, "start")
    yield folder
    run(*control, "-m", "immediate", "stop")
    shutil.rmtree(folder)
