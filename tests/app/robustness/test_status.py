"""`calcidem status`: every state of a cell is seen, and the numbers are those of the database."""

import json
import os
import re
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from places import CHECKOUT
from rich.console import Console
from scipy import stats

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.status import CampaignStatus
from calcidem.app.cli.views import status_view
from calcidem.storage.records import CellKey
from calcidem.storage.sql.store import Store, read_campaign


def test_every_state_has_its_character(troubled: Path, invoke: Callable[..., str]) -> None:
    """The rows of the matrix show done, failed, timed-out, quarantined and no-arrival cells and pending ones."""
    lines = invoke("status", troubled).splitlines()
    rows = [line.split()[1] for line in lines if re.search("[#n]{8}", line)]
    assert rows == ["########F.", "########T.", "########Q.", "########.n", "########.."]


def test_troubles_are_named_with_their_history(troubled: Path, invoke: Callable[..., str]) -> None:
    """The quarantined cell comes first, with its attempts, its lost worker and the reason."""
    output = invoke("status", troubled)
    assert (
        "seed 9, 2.55 %: quarantined after 2 attempts, 1 run died meanwhile: what went wrong is quarantined" in output
    )
    assert output.index("quarantined after 2") < output.index("failed after 1 attempt:")
    assert "calcidem run CONFIG --retry quarantined" in output


def test_a_sample_that_was_sent_again_is_named(complete: Path, invoke: Callable[..., str]) -> None:
    """A done cell that needed half the step is shown with the reason, which is found by a query, too."""
    why = "the energy grew"
    with Store(complete) as store:
        store.use_campaign()
        cell = next(result for result in store.results() if result.key == CellKey(3, 5.0))
    with closing(sqlite3.connect(complete)) as connection, connection:
        changed = "UPDATE result SET retry = ? WHERE cell_id = (SELECT id FROM cell WHERE seed = 3 AND content = 5.0)"
        connection.execute(changed, [why])
    history = f"done after 1 attempt, computed again with half the time step ({why})"
    assert f"seed 3, 5 %: {history}" in invoke("status", complete)
    troubles = json.loads(invoke("status", complete, "--format", "json"))["troubles"]
    (trouble,) = (one for one in troubles if (one["seed"], one["content"]) == (3, 5.0))
    assert trouble["retry"] == why
    with open_campaign(complete) as campaign:
        assert [(found.key, found.retry) for found in campaign.select(where=f"retry == {why!r}")] == [(cell.key, why)]


def test_json_agrees_with_the_database(troubled: Path, invoke: Callable[..., str]) -> None:
    """Mean, scatter, 95 % interval and time left in JSON are those computed from the cells by hand."""
    told = json.loads(invoke("status", troubled, "--format", "json"))
    with open_campaign(troubled) as campaign:
        cells = list(campaign.select(content=5.0, status="done"))
        computed = [cell.seconds for cell in campaign.select(content=5.0) if cell.seconds is not None]
    vs = np.array([cell.vs for cell in cells], dtype=float)
    (of_content,) = (row for row in told["contents"] if row["content"] == 5.0)
    low, high = stats.t.interval(0.95, vs.size - 1, vs.mean(), stats.sem(vs))
    assert of_content["mean"] == pytest.approx(vs.mean())
    assert of_content["sd"] == pytest.approx(vs.std(ddof=1))
    assert of_content["interval_95"] == pytest.approx([low, high])
    assert of_content["status"] == ["done"] * 8 + ["pending", "no_arrival"]
    assert of_content["core_seconds_left"] == pytest.approx(np.mean(computed))
    assert told["seconds_left"] == pytest.approx(sum(row["core_seconds_left"] for row in told["contents"]))
    assert told["cells"]["pending"] == 6


def test_a_content_not_yet_measured_is_forecast_from_its_neighbours(complete: Path) -> None:
    """The time left counts a new content with a cost between those on either side."""
    with Store(complete) as store:
        store.use_campaign()
        store.extend((1,), (7.0,))
    found = CampaignStatus.read(str(complete))
    costs = {content.content: content.seconds_per_cell for content in found.contents}
    assert np.isnan(costs[7.0])
    assert found.seconds_left == pytest.approx((costs[5.0] + costs[9.0]) / 2)


def test_a_campaign_without_outcomes_can_be_shown(part: Callable[..., Path]) -> None:
    """With nothing measured there are dashes, no invented numbers, and no error."""
    empty = part("empty.db", set())
    with Store(empty) as store:
        store.use_campaign()
        store.extend((1, 2), (0.0, 5.0))
    console = Console(width=100, record=True)
    console.print(status_view(CampaignStatus.read(str(empty)), console.width))
    shown = console.export_text()
    assert "0 of 4 cells finished (0 %)" in shown
    assert "Time left" not in shown


def test_a_matrix_wider_than_the_terminal_is_condensed(complete: Path) -> None:
    """With 400 seeds a character stands for several, partly done ones are marked, and no line is too wide."""
    with Store(complete) as store:
        contents = store.use_campaign().contents
        store.extend(range(1, 401), contents)
    console = Console(width=100, record=True)
    console.print(status_view(CampaignStatus.read(str(complete)), console.width))
    lines = console.export_text().splitlines()
    assert max(map(len, lines)) <= 100
    assert sum(re.search(r"[+n]\.{20}", line) is not None for line in lines) == 5
    assert any("one character for 19 seeds" in line for line in lines)


def test_watching_ends_when_all_is_settled(complete: Path, invoke: Callable[..., str]) -> None:
    """A complete campaign is shown once; as JSON it is one line."""
    assert len(invoke("status", complete, "--watch", "--format", "json").splitlines()) == 1


def test_a_living_master_is_seen(complete: Path) -> None:
    """The campaign runs while a process holds its lease, and no longer."""
    with Store(complete) as store:
        store.use_campaign()
        store.acquire_lease()
        assert CampaignStatus.read(complete).running
    assert not CampaignStatus.read(complete).running


def test_no_reader_takes_the_log_of_a_writer_away(complete: Path) -> None:
    """A run reads its own progress; another process that reads and ends meanwhile must not remove the log.

    The kernel drops all locks of a process on a file when the process closes it once, whatever opened it.
    """
    log = complete.with_name(f"{complete.name}-wal")
    program = f"from calcidem.storage.sql.store import read_campaign; read_campaign({str(complete)!r}).close()"
    with Store(complete) as writer:
        writer.use_campaign()
        writer.extend((9,), (5.0,))
        read_campaign(complete).close()
        variables = os.environ | {"PYTHONPATH": str(CHECKOUT)}
        subprocess.run([sys.executable, "-c", program], check=True, env=variables)
        assert log.exists()
