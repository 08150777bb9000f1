"""Packings from and to CSV files."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calcidem.dem.engine.leapfrog import State
from calcidem.dem.engine.scene import Sand
from calcidem.dem.engine.state import UnstableRunError
from calcidem.dem.sample import compaction
from calcidem.dem.sample.compaction import FARTHEST, _read_disks, make_packing, packing_from_csv, write_disks_csv
from calcidem.dem.sample.packing import LID, Packing, PackingError, PackingFileError, PackingRule
from calcidem.input_file import InputFileError

RULE = PackingRule(width=0.02, height=0.03)
SAND = Sand()


@pytest.fixture(scope="module")
def packing() -> Packing:
    """A packing of about a hundred disks."""
    return make_packing(RULE, SAND, np.random.default_rng(20))


def test_a_packing_that_went_through_a_file_comes_to_rest_where_it_was(packing: Packing, tmp_path: Path) -> None:
    """The disks of a file are pressed to the same stress and stay where they were, but for a little sliding."""
    file = tmp_path / "packing.csv"
    write_disks_csv(packing.x, packing.y, packing.radius, file)
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
    write_disks_csv(packing.x, packing.y, packing.radius, file)
    lines = file.read_text().splitlines()
    mixed = ["# my packing", "radius, name, y, x"]
    mixed += [f"{radius},disk,{y},{x}" for x, y, radius in (line.split(",") for line in lines[1:])]
    file.write_text("\n".join([*mixed, "", ""]))
    x, y, radius, numbers, _ = _read_disks(file)
    for read, given in ((x, packing.x), (y, packing.y), (radius, packing.radius)):
        np.testing.assert_array_equal(read, given)
    assert numbers[0] == 3


def test_ten_disks_are_a_packing(tmp_path: Path) -> None:
    """Nine are refused."""
    file = tmp_path / "packing.csv"
    lines = ["x,y,radius", *(f"{3e-3 * number},1e-3,1e-3" for number in range(10))]
    file.write_text("\n".join(lines))
    assert len(_read_disks(file)[0]) == 10
    file.write_text("\n".join(lines[:-1]))
    with pytest.raises(PackingFileError, match="has 9 disks; give at least 10"):
        _read_disks(file)


def just_touching(folder: Path) -> tuple[Path, PackingRule]:
    """Disks of a hexagonal lattice that overlap by rounding alone, and a box as wide as they are."""
    radius, columns, rows = 1.25e-3, 5, 6
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    x = radius * (2.0 * column + row % 2 + 1.0)
    y = radius * (1.0 + np.sqrt(3.0) * row)
    file = folder / "lattice.csv"
    table = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, radius)])
    np.savetxt(file, table, delimiter=",", header="x,y,radius", comments="", fmt="%.17g")
    return file, replace(RULE, width=radius * (2.0 * columns + 1.0), most_steps=10_000)


def test_loose_disks_are_compressed_and_a_single_one_far_above_is_named(tmp_path: Path) -> None:
    """The lid may come down as far as the disks are loose; it would travel long to bring down a single one."""
    file, rule = just_touching(tmp_path)
    x, y, radius, lines, _ = _read_disks(file)
    loose = np.column_stack([1.15 * x, 1.3 * y, radius])
    np.savetxt(file, loose, delimiter=",", header="x,y,radius", comments="", fmt="%.17g")
    rule = replace(rule, width=1.15 * rule.width, most_steps=200_000)
    packed = packing_from_csv(file, SAND, rule)
    assert packed.height < 0.8 * (loose[:, 1] + radius).max()
    with file.open("a", encoding="utf-8") as stream:
        stream.write("5e-3,0.08,1e-3\n")
    with pytest.raises(PackingFileError, match=rf"line {lines[-1] + 1}: with the lid on this disk"):
        packing_from_csv(file, SAND, rule)


def test_disks_that_just_touch_come_to_rest_soon(tmp_path: Path) -> None:
    """Without an overlap to choose a step by they bear the lid after some thousand steps, moved by some overlaps."""
    file, rule = just_touching(tmp_path)
    x, y, *_ = _read_disks(file)
    packed = packing_from_csv(file, SAND, rule)
    assert packed.report.unbalanced_ratio < rule.unbalanced_force_ratio
    for wall in (LID - 1, LID):
        assert packed.report.wall_stress[wall] == pytest.approx(rule.stress, rel=1e-3)
    assert packed.report.steps < 5_000
    assert np.hypot(packed.x - x, packed.y - y).max() < 30.0 * packed.report.largest_overlap


def test_a_packing_that_blows_up_or_comes_no_nearer_to_rest_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More steps are advised only while the disks still settle; what ends a run is told with a cure for packings."""
    file, rule = just_touching(tmp_path)
    with pytest.raises(PackingError, match=r"10400 steps .* more steps will not help"):
        packing_from_csv(file, SAND, replace(rule, unbalanced_force_ratio=1e-18))
    # The lid closes at its largest speed, so only time is lacking.
    with pytest.raises(PackingError, match=r"10400 steps .* stress = 1e\+09 Pa; raise most_steps"):
        packing_from_csv(file, SAND, replace(rule, stress=1e9))

    def blow_up(*_: object) -> State:
        raise UnstableRunError("after 400 steps disk 3 moves at 1e9 m/s: choose a smaller time_step")

    monkeypatch.setattr(compaction, "advance", blow_up)
    with pytest.raises(
        PackingError, match="rest, after 400 steps disk 3 moves at 1e9 m/s: lower stress, raise damping"
    ):
        packing_from_csv(file, SAND, rule)


def changed(line: int, text: str) -> Callable[[list[str]], list[str]]:
    """Return a change of one line (counted from 1)."""
    return lambda lines: [*lines[: line - 1], text, *lines[line:]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (changed(1, "x,y,diameter"), "no column radius"),
        (changed(5, "0.01,zero,0.001"), "line 5: '0.01,zero,0.001' is not a disk"),
        (changed(5, "0.01"), "line 5: '0.01' is not a disk"),
        (changed(5, "0.01,nan,0.001"), "line 5: '0.01,nan,0.001' is not a disk"),
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
    write_disks_csv(packing.x, packing.y, packing.radius, file)
    file.write_text("\n".join(change(file.read_text().splitlines())))
    with pytest.raises(PackingFileError, match=message):
        packing_from_csv(file, SAND, RULE)


@pytest.mark.parametrize("factor", [1.0, 1.0 + 1e-15])
def test_numbers_up_to_a_limit_are_read(factor: float, tmp_path: Path) -> None:
    """The limit itself is accepted, as x, as y, and as radius or its inverse."""
    far, small, file = FARTHEST * factor, 1.0 / FARTHEST / factor, tmp_path / "disks.csv"
    for x, y, radius in ((far, 0.0, 1.0), (0.0, -far, 1.0), (0.0, 0.0, far), (0.0, 0.0, small)):
        file.write_text("\n".join(["x,y,radius", f"{x},{y},{radius}", *["0,0,1"] * 9]))
        if factor == 1.0:
            *places, lines, _ = _read_disks(file)
            assert (lines[0], *(values[0] for values in places)) == (2, x, y, radius)
        else:
            with pytest.raises(PackingFileError, match=r"line 2: .* up to 1e\+30"):
                _read_disks(file)


def test_unreadable_files_are_refused(tmp_path: Path) -> None:
    """A missing file and one that is no text are refused by name."""
    with pytest.raises(InputFileError, match=r"none\.csv can't be read"):
        packing_from_csv(tmp_path / "none.csv", SAND, RULE)
    (tmp_path / "picture.csv").write_bytes(b"\xff\xfe\x00\x89PNG")
    with pytest.raises(InputFileError, match=r"picture\.csv is not text"):
        packing_from_csv(tmp_path / "picture.csv", SAND, RULE)
