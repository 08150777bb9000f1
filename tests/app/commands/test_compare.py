"""`calcidem compare`: campaigns beside one another, as a table, a file and a figure."""

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from PIL import Image
from places import TUTORIAL

import calcidem
from calcidem.app.campaign.opened import open_campaign
from calcidem.app.cli.exit_codes import _exit_code_of
from calcidem.storage.errors import QueryError

Invoke = Callable[..., str]


def test_the_table_has_the_numbers_of_python(invoke: Invoke, small_database: Path, tmp_path: Path) -> None:
    """CSV and JSON hold what `calcidem.compare` gives; the table says what differs; the figure is a picture."""
    found = calcidem.compare([small_database, TUTORIAL])
    assert list(found.table["campaign"].values) == ["small", "quick"]
    rows = list(csv.DictReader(io.StringIO(invoke("compare", small_database, TUTORIAL, "--format", "csv"))))
    expected = found.to_dataframe()
    assert [float(row["mean"] or "nan") for row in rows] == pytest.approx(expected["mean"].tolist(), nan_ok=True)
    cells = json.loads(invoke("compare", small_database, TUTORIAL, "--format", "json"))
    assert [cell["pairs"] for cell in cells] == [None if row["pairs"] == "" else int(row["pairs"]) for row in rows]
    picture = tmp_path / "both.png"
    text = invoke("compare", small_database, TUTORIAL, "--out", picture)
    with Image.open(picture) as opened:
        assert opened.size[0] > 500
    assert any(line.startswith("packing.width: ") for line in found.differing["quick"])
    assert "quick differs from the first in: " in text


def test_a_campaign_does_not_differ_from_itself() -> None:
    """Named by its file and number, each content has as many pairs as velocities and a difference of zero."""
    with open_campaign(TUTORIAL) as campaign:
        found = calcidem.compare([campaign, TUTORIAL])
    assert list(found.table["campaign"].values) == ["quick (quick.db) [1]", "quick (quick.db) [2]"]
    other = found.table.isel(campaign=1)
    assert (other["pairs"] == other["n"]).all()
    assert not other["paired_difference_interval"].any()
    assert (other["difference_interval"].isel(bound=0, content=slice(1, None)) < 0).all()
    assert not any(found.differing.values())
    assert "<table" in found._repr_html_()


def test_a_comparison_is_drawn_in_the_place_of_axes() -> None:
    """Its two panels take the place of one of two axes, and the figure is the caller's."""
    figure, (left, right) = plt.subplots(1, 2, layout="constrained")
    assert calcidem.compare([TUTORIAL, TUTORIAL]).draw(ax=right) is figure
    assert left in figure.axes
    assert right not in figure.axes
    assert [axes.get_ylabel() for axes in figure.axes[1:]] == ["shear-wave velocity $V_s$ (m/s)", "difference (m/s)"]
    plt.close(figure)
    with pytest.raises(ValueError, match="ax was removed"):
        calcidem.compare([TUTORIAL, TUTORIAL]).draw(ax=right)


def test_what_cannot_be_compared_is_refused(invoke: Invoke, tmp_path: Path) -> None:
    """One campaign alone, names for two databases, and a figure of an unknown kind are bad input."""
    with pytest.raises(QueryError, match=r"1 campaigns are given\..*two or more") as caught:
        invoke("compare", TUTORIAL)
    assert _exit_code_of(caught.value) == 2
    assert "one database" in invoke("compare", TUTORIAL, TUTORIAL, "--campaign", "quick", exit_code=2)
    assert ".svg" in invoke("compare", TUTORIAL, TUTORIAL, "--out", tmp_path / "x.gif", exit_code=2)
    assert not list(tmp_path.glob("x*"))
