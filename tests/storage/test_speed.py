"""Large campaigns: queries use indices; their seconds are shown but not asserted, on a shared machine."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import select, text
from sqlalchemy.dialects import sqlite

from calcidem.storage.campaign import open_campaign
from calcidem.storage.models import Cell
from calcidem.storage.reading import conditions, with_results
from calcidem.storage.records import CellStatus
from calcidem.storage.sql_store import open_store
from calcidem.storage.store import Selection

if TYPE_CHECKING:
    from conftest import Records

CONTENTS = tuple(0.5 * i for i in range(17))
SEEDS = range(100_000 // len(CONTENTS))


def test_seconds_for_100_000_cells(
    tmp_path: Path, records: "Records", capsys: pytest.CaptureFixture[str]
) -> None:
    """A campaign of 100,000 cells is complete in every way of reading it; its seconds are printed."""
    path = tmp_path / "large.db"
    lines: list[str] = []

    def timed(name: str, action: Callable[[], Any]) -> Any:  # noqa: ANN401 - whatever the action returns
        start = time.perf_counter()
        result = action()
        lines.append(f"{name} {time.perf_counter() - start:.2f} s")
        return result

    with open_store(path) as store:
        timed("plan", lambda: store.begin_campaign(records.campaign(seeds=tuple(SEEDS), contents=CONTENTS)))
        cells = (records.done(seed, content) for seed in SEEDS for content in CONTENTS)
        assert timed("store", lambda: store.record_results(cells)) == len(SEEDS) * len(CONTENTS)
        assert timed("pending", lambda: store.pending(SEEDS, CONTENTS)) == ()
        counts = timed("status counts", store.status_counts)
        assert counts == {(content, CellStatus.DONE): len(SEEDS) for content in CONTENTS}
    with timed("open", lambda: open_campaign(path)) as campaign:
        assert int(timed("vs", campaign.vs).count()) == len(SEEDS) * len(CONTENTS)
        found = timed("select one content", lambda: list(campaign.select(content=5.0, status="done")))
        assert len(found) == len(SEEDS)
        assert timed("dataset", campaign.to_xarray).sizes == {"seed": len(SEEDS), "content": len(CONTENTS)}
    with capsys.disabled():
        print(f"\n100,000 cells, {path.stat().st_size / 1e6:.0f} MB: {', '.join(lines)}")  # noqa: T201 - the test's output


@pytest.mark.parametrize(
    ("selection", "index"),
    [
        (Selection(contents=(5.0,)), "(campaign_id=? AND content=?"),
        (Selection(seeds=(3,)), "(campaign_id=? AND seed"),
        (Selection(seeds=(3, 5)), "(campaign_id=? AND seed"),
    ],
)
def test_queries_use_indices(tmp_path: Path, selection: Selection, index: str) -> None:
    """Selecting cells by content or seed searches an index and scans no table."""
    with open_store(tmp_path / "one.db") as store, store._reading() as session:
        statement = (
            with_results(select(Cell.id)).where(*conditions(1, selection)).order_by(Cell.seed, Cell.content)
        )
        compiled = statement.compile(dialect=sqlite.dialect(), compile_kwargs={"literal_binds": True})
        plan = [row.detail for row in session.execute(text(f"EXPLAIN QUERY PLAN {compiled}"))]
    assert not any(line.startswith("SCAN") for line in plan), plan
    assert any("INDEX" in line and index in line for line in plan), plan
