"""What calcidem says reaches the logs, the warnings and the campaign of a program, and a terminal once."""

import io
import logging
import warnings
from dataclasses import replace
from pathlib import Path

import pytest
from places import SMALL_PACKING
from rich.console import Console

import calcidem
from calcidem.app.campaign.packing import packing_from_bytes
from calcidem.app.campaign.status import ProgressDisplay
from calcidem.app.config.schema import CampaignPlan, Configuration, Excitation
from calcidem.wording import advise, listening, tell


def test_one_terminal_hears_each_sentence_once() -> None:
    """An inner display receives what an outer one would; advice of Python's displays is left to its warnings."""
    outer: list[str] = []
    stream = io.StringIO()
    with listening(outer.append):
        tell("before")
        with ProgressDisplay(Console(file=stream, width=60), with_advice=False), warnings.catch_warnings(record=True):
            warnings.simplefilter("always")
            tell("within")
            advise("advice")
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            advise("after")
        with warnings.catch_warnings(record=True):
            advise("after")  # as each trial of a fit may
    assert outer == ["before", "Warning: after"]
    assert [str(one.message) for one in warned] == ["after"]
    assert "within" in stream.getvalue()
    assert "advice" not in stream.getvalue()
    tell("nobody listens")
    assert outer[-1] == "Warning: after"


def test_a_script_is_told_that_the_grains_scatter_its_wave(
    small_configuration: Configuration,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A frequency that is too high is in the log and in the warnings, and that of stored velocities in the notes."""
    monkeypatch.setenv("CALCIDEM_CACHE", str(tmp_path / "cache"))
    shipped = SMALL_PACKING.read_bytes()
    monkeypatch.setattr(
        "calcidem.app.campaign.run.provide_packing",
        lambda configuration, *_: packing_from_bytes(shipped, configuration.packing_hash),
    )
    configuration = replace(
        small_configuration,
        campaign=CampaignPlan(name="fast", seeds=1, contents=(0.0,)),
        excitation=Excitation(frequency=28e3),
    )
    caplog.set_level(logging.INFO, "calcidem")
    with (
        pytest.warns(calcidem.CampaignWarning, match="grains in a wavelength, which samples scatter"),
        calcidem.run(configuration, db=tmp_path / "fast.db", output=tmp_path, progress=False) as campaign,
    ):
        notes = campaign.notes
    assert any("grains in a wavelength" in record.message for record in caplog.records)
    assert any(record.levelno == logging.INFO and "1 cell in 1 batch" in record.message for record in caplog.records)
    assert any("a wavelength has fewer than 6 grains" in note or "without velocity" in note for note in notes)
