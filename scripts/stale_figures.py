"""Whether the figures of the gallery, and what the notebook shows, are still what stored data give.

The build of the site (`docs_site.py`) and `tests/test_figures_of_docs.py` ask.

Pixels are compared, not bytes: means of 8 x 8 of them, so that other smoothing of edges or fonts by another matplotlib
is no difference, and a point, a line or a number that moves is one.
"""

import base64
import json
import re
import runpy
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

ROOT = Path(__file__).parents[1]
_GALLERY = ROOT / "docs" / "gallery"
_NOTEBOOK = ROOT / "docs" / "tutorial" / "tutorial.ipynb"
_BLOCK = 8  # pixels
_LARGEST = 0.25  # difference of the means of a block, of black to white
_RENEW_GALLERY = "python docs/gallery/make_gallery.py"
_RENEW_NOTEBOOK = f"python scripts/page_outputs.py {_NOTEBOOK.relative_to(ROOT)}"


def difference(made: bytes, kept: bytes) -> float:
    """Largest difference of the means of blocks of two PNG pictures, of black to white; 1 if their sizes differ."""
    first, second = (np.asarray(Image.open(BytesIO(png)).convert("RGB"), dtype=float) / 255.0 for png in (made, kept))
    if first.shape != second.shape:
        return 1.0
    apart = first - second
    high, wide = (size // _BLOCK for size in apart.shape[:2])
    blocks = apart[: high * _BLOCK, : wide * _BLOCK].reshape(high, _BLOCK, wide, _BLOCK, 3)
    return float(np.abs(blocks.mean(axis=(1, 3))).max())


def stale_gallery() -> list[str]:
    """Sentences on the figures of the gallery that are not up to date; draws all of them."""
    made = runpy.run_path(str(_GALLERY / "make_gallery.py"))["drawn_figures"]()
    apart = {name: difference(png, (_GALLERY / f"{name}.png").read_bytes()) for name, png in made.items()}
    found = [f"docs/gallery/{name}.png is not what stored data give" for name in apart if apart[name] > _LARGEST]
    return [f"{sentence}: {_RENEW_GALLERY}" for sentence in found] + stale_sources()


def stale_sources() -> list[str]:
    """Sentences on the page of the gallery, and on the data that its figures were drawn from; draws nothing."""
    program = runpy.run_path(str(_GALLERY / "make_gallery.py"))
    kept = json.loads((_GALLERY / "drawn_from.json").read_text(encoding="utf-8"))
    found = [
        f"{name} is not the file that the gallery shows" for name in program["stored_data"]().items() - kept.items()
    ]
    if (_GALLERY / "README.md").read_text(encoding="utf-8") != program["gallery_page"]():
        found.append("docs/gallery/README.md does not list all figures")
    return [f"{sentence}: {_RENEW_GALLERY}" for sentence in found]


def stale_notebook(folder: Path) -> list[str]:
    """Sentences on what the notebook shows and no longer gives when it is run in a folder."""
    import nbformat  # noqa: PLC0415 - only notebooks need it

    run_notebook = runpy.run_path(str(ROOT / "scripts" / "page_outputs.py"))["run_notebook"]
    now, kept = map(_outputs, (run_notebook(_NOTEBOOK, folder), nbformat.read(_NOTEBOOK, as_version=4)))
    if len(now) != len(kept):
        return [f"{_NOTEBOOK.name} shows {len(kept)} results and gives {len(now)}: {_RENEW_NOTEBOOK}"]
    return [
        f"{_NOTEBOOK.name}: result {number} is another one: {_RENEW_NOTEBOOK}"
        for number, (made, shown) in enumerate(zip(now, kept, strict=True), start=1)
        if not _same_output(made, shown)
    ]


def _outputs(notebook: Any) -> list[dict[str, Any]]:  # noqa: ANN401 - nbformat's own mapping
    """What the cells of a notebook gave, one after the other; printed warnings are left out."""
    given = (output for cell in notebook.cells for output in cell.get("outputs", ()))
    return [output["data"] for output in given if "data" in output]


def _same_output(made: dict[str, Any], shown: dict[str, Any]) -> bool:
    """Whether two results have the same numbers, whatever libraries put around them, and the same picture."""
    if ("image/png" in made) != ("image/png" in shown):
        return False
    if "image/png" in made:
        pictures = (base64.b64decode(one["image/png"]) for one in (made, shown))
        return difference(*pictures) <= _LARGEST
    numbers = [_numbers(one.get("text/plain", "")) for one in (made, shown)]
    return len(numbers[0]) == len(numbers[1]) and np.allclose(*numbers, rtol=1e-6, atol=1e-12)


def _numbers(text: str) -> list[float]:
    """Numbers with a point in a text."""
    return [float(number) for number in re.findall(r"-?\d+\.\d+(?:e[-+]\d+)?", text)]
