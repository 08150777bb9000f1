"""Files for citation, review and packaging agree with the package."""

import json
import re
import tomllib

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from places import CHECKOUT

import calcidem

NAMES_ON_CONDA = {"netCDF4": "netcdf4", "matplotlib": "matplotlib-base"}
PAPER = CHECKOUT / "paper" / "paper.md"
SECTIONS = (
    *("Summary", "Statement of need", "State of the field", "Software design", "Research impact statement"),
    *("AI usage disclosure", "Acknowledgements", "References"),
)


def test_files_name_the_version_of_the_package() -> None:
    """Formats that want the version as text have the one of `calcidem.__version__`."""
    citation = yaml.safe_load((CHECKOUT / "CITATION.cff").read_text(encoding="utf-8"))
    metadata = json.loads((CHECKOUT / "codemeta.json").read_text(encoding="utf-8"))
    recipe = yaml.safe_load((CHECKOUT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    found = {str(citation["version"]), metadata["version"], recipe["context"]["version"]}
    assert found == {calcidem.__version__}


def test_the_conda_recipe_has_the_libraries_of_the_wheel() -> None:
    """Names and lower bounds are those of pyproject.toml."""
    recipe = yaml.safe_load((CHECKOUT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = {f"python {project['requires-python']}", "openmpi"}
    for requirement in map(Requirement, project["dependencies"]):
        name = NAMES_ON_CONDA.get(requirement.name, requirement.name.lower())
        wanted.add(f"{name} {requirement.specifier}")
    assert set(recipe["requirements"]["run"]) == wanted


def test_the_lock_file_has_the_libraries_of_the_shipped_campaign() -> None:
    """It has every library that calcidem needs, and the versions that the shipped campaign's own record names."""
    lines = (CHECKOUT / "packaging" / "campaign.lock").read_text(encoding="utf-8").splitlines()
    pins = [line.split("==") for line in lines if not line.startswith("#")]
    locked = {canonicalize_name(name): version for name, version in pins}
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for requirement in map(Requirement, [*project["dependencies"], *project["optional-dependencies"]["openmpi"]]):
        assert requirement.specifier.contains(locked[canonicalize_name(requirement.name)]), requirement
    for run in json.loads(calcidem.load_paper_campaign().attrs["calcidem_runs"]):
        found = {name: version for name, version in run["versions"].items() if name in locked}
        assert found.items() <= locked.items()
        assert len(found) >= 6


def test_the_paper_has_its_sections_and_cites_what_is_listed() -> None:
    """Sections that JOSS asks for stand in order, in 750 to 1,750 words; text and bibliography have the same keys."""
    text = PAPER.read_text(encoding="utf-8").partition("\n---\n")[2]
    assert tuple(re.findall(r"^# (.*)$", text, re.MULTILINE)) == SECTIONS
    listed = re.findall(r"^@\w+\{(\w+),", PAPER.with_suffix(".bib").read_text(encoding="utf-8"), re.MULTILINE)
    assert set(re.findall(r"@(\w+)", text)) == set(listed)
    assert 750 <= len(text.split()) <= 1750


@pytest.mark.parametrize("path", sorted((CHECKOUT / ".github").rglob("*.yml")), ids=lambda path: path.stem)
def test_workflows_and_templates_are_documents(path: object) -> None:
    """They are YAML with the keys that their readers ask for."""
    document = yaml.safe_load(path.read_text(encoding="utf-8"))  # type: ignore[attr-defined]
    assert {"name"} < set(document)
    assert {"body", "jobs"} & set(document)
