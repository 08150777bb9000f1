"""A campaign as an RO-Crate: whoever has it alone reads the campaign, and computes its cells again."""

import json
import shutil
import zipfile
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import pytest
import xarray as xr

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.cli.exit_codes import _exit_code_of
from calcidem.app.config.reader import load_configuration
from calcidem.app.report import crate as crates
from calcidem.app.report.crate import write_crate
from calcidem.storage.errors import DamagedStoreError, OutputRefusedError, StoreError

Invoke = Callable[..., str]


@pytest.fixture(scope="module")
def crate(small_database: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a crate of the small campaign; what its report looks like is not the matter here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(crates, "write_report", lambda _, out, **__: out.write_text("<p>the report"))
        return write_crate(small_database, tmp_path_factory.mktemp("crates") / "small", authors=("Ada", "Émilie"))


def test_a_crate_describes_its_files(crate: Path, small_database: Path) -> None:
    """Each file has its checksum; licence, authors, versions and runs are said, and xarray reads the numbers."""
    described = json.loads((crate / "ro-crate-metadata.json").read_text(encoding="utf-8"))
    entities = {entity["@id"]: entity for entity in described["@graph"]}
    root = entities["./"]
    assert {part["@id"] for part in root["hasPart"]} == {file.name for file in crate.iterdir()} - {
        "ro-crate-metadata.json"
    }
    for part in root["hasPart"]:
        assert entities[part["@id"]]["sha256"] == sha256((crate / part["@id"]).read_bytes()).hexdigest()
    assert entities[root["license"]["@id"]]["name"] == "CC-BY-4.0"
    assert [entities[author["@id"]]["name"] for author in root["author"]] == ["Ada", "Émilie"]
    with open_campaign(small_database) as campaign:
        record, runs = campaign.record, campaign.store.runs()
        vs = campaign.vs().to_numpy()
    assert entities[root["identifier"]["@id"]]["value"] == record.hash
    actions = [entity for entity in entities.values() if entity["@type"] == "CreateAction"]
    versions = [entities[action["instrument"]["@id"]]["version"] for action in actions]
    assert versions == [run.versions["calcidem"] for _, run in runs]
    assert load_configuration(crate / "campaign.toml").hash == record.hash
    with xr.open_dataset(crate / "campaign.nc") as numbers:
        assert numbers["vs"].to_numpy().tobytes() == vs.tobytes()


def changed(crate: Path, folder: Path, name: str, change: Callable[[bytes], bytes], *, describe: bool) -> Path:
    """Copy a crate with another content of a file, whose checksum is renewed if wanted."""
    copy = folder / "changed"
    shutil.copytree(crate, copy)
    content = change((copy / name).read_bytes())
    (copy / name).write_bytes(content)
    if describe:
        metadata = copy / "ro-crate-metadata.json"
        described = json.loads(metadata.read_text(encoding="utf-8"))
        for entity in described["@graph"]:
            if entity["@id"] == name:
                entity["sha256"] = sha256(content).hexdigest()
        metadata.write_text(json.dumps(described), encoding="utf-8")
    return copy


@pytest.mark.parametrize(
    ("name", "change", "describe", "said"),
    [
        ("campaign.nc", lambda old: old[:-1], False, "campaign.nc is not the file that"),
        ("campaign.nc", lambda old: old[:5000], True, "can't be read as NetCDF"),
        ("campaign.toml", lambda old: old.replace(b"damping = 0.7", b"damping = 0.6"), True, "not the configuration"),
        ("campaign.toml", lambda _: b"[sand]\ncolour = 1\n", True, "cannot be used: .*colour"),
        ("packing.csv", lambda old: old.replace(b"1", b"2", 1), True, "not the packing"),
        ("ro-crate-metadata.json", lambda _: b"[]", False, "not a description of a crate"),
        ("ro-crate-metadata.json", lambda _: b'{"@graph": []}', False, "does not describe campaign.nc"),
    ],
)
def test_what_was_changed_in_a_crate_is_found(
    crate: Path, tmp_path: Path, invoke: Invoke, name: str, change: Callable[[bytes], bytes], describe: bool, said: str
) -> None:
    """A file that is not the described one, and one that contradicts another, are named; exit code 2."""
    copy = changed(crate, tmp_path, name, change, describe=describe)
    with pytest.raises(StoreError, match=f"(?s){said}") as caught:
        invoke("verify", copy)
    assert _exit_code_of(caught.value) == 2


def test_crates_have_names_that_are_free(crate: Path, small_database: Path, invoke: Invoke, tmp_path: Path) -> None:
    """A folder that is there, a database, and options that contradict one another are refused."""
    with pytest.raises(OutputRefusedError, match="is there already"):
        write_crate(small_database, crate)
    assert "a crate is complete" in invoke(
        "export", small_database, "a.zip", "--crate", "--without", "path", exit_code=2
    )
    assert "give --crate, too" in invoke("export", small_database, "a.nc", "--author", "Ada", exit_code=2)
    (tmp_path / "empty").mkdir()
    with pytest.raises(DamagedStoreError, match=r"ro-crate-metadata\.json cannot be read"):
        invoke("verify", tmp_path / "empty")


@pytest.mark.slow
def test_cells_are_computed_again_from_a_crate_alone(crate: Path, tmp_path: Path, invoke: Invoke) -> None:
    """A zip file that was moved is enough."""
    file = Path(shutil.make_archive(str(tmp_path / "moved"), "zip", crate))
    assert zipfile.is_zipfile(file)
    printed = invoke("verify", file, "--cells", "1", "--choice", "2")
    assert "1 cell: 1 same bits, 0 same to rounding, 0 different." in printed
    assert "36 cells: 0 damaged, 0 other damages." in invoke("verify", file, "--integrity")
    assert "leave it out" in invoke("verify", file, "--campaign", "small", exit_code=2)
