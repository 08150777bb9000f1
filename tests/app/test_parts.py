"""A campaign in parts: disjoint, of equal effort, one hash, and together the same bits as one run."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from calcidem.app.campaign.cells import planned_batches, planned_cells
from calcidem.app.campaign.merge import merge_databases
from calcidem.app.config.reader import load_configuration
from calcidem.app.config.schema import Configuration, ConfigurationError, RunOptions

if TYPE_CHECKING:
    from conftest import Cells, Workshop


def part_of(configuration: Configuration, part: str) -> Configuration:
    """The same configuration with one part of its cells."""
    return replace(configuration, run=replace(configuration.run, part=part))


@pytest.mark.parametrize("parts", [1, 3, 8])
def test_parts_are_disjoint_complete_and_balanced(parts: int) -> None:
    """Each cell is in one part; the efforts of two parts differ by one batch at most; the hash is the campaign's."""
    whole = Configuration()
    shares = [part_of(whole, f"{number}/{parts}") for number in range(1, parts + 1)]
    batches = [planned_batches(share) for share in shares]
    cells = [cell for share in batches for batch in share for cell in batch.cells]
    assert len(cells) == len(set(cells))
    assert set(cells) == {cell for batch in planned_batches(whole) for cell in batch.cells}
    own = [
        planned_cells(share) for share in shares
    ]  # with all seeds of the sample without cement, which is in one part
    assert (
        sum(map(len, own))
        == len(planned_cells(whole))
        == len(whole.campaign.seed_numbers) * len(whole.campaign.contents)
    )
    efforts = [sum(batch.cost for batch in share) for share in batches]
    longest = max(batch.cost for share in batches for batch in share)
    assert max(efforts) - min(efforts) <= longest * (1.0 + 1e-9)
    assert {share.hash for share in shares} == {whole.hash}
    assert len({share.database for share in shares}) == parts


@pytest.mark.parametrize("part", ["0/8", "9/8", "3", "/", "3/8/1", "a/b", "", "-1/2", "1/0"])
def test_a_part_that_is_none_is_refused(tmp_path: Path, part: str) -> None:
    """The error names the key, the value and what to give."""
    (tmp_path / "c.toml").write_text('[campaign]\nname = "a"\n')
    with pytest.raises(ConfigurationError, match=r"(?s)part.*\"3/8\"") as caught:
        load_configuration(tmp_path / "c.toml", {"part": part})
    assert caught.value.problems[0].fields == ("run.part",)
    with pytest.raises(ValueError, match="part"):
        RunOptions(part=part)


@pytest.mark.full
def test_eight_parts_merged_equal_one_run(workshop: "Workshop", expected: "Cells") -> None:
    """The five batches in eight parts, three of them empty; the merged file has every bit; a part left out is named."""
    workshop.configure()
    for number in range(1, 9):
        done = workshop.run("run", "c.toml", "--part", f"{number}/8", "--db", f"part-{number}.db")
        assert done.code == 0, done.errors
    parts = [f"part-{number}.db" for number in range(1, 9)]
    done = workshop.run("merge", *parts, "--out", str(workshop.database))
    assert done.code == 0, done.errors
    assert "12 of 12 planned cells are finished" in done.output
    assert workshop.cells() == expected

    configuration = load_configuration(workshop.folder / "c.toml", {"part": "1/8"})
    (batch,) = planned_batches(configuration)
    out = workshop.folder / "most.db"
    merged = merge_databases([str(workshop.folder / part) for part in parts[1:]], out)
    assert {(key.seed, key.content) for key in merged.missing} == set(batch.cells)
    (line,) = merged.missing_lines()
    assert line == f"  {batch.cells[0][1]:g} %: 2 cells, seeds {batch.cells[0][0]}-{batch.cells[1][0]}"
    done = workshop.run("run", "c.toml", "--db", str(out))
    assert done.code == 0, done.errors
    assert "2 cells in 1 batch" in done.output + done.errors
