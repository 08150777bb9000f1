"""The notebook of the tutorial runs as it is printed."""

import shutil
from pathlib import Path

import pytest

from calcidem.storage.sql.store import open_store

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]


def test_tutorial_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every cell of the notebook runs, and it draws its four figures."""
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    database = shutil.copy(ROOT / "docs" / "tutorial" / "quick.db", tmp_path)
    open_store(database).close()
    # The kernel must import the calcidem under test, installed or not, in the Python that runs the test.
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    notebook = nbformat.read(ROOT / "docs" / "tutorial" / "tutorial.ipynb", as_version=4)
    client = nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 4
