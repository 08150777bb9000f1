"""Databases to test on, and small factories of records."""

import dataclasses
import uuid
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
import pytest
from sqlalchemy import NullPool, create_engine, text
from sqlalchemy.exc import OperationalError

from calcidem.ends import CellStatus
from calcidem.storage.records import (
    CampaignRecord,
    CellKey,
    CellResult,
    CementPattern,
    GrainPath,
    NetworkFeatures,
    PackingRecord,
    PathFeatures,
    RecordedSection,
    RunRecord,
    canonical_hash,
    canonical_json,
)
from calcidem.storage.sql.store import Store

MOMENT = datetime(2024, 5, 17, 12, 30, 15, 123456, tzinfo=UTC)
SEEDS = range(4)
CONTENTS = (0.0, 0.3, 5.0)


@dataclasses.dataclass(frozen=True)
class Records:
    """Factories of valid records; keyword arguments change fields."""

    def campaign(self, config: dict[str, Any] | None = None, **changes: Any) -> CampaignRecord:  # noqa: ANN401
        """Build a campaign of 4 seeds and 3 contents."""
        config = {"packing": {"friction": 0.2}, "wave": {"v0": 1e-5}} if config is None else config
        record = CampaignRecord(
            hash=canonical_hash(config),
            name="quick",
            config=canonical_json(config),
            contents=CONTENTS,
            seeds=tuple(SEEDS),
            created=MOMENT,
        )
        return dataclasses.replace(record, **changes)

    def run(self, **changes: Any) -> RunRecord:  # noqa: ANN401
        """Build the provenance of a run."""
        record = RunRecord(
            versions={"python": "3.11.7", "numpy": "2.4.6"},
            host="node7",
            cpu="Some CPU",
            ranks=4,
            launch_line="mpirun -n 4 calcidem run quick.toml",
            started=MOMENT,
            mpi_library="Open MPI 5.0.11",
            git_commit="0123abc",
            git_dirty=False,
            slurm_job_id="4711",
        )
        return dataclasses.replace(record, **changes)

    def done(self, seed: int = 0, content: float = 5.0, **changes: Any) -> CellResult:  # noqa: ANN401
        """Build a done cell without arrays, its velocity depending on the cell."""
        values: dict[str, Any] = {
            "vs": 150.0 + 200.0 * content + seed,
            "vs_peak": 151.0,
            "coherence": 0.9,
            "reading_error": 0.012,
            "frequency": 15e3,
            "time_step": 8e-8,
            "stability_limit": 1.1e-7,
            "steps": 12_000,
            "effective_vs": 1120.0,
            "effective_error": 0.03,
            "vs_bias": 0.05,
            "law": "linear",
            "numerical_error": 2e-3,
            "content_reached": content,
            "distance": 0.094,
            "wavelengths_on_path": 1.25,
            "wavelength_over_d50": 28.5,
            "pulse_effect": 1e-3,
            "static_speed": 1400.5,
            "content_of_contacts": 3.5,
            "broken_bonds": 3,
            "p_contacts": 400,
            "c_contacts": 900,
            "clusters": 250,
            "bonded_contacts": 1250,
            "seconds": 1.25,
            "rank": 3,
            "host": "node7",
        }
        return CellResult(CellKey(seed, content), CellStatus.DONE, **(values | changes))

    def failed(
        self, seed: int = 0, content: float = 5.0, *, status: CellStatus = CellStatus.FAILED, attempt: int = 1
    ) -> CellResult:
        """Build a cell without velocity."""
        return CellResult(CellKey(seed, content), status, "the pick was not clear", attempt=attempt, rank=1)

    def with_arrays(self, seed: int = 0, content: float = 5.0) -> CellResult:
        """Build a done cell with path, section and cement."""
        samples, contacts, clusters = 30 + seed, 20 + seed, int(content)
        features = PathFeatures(
            path_contacts=3,
            path_hertz_contacts=1,
            path_bonded_contacts=2,
            path_bonded_fraction=2 / 3,
            path_longest_bonded_run_fraction=1 / 3,
            path_longest_bonded_run=1,
            path_connectivity=2.66,
            path_normalized_connectivity=None if seed == 0 else 1.1,
        )
        path = GrainPath(np.array([4, 8, 15, 16]))
        start = 12.5 * 8e-8
        motion = (1000 * np.arange(6 * samples) - 7 * int(content)).reshape(2, samples, 3)
        section = RecordedSection(1e-6, start, 15e3, 2.0**-20 * 1e-3, [0.03, 0.06, 0.094], *motion)
        pairs = np.arange(2 * contacts).reshape(contacts, 2)
        cement = CementPattern(pairs, 1 + pairs[:, 0] % 4 // 2, np.arange(2 * clusters).reshape(clusters, 2) / 300.0)
        network = NetworkFeatures(
            network_conductance=0.04,
            network_cemented_share=0.4,
            network_strong_share=0.5,
            network_coordination_number=None if seed == 0 else 2.8,
            network_anisotropy=-0.01,
            network_components=4,
            network_largest_component=12,
            network_gap_contacts=None if seed == 0 else 2,
        )
        retry = "velocities above ten times that of the pulse"
        return self.done(
            seed, content, features=features, network=network, path=path, section=section, cement=cement, retry=retry
        )

    def packing(self, index: int = 0, **changes: Any) -> PackingRecord:  # noqa: ANN401
        """Build a packing of 50 grains."""
        x = np.arange(50) / 513.0
        y = (np.arange(50) * 37 + index) % 50 / 171.0
        record = PackingRecord(
            index=index,
            hash=f"packing-{index}",
            x=x,
            y=y,
            radius=np.full(50, 1.2e-3),
            width=0.1,
            height=0.2987654321,
            porosity=0.192,
            coordination_number=3.05,
            coordination_number_without_rattlers=3.6,
            wall_stress={"lid": 5.0e3, "floor": 5.1e3, "left": 3.3e3, "right": 3.4e3},
            mean_relative_overlap=4.6e-4,
            largest_relative_overlap=2.0e-3,
            unbalanced_ratio=9.0e-5,
            seconds=31.4,
            state=bytes(range(256)),
            content_hash=f"content-{index}",
        )
        return dataclasses.replace(record, **changes)


@pytest.fixture(scope="session")
def records() -> Records:
    """Factories of records."""
    return Records()


@pytest.fixture(scope="session")
def postgresql_template(postgresql_socket: Path) -> str:
    """Make an empty database in the present schema: copying it takes a tenth of the time that making one takes."""
    server = f"postgresql+psycopg://postgres@/postgres?host={postgresql_socket}"
    with create_engine(server, isolation_level="AUTOCOMMIT", poolclass=NullPool).connect() as connection:
        connection.execute(text("CREATE DATABASE migrated"))
    Store(f"postgresql://postgres@/migrated?host={postgresql_socket}").close()
    return "migrated"


@pytest.fixture
def postgresql_database(postgresql_socket: Path, postgresql_template: str) -> Iterator[str]:
    """Address of an empty database of the server, which is dropped with the test."""
    name = f"test_{uuid.uuid4().hex}"
    server = f"postgresql+psycopg://postgres@/postgres?host={postgresql_socket}"
    with create_engine(server, isolation_level="AUTOCOMMIT", poolclass=NullPool).connect() as connection:
        for attempt in range(30):
            try:
                connection.execute(text(f'CREATE DATABASE "{name}" TEMPLATE {postgresql_template}'))
                break
            except OperationalError:  # a session that has ended, or one of the server's own, may still be there
                if attempt == 29:
                    raise
                connection.execute(
                    text("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = :template"),
                    {"template": postgresql_template},
                )
                sleep(1.0)
        yield f"postgresql://postgres@/{name}?host={postgresql_socket}"
        connection.execute(text(f'DROP DATABASE "{name}" WITH (FORCE)'))


@pytest.fixture(params=["sqlite", "postgresql"])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Address of an empty database, once for each backend."""
    on_server = request.param == "postgresql"
    return request.getfixturevalue("postgresql_database") if on_server else str(tmp_path / "campaign.db")


@pytest.fixture
def open_here(address: str) -> Iterator[Callable[..., Store]]:
    """Open the empty database, as often as wanted; all are closed at the end."""
    opened: list[Store] = []

    def open_another(*, read_only: bool = False) -> Store:
        opened.append(Store(address, read_only=read_only))
        return opened[-1]

    yield open_another
    for store in opened:
        store.close()


@pytest.fixture
def store(open_here: Callable[..., Store], records: Records) -> Store:
    """Open a store with the campaign begun."""
    store = open_here()
    store.begin_campaign(records.campaign())
    return store
