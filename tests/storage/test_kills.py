"""SIGKILL at random moments of what writes a database, which is sometimes removed: nothing is lost or mixed."""

import os
import random
import signal
import time
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING
from unittest import mock

import netCDF4
import numpy as np
import pytest

from calcidem.app.campaign.merge import merge_databases
from calcidem.app.cli.exchange import _import_campaign
from calcidem.storage.errors import UnknownCampaignError
from calcidem.storage.netcdf import export_netcdf
from calcidem.storage.records import CellKey
from calcidem.storage.sql.engine import find_damage
from calcidem.storage.sql.store import Store, read_campaign

if TYPE_CHECKING:
    from conftest import Records

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")]

Told = set[tuple[int, float]]


class Trial:
    """A database that processes write and are killed at, and two others to take cells from."""

    def __init__(self, folder: Path, records: "Records") -> None:
        self.folder, self.records = folder, records
        (folder / "target").mkdir()
        self.target, self.source = folder / "target" / "r.db", folder / "a.db"
        with Store(self.source) as store:
            store.begin_campaign(records.campaign(seeds=tuple(range(20, 30))))
            store.begin_run(records.run())
            store.save_packing(records.packing())
            store.record_results([records.with_arrays(key.seed, key.content) for key in store.pending()])
            self.file = export_netcdf(store, folder / "a.nc")
            self.of_source = {(key.seed, key.content) for key in store.statuses()}
        self.commands: dict[str, tuple[float, Callable[[Callable[[Told], None]], None]]] = {
            "run": (2.0, self.run),
            "merge": (1.5, self.merge),
            "import": (2.0, self.import_),
            "export": (1.0, self.export),
        }
        """Latest moment of a kill, s, and what is killed."""

    def run(self, tell: Callable[[Told], None]) -> None:
        """Compute cells, one a transaction."""
        with Store(self.target) as store:
            store.begin_campaign(self.records.campaign(seeds=tuple(range(40))))
            store.acquire_lease()
            store.save_packing(self.records.packing())
            store.begin_run(self.records.run())
            for key in store.pending():
                store.record_running([key])
                store.record_results([self.records.with_arrays(key.seed, key.content)])
                tell({(key.seed, key.content)})

    def merge(self, tell: Callable[[Told], None]) -> None:
        """Merge the other database into this one."""
        merge_databases([str(self.source)], self.target)
        tell(self.of_source)

    def import_(self, tell: Callable[[Told], None]) -> None:
        """Import the exported file; what reads it on trial is a process of its own, which writes nothing."""
        with (
            mock.patch("calcidem.app.campaign.packing.stored_packing"),
            mock.patch("calcidem.storage.netcdf.refuse_unreadable"),
        ):
            _import_campaign(self.file, str(self.target))
        tell(self.of_source)

    def export(self, _tell: Callable[[Told], None]) -> None:
        """Export this database."""
        with mock.patch("calcidem.storage.netcdf.refuse_unreadable"), read_campaign(self.target) as store:
            export_netcdf(store, self.folder / "r.nc")

    def kill(self, name: str, moment: float) -> tuple[bool, Told]:
        """Kill a command some seconds after its start; return whether it was still running, and the stored cells."""
        reading, writing = os.pipe()

        def tell(cells: Told) -> None:
            os.write(writing, "".join(f"{seed} {content}\n" for seed, content in sorted(cells)).encode())

        child = os.fork()
        if child == 0:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            code = 1
            try:
                self.commands[name][1](tell)
                code = 0
            except BaseException:  # noqa: BLE001 - a fork must not go on with the tests
                traceback.print_exc()
            finally:
                os._exit(code)
        os.close(writing)
        time.sleep(moment)
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        with os.fdopen(reading) as pipe:
            lines = [line.split() for line in pipe]
        assert os.WIFSIGNALED(status) or status == 0 or (name == "export" and not self.has_campaign()), name
        return os.WIFSIGNALED(status), {(int(seed), float(content)) for seed, content in lines}

    def has_campaign(self) -> bool:
        """Whether the database is there and has its campaign."""
        if not self.target.exists():
            return False
        with Store(self.target, read_only=True) as store:
            return bool(store.campaigns())

    def check(self, acknowledged: Told) -> None:
        """The database is intact and has what was acknowledged, with the right numbers and arrays; the export, too."""
        if self.target.exists():
            assert find_damage(self.target, "integrity_check") == []
            with Store(self.target, read_only=True) as store:
                try:
                    store.use_campaign()
                    found = {result.key: result for result in store.results(with_arrays=True)}
                except UnknownCampaignError:
                    found = {}
            assert acknowledged <= {(key.seed, key.content) for key in found}
            for key, result in found.items():
                expected = self.records.with_arrays(key.seed, key.content)
                assert (result.vs, result.status) == (expected.vs, expected.status)
                assert result.section is not None
                assert expected.section is not None
                np.testing.assert_array_equal(result.section.across, expected.section.across)
        else:
            assert not acknowledged
        if (exported := self.folder / "r.nc").exists():
            with netCDF4.Dataset(exported) as file:
                vs = np.ma.filled(file["vs"][:], np.nan)
                for (row, column), value in np.ndenumerate(vs):
                    key = CellKey(int(file["seed"][row]), float(file["content"][column]))
                    assert np.isnan(value) or value == self.records.done(key.seed, key.content).vs


@pytest.mark.parametrize("kills", [8, pytest.param(200, marks=pytest.mark.full)])
def test_kills_lose_nothing_and_mix_nothing(
    tmp_path: Path, records: "Records", kills: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """After each kill: an intact file, all acknowledged cells, their bits; a removed database takes its log with it."""
    trial, random_numbers = Trial(tmp_path, records), random.Random(kills)
    acknowledged: Told = set()
    struck: Counter[str] = Counter()
    removed = with_log = told = 0
    while struck.total() < kills:
        name = random_numbers.choice(sorted(trial.commands))
        is_killed, stored = trial.kill(name, random_numbers.uniform(0.0, trial.commands[name][0]))
        struck[name] += is_killed
        acknowledged |= stored
        told += len(stored)
        has_log = any(Path(f"{trial.target}{end}").exists() for end in ("-wal", "-journal"))
        if trial.target.exists() and random_numbers.random() < (0.5 if has_log else 0.1):
            trial.target.unlink()  # before anything reads it, which would bring its log into it
            acknowledged.clear()
            removed += 1
            with_log += has_log
        trial.check(acknowledged)
    with capsys.disabled():
        print(  # noqa: T201 - the counts are what one wants to see
            f"\n{kills} kills ({dict(struck)}), {removed} removals of the file, {with_log} beside its log: "
            f"{told} acknowledged cells, none lost"
        )
