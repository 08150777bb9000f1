"""The documentation for users says what the package does."""

import json
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
from inspect import getmembers, isclass
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

import calcidem.storage.errors
from calcidem.app.cli.main import _COMMON_OPTIONS, PANELS, _build_application
from calcidem.app.config.examples import full_text, key_references
from calcidem.app.config.presets import PRESETS, preset_text
from calcidem.app.config.reader import load_configuration
from calcidem.dem import UnstableRunError
from calcidem.dem.engine.fields import written
from calcidem.dem.sample.cement import CementCapacityError
from calcidem.dem.sample.compaction import SettlingError
from calcidem.dem.sample.packing import PackingFileError
from calcidem.ends import CellStatus, Verdict
from calcidem.sweep.schedule import LaunchError

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
SCRIPT = runpy.run_path(str(ROOT / "scripts" / "make_docs.py"))
OUTPUTS = runpy.run_path(str(ROOT / "scripts" / "page_outputs.py"))
RECORDED, typed_blocks = OUTPUTS["RECORDED"], OUTPUTS["typed_blocks"]
PAGES = [page for page in OUTPUTS["PAGES"] if any(typed_blocks(page))]


@pytest.mark.parametrize("name", sorted(SCRIPT["PAGES"]))
def test_generated_pages_are_what_the_code_says(name: str) -> None:
    """A page that `python scripts/make_docs.py` writes is committed as it writes it."""
    assert (DOCS / name).read_text(encoding="utf-8") == SCRIPT["PAGES"][name](), "run: python scripts/make_docs.py"


def test_the_command_reference_has_every_option() -> None:
    """Each command of `calcidem` has its section, and each of its options a row, there or among the shared ones."""
    group = typer.main.get_command(_build_application())
    context = group.make_context("calcidem", [], resilient_parsing=True)
    shared, *sections = (DOCS / "commands.md").read_text(encoding="utf-8").split("\n### calcidem ")
    rows = {section.split("\n")[0]: section for section in sections}
    assert set(rows) == {name for panel in PANELS.values() for name in panel}
    for name, section in rows.items():
        _, command, _ = group.resolve_command(context, [name])
        for parameter in command.params:
            if parameter.param_type_name == "option" and parameter.name not in {"help", *_COMMON_OPTIONS}:
                words = f"`{', '.join(parameter.opts)}"
                row = f"* {words}"
                assert row in section or (row in shared and f"{words}`" in section), (name, parameter.opts)


@pytest.mark.parametrize("preset", PRESETS)
def test_a_full_configuration_is_its_preset(preset: str, tmp_path: Path) -> None:
    """`init --full` writes the same campaign with every key."""
    short, full = tmp_path / "short.toml", tmp_path / "full.toml"
    short.write_text(preset_text(preset), encoding="utf-8")
    full.write_text(full_text(preset), encoding="utf-8")
    assert load_configuration(full) == load_configuration(short)
    written = {line.removeprefix("# ").split(" =")[0] for line in full_text(preset).splitlines()}
    assert {key.name for key in key_references()} <= written


def test_the_schema_for_editors_accepts_what_the_reader_accepts() -> None:
    """All presets, short and full, fit the JSON schema; what is unknown, of a wrong type or out of bounds does not."""
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    validator = jsonschema.Draft7Validator(json.loads((DOCS / "configuration.schema.json").read_text(encoding="utf-8")))
    for text in (*map(preset_text, PRESETS), *map(full_text, PRESETS)):
        assert not list(validator.iter_errors(tomllib.loads(text)))
    for wrong in ("[wave]\nampltude = 1e-3", "[wave]\namplitude = 'loud'", "[weve]", "[packing]\nporosity = 0.9"):
        assert list(validator.iter_errors(tomllib.loads(wrong))), wrong


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_of_a_page_has_the_options_it_is_given(page: Path) -> None:
    """Commands that are run, and those that take too long for it, exist with these options; others are marked."""
    sections = (DOCS / "commands.md").read_text(encoding="utf-8").split("\n### calcidem ")
    known = {section.split("\n")[0]: set(re.findall(r"--[\w-]+", section)) for section in sections[1:]}
    for block in typed_blocks(page):
        for words in map(shlex.split, block.commands):
            if words[0] == "calcidem":
                assert {word.split("=")[0] for word in words if word.startswith("--")} <= known[words[1]], words
            else:
                assert block.reason, words


@pytest.mark.full
def test_a_recorded_page_shows_what_its_commands_print(tmp_path: Path) -> None:
    """Numbers and words of `your-sand.md` are what its commands give today; times are not compared."""
    text = RECORDED.read_text(encoding="utf-8")
    now = OUTPUTS["text_with_outputs"](text, tmp_path)
    assert without_times(now) == without_times(text), f"run: python scripts/page_outputs.py {RECORDED}"


def without_times(text: str) -> str:
    """Text without lines of progress, seconds, and what depends on the machine."""
    text = re.sub(
        r"^(\d\d:\d\d:\d\d|Time: |Memory: |Packing: (being|the disks|taken)|Computing on one).*\n",
        "",
        text,
        flags=re.MULTILINE,
    )
    text = re.sub(r"\b\d+ s\b", "", text)
    return re.sub(r" +\d+\.\d(?=( +\d no arrival)?$)", "", text, flags=re.MULTILINE)  # the column of seconds


@pytest.mark.full
@pytest.mark.parametrize("page", sorted({*PAGES} - {RECORDED}), ids=lambda page: page.stem)
def test_the_commands_of_a_page_work(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a page tells to do works in its order, on the database of the tutorial; what computes is listed."""
    monkeypatch.chdir(tmp_path)
    for copy in ("results/quick.db", *(["quick.db"] if page.stem != "README" else [])):  # the README computes it
        Path(copy).parent.mkdir(exist_ok=True)
        shutil.copy(DOCS / "tutorial" / "quick.db", copy)
    for file in ("quick.toml", *(["calcidem.toml"] if page.stem not in {"quick-start", "README"} else [])):
        Path(file).write_text(preset_text("quick"), encoding="utf-8")
    names: dict[str, object] = {}
    for block in typed_blocks(page):
        if block.reason:
            with capsys.disabled():
                sys.stdout.write(f"\n{page.stem}: not run ({block.reason}):\n{block.text}")
        else:
            follow(block, names)


def follow(block: Any, names: dict[str, object]) -> None:  # noqa: ANN401 - of a script
    """Do what a block says: run its commands, or write its file, or put its values into the configuration."""
    name = re.match(r"# (\S+\.\w+)\n", block.text)
    if block.language == "sh":
        for _, *words in map(shlex.split, block.commands):
            if words[0] == "serve":
                continue  # until Ctrl-C: tests/app/test_serve.py
            result = CliRunner().invoke(_build_application(), words)
            assert result.exit_code == 0, (words, result.output, result.exception)
    elif block.language == "python":
        exec(block.text, names)  # noqa: S102 - our own pages
    elif name:
        Path(name[1]).write_text(block.text.removeprefix(name[0]), encoding="utf-8")
    else:
        document = tomllib.loads(preset_text("quick"))
        for section, values in tomllib.loads(block.text).items():
            document[section] |= values
        lines = [
            [f"[{section}]", *(f"{key} = {written(value)}" for key, value in values.items())]
            for section, values in document.items()
        ]
        Path("calcidem.toml").write_text("\n".join(line for section in lines for line in section), encoding="utf-8")


def test_tables_are_whole_and_images_have_words() -> None:
    """A blank line would end a table, so that the rows below it are text; readers may not see an image."""
    for page in sorted((*DOCS.rglob("*.md"), *ROOT.glob("*.md"))):
        text = page.read_text(encoding="utf-8")
        lines = text.splitlines()
        heads = {number for number, line in enumerate(lines, -1) if re.fullmatch(r"\|[-:| ]+\|", line)}
        for number, line in enumerate(lines[2:], 2):
            starts = line.startswith("|") and not lines[number - 1].startswith("|")
            assert not starts or number in heads, f"{page}: {number + 1}"
        assert "![](" not in text, page


def test_troubleshooting_has_every_error_and_reason() -> None:
    """Each error that a user may see, each status without velocity, and each reason of an unread signal is listed."""
    page = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    names = {name for name, kind in getmembers(calcidem.storage.errors, isclass) if kind.__module__.endswith("errors")}
    others = (UnstableRunError, CementCapacityError, PackingFileError, SettlingError, LaunchError)
    names |= {kind.__name__ for kind in others} - {"StoreError"}
    assert not {name for name in names - {"StoreError"} if f"`{name}`" not in page}
    settled = {str(status) for status in CellStatus} - {"pending", "running", "done"}
    assert not {status for status in settled if f"\n* `{status}`: " not in page}
    assert not {str(reason) for reason in Verdict if f"\n* *{reason}*: " not in page}


@pytest.mark.full
def test_the_site_is_built_without_warnings(tmp_path: Path) -> None:
    """`mkdocs build --strict` ends well: every link, anchor and documented name is there."""
    pytest.importorskip("mkdocs", reason="mkdocs is not installed: pip install -e '.[docs]'")
    pytest.importorskip("material", reason="mkdocs-material is not installed: pip install -e '.[docs]'")
    pytest.importorskip("mkdocstrings", reason="mkdocstrings is not installed: pip install -e '.[docs]'")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, check=False, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Campaign" in (tmp_path / "site" / "api" / "index.html").read_text(encoding="utf-8")
