"""The documentation for users says what the package does."""

import json
import runpy
import tomllib
from pathlib import Path

import pytest
import typer

from calcidem.app.cli.main import COMMANDS, build_application
from calcidem.app.config.presets import PRESETS, preset_text
from calcidem.app.config.reader import load_configuration
from calcidem.app.config.reference import full_text, key_references

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
SCRIPT = runpy.run_path(str(ROOT / "scripts" / "make_docs.py"))


@pytest.mark.parametrize("name", sorted(SCRIPT["PAGES"]))
def test_generated_pages_are_what_the_code_says(name: str) -> None:
    """A page that `python scripts/make_docs.py` writes is committed as it writes it."""
    assert (DOCS / name).read_text(encoding="utf-8") == SCRIPT["PAGES"][name](), "run: python scripts/make_docs.py"


def test_the_command_reference_has_every_option() -> None:
    """Each command of `calcidem` has its section, and each of its options a row."""
    group = typer.main.get_command(build_application())
    context = group.make_context("calcidem", [], resilient_parsing=True)
    sections = (DOCS / "commands.md").read_text(encoding="utf-8").split("\n### calcidem ")
    rows = {section.split("\n")[0]: section for section in sections[1:]}
    assert set(rows) == set(COMMANDS)
    for name, section in rows.items():
        _, command, _ = group.resolve_command(context, [name])
        for parameter in command.params:
            if parameter.param_type_name == "option" and parameter.name != "help":
                assert f"| `{', '.join(parameter.opts)}" in section, (name, parameter.opts)


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
    """All presets, short and full, fit the JSON schema; an unknown key and a wrong type do not."""
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    validator = jsonschema.Draft7Validator(json.loads((DOCS / "configuration.schema.json").read_text(encoding="utf-8")))
    for text in (*map(preset_text, PRESETS), *map(full_text, PRESETS)):
        assert not list(validator.iter_errors(tomllib.loads(text)))
    for wrong in ("[wave]\nampltude = 1e-3", "[wave]\namplitude = 'loud'", "[weve]"):
        assert list(validator.iter_errors(tomllib.loads(wrong))), wrong
