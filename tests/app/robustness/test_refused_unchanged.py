"""What is refused leaves every file as it was, and what is said of it is true."""

import csv
import io
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import netCDF4
import numpy as np
import pytest
from unchanged import unchanged_if_refused

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import packing_record
from calcidem.app.campaign.preview import preview_lines
from calcidem.app.campaign.run import CampaignRun
from calcidem.app.cli.exit_codes import _exit_code_of, tell_error
from calcidem.app.cli.output import Format, tell_rows
from calcidem.app.config.presets import preset_text
from calcidem.app.config.schema import Configuration, RunOptions
from calcidem.dem.engine.fields import FieldError, Problem
from calcidem.dem.sample.packing import Packing
from calcidem.storage.errors import QueryError, StoreError, UnknownCellError
from calcidem.storage.files import spreadsheet_value
from calcidem.storage.netcdf import export_netcdf
from calcidem.storage.sql.store import Store

Change = Callable[[Configuration], Configuration]


@pytest.fixture
def begun(tmp_path: Path, small_configuration: Configuration, small_packing: Packing) -> Configuration:
    """Give the configuration of a campaign whose database has its packing and its plan, and no cell yet."""
    path = tmp_path / "begun.db"
    plan = small_configuration.campaign
    with Store(path) as store:
        store.begin_campaign(small_configuration.record())
        store.extend(plan.seed_numbers, plan.contents)
        store.save_packing(packing_record(small_packing, index=0, packing_hash=small_configuration.packing_hash))
    return replace(small_configuration, run=RunOptions(database=str(path), output=str(tmp_path / "results")))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: replace(c, campaign=replace(c.campaign, name="d", contents=(3.0,))), "under the name 'small'"),
        (lambda c: replace(c, wave=replace(c.wave, damping=0.2)), r"wave.damping: 0.3 -> 0.2"),
        (lambda c: replace(c, campaign=replace(c.campaign, contents=(99.0,))), "99"),
    ],
    ids=["another name", "another physics", "more cement than there is room for"],
)
def test_a_run_that_is_refused_changes_no_file(begun: Configuration, change: Change, said: str, tmp_path: Path) -> None:
    """Neither the plan of the database nor a folder for results is made before everything fits, and --check agrees."""
    other = change(begun)
    for attempt in (
        lambda: CampaignRun(other),
        lambda: list(preview_lines(other)),
    ):
        with unchanged_if_refused(tmp_path) as codes:
            with pytest.raises(Exception, match=said) as refused:
                attempt()
            codes.append(_exit_code_of(refused.value))
        assert codes == [2]
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize("database", ["new.db", "complete.db"])
def test_an_import_of_impossible_values_writes_nothing(
    complete: Path, invoke: Callable[..., str], database: str, tmp_path: Path
) -> None:
    """An attempt that took a negative time is named; a new database does not appear, another stays as it is."""
    with open_campaign(complete) as campaign:
        damaged = export_netcdf(campaign.store, tmp_path / "damaged.nc")
    with netCDF4.Dataset(damaged, "r+") as file:
        file["attempts"]["seconds"][3] = -1.0
    with unchanged_if_refused(tmp_path) as codes:
        with pytest.raises(
            StoreError, match=r"damaged.nc is damaged .*seconds is -1.0.*nothing was written"
        ) as refused:
            invoke("import", damaged, "--db", tmp_path / database)
        codes.append(_exit_code_of(refused.value))
    assert codes == [2]


@pytest.mark.parametrize("command", ["report", "import"])
def test_what_is_no_file_of_a_database_is_told_as_such(
    command: str, complete: Path, invoke: Callable[..., str]
) -> None:
    """A device, and a file of the kernel that cannot be read from its beginning, are bad input and no accident."""
    with open_campaign(complete) as campaign:
        export_netcdf(campaign.store, complete.with_suffix(".nc"))
    words = {
        "report": ("report", "/proc/self/mem"),
        "import": ("import", complete.with_suffix(".nc"), "--db", "/dev/null"),
    }[command]
    with pytest.raises(StoreError, match="is not a database file") as refused:
        invoke(*words)
    assert _exit_code_of(refused.value) == 2


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("can't start new thread"),
        SystemError("<function run_command> returned NULL without setting an exception"),
    ],
)
def test_a_lack_of_memory_is_called_that(error: Exception, capsys: pytest.CaptureFixture[str]) -> None:
    """What Python raises at a limit of memory is no fault to be reported."""
    assert tell_error(error) == 1
    told = capsys.readouterr().err
    assert "memory" in told
    assert "report" not in told


def test_values_that_only_the_packing_refuses_are_bad_input(capsys: pytest.CaptureFixture[str]) -> None:
    """What the engine says of a field is told as such, and is no fault to be reported."""
    refused = FieldError(Problem("amplitude = 0.001: the packing alone moves more: choose a stronger pulse"))
    assert tell_error(refused) == 2
    assert capsys.readouterr().err.startswith("Error: amplitude = 0.001: the packing")


def test_an_error_that_no_memory_is_left_to_log_is_a_lack_of_memory(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where writing the log of any error ends in a MemoryError, that is what is told."""

    def fail(_error: BaseException) -> NoReturn:
        raise MemoryError

    monkeypatch.setattr("calcidem.app.cli.exit_codes._log_error", fail)
    assert tell_error(RuntimeError("anything")) == 1
    assert "memory" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["=cmd|' /C calc'!A0", "@SUM(1)", "+1+1", "-2+3", "\t=1", "\uff1d1"])
def test_a_spreadsheet_evaluates_no_stored_text(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    """In CSV a text that would be a formula begins with an apostrophe; numbers and other texts are as they were."""
    assert spreadsheet_value(text) == f"'{text}"
    tell_rows([{"reason": text, "vs": -1.5}, {"reason": "no top", "vs": np.nan}], Format.CSV)
    rows = io.StringIO(capsys.readouterr().out, newline="")
    assert list(csv.reader(rows))[1:] == [[f"'{text}", "-1.5"], ["no top", ""]]
    assert [spreadsheet_value(value) for value in ("-1.5", "no = sign", None, -2)] == ["-1.5", "no = sign", None, -2]


def test_a_question_that_has_no_answer_is_answered_so(complete: Path) -> None:
    """Contents, statuses and presets that are not there are named, with those that are."""
    with open_campaign(complete) as campaign:
        with pytest.raises(UnknownCellError, match=r"no content 5.5 %.*There are 0, "):
            campaign.select(content=5.5)
        with pytest.raises(UnknownCellError, match=r"no content 5.5 %"):
            campaign.to_dataframe(["vs"], content=(5.0, 5.5))
        with pytest.raises(QueryError, match=r"status = 'finished'.*pending.*done"):
            campaign.select(status="finished")
        with pytest.raises(TypeError, match="cannot be pickled"):
            pickle.dumps(campaign)
    with pytest.raises(ValueError, match="name = 'nope': there is no such preset; give one of quick, paper"):
        preset_text("nope")


def test_a_closed_campaign_answers_no_more(complete: Path) -> None:
    """Once closed, every question is refused with the cure; closing again does nothing."""
    campaign = open_campaign(complete)
    campaign.close()
    campaign.close()
    for ask in (campaign.vs, campaign.status_counts, campaign.runs, lambda: list(campaign.select())):
        with pytest.raises(StoreError, match="was closed"):
            ask()
