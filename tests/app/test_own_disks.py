"""Campaigns on the user's own disks: `[packing] file = "disks.csv"`."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import provide_packing
from calcidem.app.campaign.run import run
from calcidem.app.config.reader import load_configuration
from calcidem.app.config.schema import ConfigurationError
from calcidem.app.studies.verify import random_cells, verify
from calcidem.dem.sample.compaction import _read_disks
from calcidem.dem.sample.packing import PackingError
from calcidem.storage.errors import CampaignMismatchError

if TYPE_CHECKING:
    from conftest import Workshop

pytestmark = pytest.mark.slow

OWN = """
[campaign]
name = "small"
seeds = 2
contents = [0.66]
[packing]
file = "disks.csv"
width = 0.021
unbalanced_force_ratio = 1e-3
{packing}
[wave]
transmitter_half_width = 0.004
receiver_half_width = 0.005
listening_depth = 0.006
boundary_thickness = 0.004
[run]
lanes = 8
"""


@pytest.fixture
def own(workshop: "Workshop") -> Path:
    """Give a folder with a configuration and its disks: a hexagonal lattice of 9 x 12, a little loose."""
    folder = workshop.folder / "own"
    folder.mkdir()
    column, row = np.meshgrid(np.arange(9), np.arange(12))
    x, y = 0.0022 * (column + 0.5 * (row % 2)) + 0.0011, 0.0022 * 0.87 * row + 0.0011
    radius = 0.00105 + 0.00004 * ((3 * column + 5 * row) % 7) / 6.0
    table = np.column_stack([x.ravel(), y.ravel(), radius.ravel()])
    np.savetxt(folder / "disks.csv", table, delimiter=",", header="x,y,radius", comments="")
    (folder / "c.toml").write_text(OWN.format(packing=""))
    return folder


def test_own_disks_make_a_campaign(workshop: "Workshop", own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command computes on the disks of the file beside the configuration, confirms itself and goes on."""
    results = workshop.folder / "results"
    done = workshop.run("run", "own/c.toml", "--output", "results")
    assert done.code == 0, done.errors
    radius = _read_disks(own / "disks.csv")[2]
    with open_campaign(workshop.database) as campaign:
        assert sorted(campaign.packing().radius) == sorted(radius)
        assert "file_sha256" in campaign.record.config
        assert str(own) not in campaign.record.config
        found = list(verify(campaign.store, random_cells(campaign.store, 2), campaign.experiment, lanes=8))
    assert [verification.differences for verification in found] == [{}, {}]

    # Elsewhere, under another name: it is the content that counts. What is stored is not computed again.
    (own / "disks.csv").rename(own / "same.csv")
    text = (own / "c.toml").read_text().replace("disks.csv", str(own / "same.csv")).replace("seeds = 2", "seeds = 3")
    (workshop.folder / "moved.toml").write_text(text)
    monkeypatch.setenv("CALCIDEM_CACHE", str(own / "empty"))
    run(workshop.folder / "moved.toml", output=results).close()
    assert workshop.attempts() == 3
    assert not list((own / "empty").glob("packing*"))  # it came from the database

    # Other disks are another campaign.
    lines = (own / "same.csv").read_text().splitlines(keepends=True)
    (own / "same.csv").write_text("".join(lines[:-1]))
    with pytest.raises(CampaignMismatchError, match=r"packing\.file_sha256: "):
        run(workshop.folder / "moved.toml", output=results)


def test_the_name_of_the_file_is_no_physics(own: Path) -> None:
    """Hashes depend on the content of the file, and not on its name, the root of random numbers or its folder."""
    first = load_configuration(own / "c.toml")
    assert first.packing.height == pytest.approx(0.0022 * 0.87 * 11 + 0.0011 + 0.00109, abs=5e-5)
    (own / "disks.csv").rename(own / "b.csv")
    text = (own / "c.toml").read_text().replace("disks.csv", "b.csv")
    (own / "c.toml").write_text(text)
    assert load_configuration(own / "c.toml").hash == first.hash
    (own / "c.toml").write_text(text.replace("seeds = 2", "seeds = 2\nroot_seed = 5"))
    other_root = load_configuration(own / "c.toml")
    assert other_root.packing_hash == first.packing_hash
    assert other_root.hash != first.hash
    with (own / "b.csv").open("a") as file:
        file.write("0.0011,0.03,0.001\n")
    assert load_configuration(own / "c.toml").packing_hash != other_root.packing_hash


@pytest.mark.parametrize(
    ("packing", "disks", "named"),
    [
        ("porosity = 0.2", None, ("packing.porosity = 0.2", "the disks in packing.file settle it")),
        ("seed = 3\nheight = 0.1", None, ("packing.seed = 3", "packing.height = 0.1")),
        ('file_sha256 = "0"', None, ("packing.file_sha256: unknown key", "packing.file says it")),
        ("", "", ("packing.file", "disks.csv", "can't be read")),
        ("", "x,y\n1,2\n", ("has no column radius",)),
        ("", "x (kPa),y,radius\n1,2,3\n", ("column 'x (kPa)': its unit 'kPa'", "give one of m, cm, mm")),
        ("", 'x,y ("),radius\n1,2,3\n', ("its unit '\"' is not one of this quantity",)),
        ("", "x,y,radius\n" + "0.01,0.01,0.001\n" * 20, ("lines 2 and", "overlap")),
        ("", "x,y,radius\n" + "".join(f"0.01,{0.004 * k},0.001\n" for k in range(20)), ("line 2", "floor")),
    ],
)
def test_what_is_wrong_is_said(own: Path, packing: str, disks: str | None, named: tuple[str, ...]) -> None:
    """Keys that contradict the file and files that are no packing are refused with everything named at once."""
    (own / "c.toml").write_text(OWN.format(packing=packing))
    if disks is not None:
        (own / "disks.csv").write_text(disks)
    if disks == "":
        (own / "disks.csv").unlink()
    with pytest.raises(ConfigurationError) as caught:
        load_configuration(own / "c.toml")
    assert all(words in str(caught.value) for words in named)
    assert len(caught.value.problems) == max(1, packing.count("="))


def test_a_file_that_changes_meanwhile_is_noticed(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Disks that are not those the campaign's identity was taken from are never packed under it."""
    monkeypatch.setenv("CALCIDEM_CACHE", str(own / "cache"))
    configuration = load_configuration(own / "c.toml")
    os.truncate(own / "disks.csv", 2000)
    with pytest.raises(PackingError, match="changed while"):
        provide_packing(configuration, None)
