import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.full
def test_the_beam_of_the_example_bends_as_its_closed_form_says() -> None:
    """The tip of the cantilever comes to rest within 1e-6 of the closed form: what is left of the damped motion."""
    spec = importlib.util.spec_from_file_location("cantilever", ROOT / "examples" / "cantilever.py")
    assert spec is not None
    assert spec.loader is not None
    cantilever = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(cantilever)
    deflection = -cantilever.bend().position()[-1, 1]
    assert deflection == pytest.approx(cantilever.expected_deflection(), rel=1e-6)


@pytest.mark.full
def test_the_scene_of_the_documentation_runs() -> None:
    """The first program of docs/scenes.md runs as it stands and gives two disks and their energies."""
    text = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")
    program = re.search(r"```python\n(.*?)```", text, re.DOTALL)
    assert program is not None
    names: dict[str, object] = {}
    exec(program.group(1), names)  # noqa: S102 - the documentation's own program
    state = names["state"]
    assert state.position().shape == (2, 2)  # type: ignore[attr-defined]
    assert state.steps == 2000  # type: ignore[attr-defined]
