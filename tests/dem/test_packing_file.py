"""Packings from and to CSV files."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calcidem.dem.engine.material import Sand
from calcidem.dem.sample.packing import LID, Packing, PackingRule, make_packing
from calcidem.dem.sample.packing_file import PackingFileError, packing_from_csv, read_disks, write_packing_csv

RULE = PackingRule(width=0.02, height=0.03)
SAND = Sand()


@pytest.fixture(scope="module")
def packing() -> Packing:
    """A packing of about a hundred disks."""
    return make_packing(RULE, SAND, np.random.default_rng(20))


def test_a_packing_that_went_through_a_file_comes_to_rest_where_it_was(packing: Packing, tmp_path: Path) -> None:
    """The disks of a file are pressed to the same stress and stay where they were, but for a little sliding."""
    file = tmp_path / "packing.csv"
    write_packing_csv(packing, file)
    again = packing_from_csv(file, SAND, RULE)
    assert again.report.unbalanced_ratio < RULE.unbalanced_force_ratio
    assert again.report.wall_stress[LID] == pytest.approx(RULE.stress, rel=1e-3)
    np.testing.assert_array_equal(again.radius, packing.radius)
    # Friction is lost in the file, so contacts slide a little; rattlers may go anywhere in their cages.
    moved = np.hypot(again.x - packing.x, again.y - packing.y)
    assert np.median(moved) < 0.05 * packing.radius.mean()
    assert again.height == pytest.approx(packing.height, rel=0.01)


def test_files_keep_every_bit_and_may_have_more(packing: Packing, tmp_path: Path) -> None:
    """What is written is read to the last bit; comments, further columns and another order are fine."""
    file = tmp_path / "packing.csv"
    write_packing_csv(packing, file)
    lines = file.read_text().splitlines()
    mixed = ["# my packing", "radius, name, y, x"]
    mixed += [f"{radius},disk,{y},{x}" for x, y, radius in (line.split(",") for line in lines[1:])]
    file.write_text("\n".join([*mixed, "", ""]))
    x, y, radius, numbers = read_disks(file)
    for read, given in ((x, packing.x), (y, packing.y), (radius, packing.radius)):
        np.testing.assert_array_equal(read, given)
    assert numbers[0] == 3


def changed(line: int, text: str) -> Callable[[list[str]], list[str]]:
    """Return a change of one line (counted from 1)."""
    return lambda lines: [*lines[: line - 1], text, *lines[line:]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (changed(1, "x,y,diameter"), "no column radius"),
        (changed(5, "0.01,zero,0.001"), "line 5: '0.01,zero,0.001' is no disk"),
        (changed(5, "0.01"), "line 5: '0.01' is no disk"),
        (changed(5, "0.01,nan,0.001"), "line 5: .* finite numbers"),
        (changed(5, "0.01,0.01,-0.001"), "line 5: .* positive radius"),
        (changed(5, "-0.01,0.01,0.001"), "line 5: .* beyond the left wall"),
        (changed(5, "0.0199,0.01,0.001"), "line 5: .* beyond the right wall"),
        (changed(5, "0.01,0.0002,0.001"), "line 5: .* beyond the floor"),
        (lambda lines: [*lines, lines[7]], "lines 8 and .* overlap"),
        (lambda lines: lines[:4], "has 3 disks"),
        (lambda _: [], "no column x, y, radius"),
    ],
)
def test_files_that_are_no_packings_are_refused(
    packing: Packing, tmp_path: Path, change: Callable[[list[str]], list[str]], message: str
) -> None:
    """Each mistake in a file is told with its line and its cure."""
    file = tmp_path / "packing.csv"
    write_packing_csv(packing, file)
    file.write_text("\n".join(change(file.read_text().splitlines())))
    with pytest.raises(PackingFileError, match=message):
        packing_from_csv(file, SAND, RULE)


def test_unreadable_files_are_refused(tmp_path: Path) -> None:
    """A missing file and one that is no text are refused by name."""
    with pytest.raises(PackingFileError, match=r"none\.csv"):
        packing_from_csv(tmp_path / "none.csv", SAND, RULE)
    (tmp_path / "picture.csv").write_bytes(b"\xff\xfe\x00\x89PNG")
    with pytest.raises(PackingFileError, match="as text"):
        packing_from_csv(tmp_path / "picture.csv", SAND, RULE)
