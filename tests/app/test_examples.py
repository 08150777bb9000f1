"""Examples on the public interface run, and do what they say."""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from hashlib import sha256
from pathlib import Path

import pytest
from places import CHECKOUT, TUTORIAL

import calcidem


def run_example(name: str, *words: object, code: int = 0) -> str:
    """Run an example as a user does; return what it printed."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(CHECKOUT), *filter(None, sys.path)])}
    command = [sys.executable, str(CHECKOUT / "examples" / name), *map(str, words)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.mark.slow
def test_a_crate_describes_its_files_and_gives_the_campaign_back(tmp_path: Path) -> None:
    """Files have checksums; licence, authors and runs are named; a database made from the crate has the same bits."""
    database, configuration = Path(shutil.copy(TUTORIAL, tmp_path)), TUTORIAL.with_name("quick.toml")
    (tmp_path / "notes.txt").write_text("further file")
    out = tmp_path / "quick.zip"
    files = (tmp_path / "notes.txt", "--author", "Ada", "--author", "Émilie", "--licence", "CC0-1.0")
    assert "Wrote" in run_example("ro_crate.py", database, configuration, out, *files)
    with zipfile.ZipFile(out) as archive:
        archive.extractall(tmp_path / "crate")
    described = json.loads((tmp_path / "crate" / "ro-crate-metadata.json").read_text(encoding="utf-8"))
    entities = {entity["@id"]: entity for entity in described["@graph"]}
    root = entities["./"]
    names = {part["@id"] for part in root["hasPart"]}
    assert names == {"campaign.nc", configuration.name, "notes.txt"}
    for name in names:
        assert entities[name]["sha256"] == sha256((tmp_path / "crate" / name).read_bytes()).hexdigest()
    assert entities[root["license"]["@id"]]["name"] == "CC0-1.0"
    assert [entities[author["@id"]]["name"] for author in root["author"]] == ["Ada", "Émilie"]
    imported = ["import", str(tmp_path / "crate" / "campaign.nc"), "--db", str(tmp_path / "copy.db")]
    subprocess.run([sys.executable, "-m", "calcidem", *imported], check=True, capture_output=True)
    with calcidem.open_campaign(database) as campaign, calcidem.open_campaign(tmp_path / "copy.db") as copy:
        assert copy.vs().to_numpy().tobytes() == campaign.vs().to_numpy().tobytes()
        actions = [entity for entity in entities.values() if entity["@type"] == "CreateAction"]
        versions = [entities[action["instrument"]["@id"]]["version"] for action in actions]
        assert versions == [run.versions["calcidem"] for _, run in campaign.runs()]
        assert entities[root["identifier"]["@id"]]["value"] == campaign.record.hash
    other = tmp_path / "other.toml"
    other.write_text(calcidem.preset_text("paper-small-pulse"))
    assert "is not the configuration of" in run_example("ro_crate.py", database, other, out, code=1)
