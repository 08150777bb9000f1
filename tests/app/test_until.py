"""Seeds that are added until mean and scatter are known: the same ones whoever computes them, and no others."""

import random
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy import stats

from calcidem.app.campaign.cells import SeedDemand
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.preview import preview_lines
from calcidem.app.campaign.run import CampaignRun, describe_run, retry_cells
from calcidem.app.config.reader import load_configuration
from calcidem.app.config.schema import CampaignPlan, Configuration, ConfigurationError, WantedIntervals
from calcidem.ends import CellStatus
from calcidem.storage.records import CellKey, CellResult
from calcidem.sweep.run import run_sweep
from calcidem.sweep.schedule import Batch, BatchOutcome, Cell, plan_batches
from calcidem.wording import listening

if TYPE_CHECKING:
    from conftest import Workshop

CONTENTS = (0.0, 0.66, 5.0, 9.0)
PLAN = CampaignPlan(seeds=8, contents=CONTENTS, until=WantedIntervals(mean=0.05, sd=0.2), most_seeds=300)
SCATTER = {0.0: 0.0, 0.66: 0.1, 5.0: 0.25, 9.0: 1.5}
"""Standard deviation of the logarithm; 9 % is never known as well as asked."""

UNTIL = """
[campaign]
name = "small"
seeds = {seeds}
until = {until}
contents = [0.66]
"""


def velocity(cell: Cell) -> float:
    """Velocity of a cell, m/s, from its key alone; every ninth seed of 0.66 % has none."""
    seed, content = cell
    if content == 0.66 and seed % 9 == 0:
        return np.nan
    return 1000.0 * float(
        np.exp(SCATTER[content] * np.random.default_rng([seed, int(100 * content)]).standard_normal())
    )


def measured(batch: Batch[Cell], _raise_if_stopped: Callable[[], None]) -> Sequence[CellResult]:
    """Stand in for a measurement."""
    results = []
    numerics = {"frequency": 8e3, "time_step": 1e-7, "stability_limit": 2e-7, "steps": 1}
    for cell in batch.cells:
        vs = velocity(cell)
        status = CellStatus.DONE if np.isfinite(vs) else CellStatus.NO_ARRIVAL
        found = CellResult(
            CellKey(*cell), status, "unread", vs=vs if np.isfinite(vs) else None, seconds=0.0, **numerics
        )
        results.append(found.pack())
    return results


def computed(known: dict[Cell, float], order: random.Random) -> dict[Cell, float]:
    """Cells of a campaign that begins with those that are known, with outcomes that come in any order."""
    demand, known = SeedDemand(PLAN, known), dict(known)
    waiting = [cell for cell in demand.cells if cell not in known]
    while waiting:
        cell = waiting.pop(order.randrange(len(waiting)))
        known[cell] = velocity(cell)
        batch = Batch((cell,))
        waiting += demand.take_in([BatchOutcome(batch, 0.0, tuple(measured(batch, lambda: None)))])
    assert set(known) == set(demand.cells)
    return known


def test_the_seeds_do_not_depend_on_order_or_interruption() -> None:
    """Outcomes in two orders, and after a stop at any place, ask for the same cells; each content for what it needs."""
    expected = computed({}, random.Random(1))
    assert set(computed({}, random.Random(2))) == set(expected)
    part = dict(random.Random(3).sample(sorted(expected.items()), len(expected) // 2))
    assert set(computed(part, random.Random(4))) == set(expected)
    counts = {content: sum(cell[1] == content for cell in expected) for content in CONTENTS}
    assert counts[0.0] == 8 < counts[0.66] < counts[5.0] < counts[9.0] == PLAN.most_seeds
    lines = list(SeedDemand(PLAN, expected).lines())
    assert lines[0].startswith(f"Seeds: 8 to 300 a content, {len(expected)} cells, ")
    assert lines[1:] == ["9 %: intervals are wider than campaign.until; campaign.most_seeds is 300."]


def test_contents_that_cannot_be_read_are_given_up() -> None:
    """Where fewer than half of the seeds have a velocity no more are computed, and it is said."""
    demand = SeedDemand(PLAN, {(seed, content): np.nan for seed in range(1, 9) for content in CONTENTS})
    assert len(demand.cells) == 8 * len(CONTENTS)
    assert list(demand.lines())[1] == "0 %: no more seeds, since only 0 of 8 have a velocity."


class KeepingSink:
    """Keeps which cells were settled."""

    def __init__(self) -> None:
        self.cells: list[Cell] = []

    def store(self, outcomes: Sequence[BatchOutcome[Cell, CellResult]]) -> None:
        """Keep."""
        self.cells += [cell for outcome in outcomes for cell in outcome.batch.cells]

    def mark(self, batches: Sequence[Batch[Cell]]) -> None:
        """Do nothing."""

    def keep_alive(self) -> None:
        """Do nothing."""


@pytest.mark.parametrize("pool", [None, 1, 3])
def test_a_sweep_computes_what_is_asked_for_meanwhile(pool: int | None) -> None:
    """One process and threads of an executor settle each cell once, and the same cells."""
    demand, sink = SeedDemand(PLAN, {}), KeepingSink()

    def batches(cells: Sequence[Cell]) -> tuple[Batch[Cell], ...]:
        return plan_batches(cells, 8, lambda _: 1.0)

    where = None if pool is None else ThreadPoolExecutor(pool)
    end = run_sweep(where, batches(demand.cells), measured, sink, more=lambda found: batches(demand.take_in(found)))
    assert end.exit_code == 0
    assert len(sink.cells) == len(set(sink.cells)) == end.tally.total()
    assert set(sink.cells) == set(computed({}, random.Random(1)))


@pytest.mark.parametrize("seeds", ["4", "[1, 2, 3, 4, 5, 6, 7, 8]", "2000"])
def test_the_seeds_to_begin_with_are_a_number_that_suffices(tmp_path: Path, seeds: str) -> None:
    """From 8 to campaign.most_seeds; the sentence names both."""
    (tmp_path / "c.toml").write_text(UNTIL.format(seeds=seeds, until="{ mean = 0.02 }"))
    with pytest.raises(ConfigurationError, match=r"give a number of 8 to campaign\.most_seeds, 1000"):
        load_configuration(tmp_path / "c.toml")


def test_what_is_wanted_is_no_part_of_the_identity_and_has_no_parts(tmp_path: Path) -> None:
    """The hash is that of the campaign without it; a part, an empty table and a width of 0 are refused in words."""
    path = tmp_path / "c.toml"
    path.write_text(UNTIL.format(seeds=8, until="{ mean = 0.02, sd = 0.1 }"))
    found = load_configuration(path)
    assert found.campaign.until == WantedIntervals(0.02, 0.1)
    assert found.hash == replace(found, campaign=CampaignPlan()).hash == Configuration().hash
    with pytest.raises(ConfigurationError, match="until adds seeds during the run"):
        load_configuration(path, {"part": "1/2"})
    for table, words in (
        ("{}", "give mean or sd"),
        ("{ mean = 0.0 }", "mean"),
        ("{ men = 0.1 }", 'did you mean "mean"'),
    ):
        path.write_text(UNTIL.format(seeds=8, until=table))
        with pytest.raises(ConfigurationError, match=words):
            load_configuration(path)


def test_a_cell_that_is_given_up_at_a_start_counts_at_that_start(tmp_path: Path) -> None:
    """Its content gets its further seeds in the same run, not in the next one."""
    path = tmp_path / "c.toml"
    path.write_text(UNTIL.format(seeds=8, until="{ mean = 0.02 }"))
    configuration = load_configuration(path, {"database": str(tmp_path / "c.db"), "output": str(tmp_path)})
    said: list[str] = []
    with listening(said.append), CampaignRun(configuration) as work:
        for _ in range(3):  # deaths
            work.store.begin_run(describe_run(2))
            work.store.record_running([CellKey(8, 0.66)])
        work.store.begin_run(describe_run(2))
        known = [measured(Batch(((seed, 0.66),)), lambda: None)[0] for seed in range(1, 8)]
        work.store.record_results(known)
        batches = work._plan_batches()
        deaths = work.store.attempt_counts([CellKey(8, 0.66)])[CellKey(8, 0.66)]
        work.store.record_results([CellResult(CellKey(9, 0.66), CellStatus.FAILED, "on order")])
    assert "quarantined: seed 8, 0.66 %: 3 runs died" in said[-1]
    assert min(seed for batch in batches for seed, _ in batch.cells) == 9
    assert (deaths.attempts, deaths.losses) == (4, 3)
    assert retry_cells(configuration, [CellStatus.FAILED]) == (CellKey(9, 0.66),)


def test_a_preview_counts_the_seeds_that_are_added(tmp_path: Path) -> None:
    """Of a run that was stopped once its first seeds were done; their scatter gives the half-width of the mean."""
    path = tmp_path / "c.toml"
    path.write_text(UNTIL.format(seeds=8, until="{ mean = 0.02 }"))
    configuration = load_configuration(path, {"database": str(tmp_path / "c.db"), "output": str(tmp_path)})
    with CampaignRun(configuration) as work:
        work.store.begin_run(describe_run(2))
        work._plan_batches()
        work.store.record_results([measured(Batch(((seed, 0.66),)), lambda: None)[0] for seed in range(1, 9)])
        count = len(SeedDemand.of_store(work.store, configuration.campaign).cells) - 8
        vs = work.store.table(("vs",))["vs"].astype(float)
    assert count > 0
    lines = preview_lines(configuration)
    assert f"8 are finished, {count} samples are to be computed" in next(lines)
    half_width = stats.t.ppf(0.975, 7) * np.nanstd(vs, ddof=1) / np.sqrt(8)
    assert f"All 8 seeds give the mean of Vs to +- {half_width:.1f} m/s (0.66 %)" in next(lines)


@pytest.mark.full
@pytest.mark.mpi
def test_ranks_and_a_stop_do_not_change_the_seeds(workshop: "Workshop") -> None:
    """One process, three ranks, and three ranks that were stopped and started again store the same cells and bits."""
    workshop.configure(seeds="8\nuntil = { mean = 0.05, sd = 0.35 }\nmost_seeds = 40", contents=(0.66,))
    assert workshop.run("run", "c.toml").code == 0
    expected = workshop.cells()
    assert 8 < len(expected) <= 40
    for stop in (False, True):
        workshop.database.unlink()
        if stop:
            process = workshop.start("run", "c.toml", "--ranks", "3")
            workshop.wait_for_cells(9)  # of the seeds that were added
            process.send_signal(signal.SIGTERM)
            assert workshop.wait(process).code == 75
            assert len(workshop.cells()) < len(expected)
        done = workshop.run("run", "c.toml", "--ranks", "3")
        assert done.code == 0, done.errors
        assert workshop.cells() == expected
        assert workshop.attempts() == len(expected)
    assert "Seeds:" in done.output
    with open_campaign(workshop.database) as campaign:
        assert len(campaign.store.statuses()) == len(expected)
