"""The notebook of the tutorial runs as it is printed, and gives what is printed."""

import re
import runpy
from pathlib import Path
from typing import Any

import pytest
from places import CHECKOUT

pytestmark = pytest.mark.slow

FILE = CHECKOUT / "docs" / "tutorial" / "tutorial.ipynb"


def outputs_of(notebook: Any) -> list[dict[str, Any]]:  # noqa: ANN401 - nbformat's own mapping
    """What the cells of a notebook gave, one after the other."""
    return [output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", ())]


def numbers_of(text: str) -> list[float]:
    """Numbers with a point that stand in a text, whatever the versions of libraries put around them."""
    return [float(number) for number in re.findall(r"-?\d+\.\d+(?:e[-+]\d+)?", text)]


def test_tutorial_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every cell runs, draws its five figures, and gives what stands in the committed notebook."""
    pytest.importorskip("nbclient", reason="nbclient is not installed")
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    monkeypatch.setenv("PYTHONPATH", "")  # set by the script for its kernel, and again as it was afterwards
    program = runpy.run_path(str(CHECKOUT / "scripts" / "page_outputs.py"))
    now = outputs_of(program["run_notebook"](FILE, tmp_path))
    committed = outputs_of(nbformat.read(FILE, as_version=4))
    assert sum("image/png" in output for output in now) == 5
    shown = [[numbers_of(output.get("text/plain", "")) for output in outputs] for outputs in (now, committed)]
    for numbers, printed in zip(*shown, strict=True):
        assert numbers == pytest.approx(printed), "run: python scripts/page_outputs.py docs/tutorial/tutorial.ipynb"
