"""The file of measured velocities on its way into a report."""

from collections.abc import Callable
from pathlib import Path

import pytest

from calcidem.analysis.measured import Target
from calcidem.app.config.errors import ConfigurationError
from calcidem.app.report import page


def test_the_report_is_given_what_the_file_holds(
    small_database: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, invoke: Callable[..., str]
) -> None:
    """A file as calibrate takes reaches the report; one with mistakes is refused before anything is drawn."""
    given: list[tuple[Target, ...]] = []

    def remember(_database: object, out: Path, *, measured: tuple[Target, ...], **_: object) -> Path:
        given.append(measured)
        return out

    monkeypatch.setattr(page, "write_report", remember)
    file = tmp_path / "measured.csv"
    file.write_text("content,vs,sd\n0.66,375,20\n", encoding="utf-8")
    invoke("report", small_database, "--measured", file)
    assert given == [(Target(0.66, 375.0, 20.0),)]
    file.write_text("content,speed\n0.66,375\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match="column vs: is missing"):
        invoke("report", small_database, "--measured", file)
    assert len(given) == 1
