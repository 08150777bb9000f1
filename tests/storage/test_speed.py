"""Large campaigns: queries use indices; their seconds are shown but not asserted, on a shared machine."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import pytest
from sqlalchemy import select, text
from sqlalchemy.dialects import sqlite

from calcidem.app.campaign.opened import open_campaign
from calcidem.ends import CellStatus
from calcidem.storage.records import CellKey, Selection
from calcidem.storage.sql.reading import StoreReader, _conditions
from calcidem.storage.sql.store import Store, _attempt_in
from calcidem.storage.sql.tables import ATTEMPT, CELL, EXPRESSIONS, join_results

if TYPE_CHECKING:
    from conftest import Records

pytestmark = pytest.mark.slow

CONTENTS = tuple(0.5 * i for i in range(17))
Large: TypeAlias = "tuple[Path, Stopwatch, range]"


class Stopwatch:
    """Runs actions and notes how long they took."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def __call__(self, name: str, action: Callable[[], Any]) -> Any:  # noqa: ANN401 - whatever the action returns
        """Run an action."""
        start = time.perf_counter()
        result = action()
        self.lines.append(f"{name} {time.perf_counter() - start:.2f} s")
        return result


@pytest.fixture(
    scope="module", params=[2_000, *(pytest.param(count, marks=pytest.mark.full) for count in (10_000, 100_000))]
)
def large(tmp_path_factory: pytest.TempPathFactory, records: "Records", request: pytest.FixtureRequest) -> Large:
    """Make a database of so many done cells, for every commit of a tenth of them."""
    path, timed = tmp_path_factory.mktemp("large") / "large.db", Stopwatch()
    seeds = range(request.param // len(CONTENTS))
    with Store(path) as store:
        timed("plan", lambda: store.begin_campaign(records.campaign(seeds=tuple(seeds), contents=CONTENTS)))
        cells = (records.done(seed, content) for seed in seeds for content in CONTENTS)
        assert timed("store", lambda: store.record_results(cells)) == len(seeds) * len(CONTENTS)
    return path, timed, seeds


def test_seconds_of_a_large_campaign(large: Large, capsys: pytest.CaptureFixture[str]) -> None:
    """A large campaign is complete in every way of reading it; its seconds are printed."""
    path, timed, seeds = large
    with timed("open", lambda: open_campaign(path)) as campaign:
        assert timed("pending", lambda: campaign.store.pending(seeds, CONTENTS)) == ()
        counts = timed("status counts", campaign.status_counts)
        assert counts == {(content, CellStatus.DONE): len(seeds) for content in CONTENTS}
        assert int(timed("vs", campaign.vs).count()) == len(seeds) * len(CONTENTS)
        found = timed("select one content", lambda: list(campaign.select(content=5.0, status="done")))
        assert len(found) == len(seeds)
        assert timed("dataset", campaign.to_xarray).sizes == {"seed": len(seeds), "content": len(CONTENTS)}
    with capsys.disabled():
        size = path.stat().st_size / 1e6
        print(f"\n{len(seeds) * len(CONTENTS):,} cells, {size:.0f} MB: {', '.join(timed.lines)}")  # noqa: T201 - the test's output


@pytest.mark.parametrize(
    ("selection", "index"),
    [
        (Selection(), "(campaign_id=?"),
        (Selection(contents=(5.0,)), "(campaign_id=? AND content=?"),
        (Selection(contents=(5.0, 6.0), statuses=(CellStatus.DONE,)), "(campaign_id=?"),
        (Selection(contents=(5.0,), where="vs > 1160 and steps < 10000"), "(campaign_id=? AND content=?"),
        (Selection(seeds=(3,)), "(campaign_id=? AND seed"),
        (Selection(seeds=(3, 5)), "(campaign_id=? AND seed"),
        (Selection(statuses=(CellStatus.FAILED,)), "(campaign_id=?"),
        (Selection(where="vs > 1160 and status == 'done'"), "(campaign_id=?"),
    ],
)
def test_queries_use_indices(large: Large, selection: Selection, index: str) -> None:
    """Among many cells every selection searches an index and scans no table, whatever columns it joins."""
    path, *_ = large
    with Store(path) as store, store._reading() as session:
        columns = list(EXPRESSIONS.values())
        statement = (
            join_results(select(*columns)).where(*_conditions(1, selection)).order_by(CELL.c.seed, CELL.c.content)
        )
        compiled = statement.compile(dialect=sqlite.dialect(), compile_kwargs={"literal_binds": True})
        plan = [row.detail for row in session.execute(text(f"EXPLAIN QUERY PLAN {compiled}"))]
    assert not any(line.startswith("SCAN") for line in plan), plan
    assert any("INDEX" in line and index in line for line in plan), plan


@pytest.mark.parametrize("keys", [[CellKey(3, 5.0)], [CellKey(seed, 5.0) for seed in range(0, 800, 100)]])
def test_listed_cells_are_searched_by_their_keys(large: Large, keys: list[CellKey]) -> None:
    """Storing a batch looks its cells and attempts up by index, however many cells the campaign has."""
    path, *_ = large
    with Store(path) as store, store._reading() as session:
        for statement, columns in (
            (
                select(CELL.c.id).where(CELL.c.campaign_id == 1, StoreReader._cell_in(keys)),
                ("campaign_id=?", "seed=?", "content=?"),
            ),
            (select(ATTEMPT.c.outcome).where(_attempt_in([(7, 1), (9, 2)])), ("cell_id=?",)),
        ):
            compiled = statement.compile(dialect=sqlite.dialect(), compile_kwargs={"literal_binds": True})
            plan = [row.detail for row in session.execute(text(f"EXPLAIN QUERY PLAN {compiled}"))]
            search = next(line for line in plan if line.startswith("SEARCH"))
            assert all(column in search for column in columns), plan
