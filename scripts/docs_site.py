"""What mkdocs cannot do with the tree as it is: pages outside docs/, the gallery and the notebook of the tutorial.

Figures of the gallery and the notebook are made from stored data again, and the build fails if a committed picture or
number is another one. A hook of mkdocs.yml (https://www.mkdocs.org/user-guide/configuration/#hooks).
"""

import json
import re
import runpy
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]

_OUTSIDE = {"ARCHITECTURE.md": "architecture.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
"""Pages of the repository's folder, and what the site calls them."""

_NOTEBOOK = "tutorial/tutorial.ipynb"
_TUTORIAL = "tutorial/index.md"
_GALLERY = "gallery/README.md"


def on_pre_build(**_: object) -> None:
    """End the build if a figure of the gallery, or what the notebook shows, is not what stored data give."""
    if stale := _stale():
        raise PluginError("\n".join(stale))


@cache
def _stale() -> tuple[str, ...]:
    """What is not up to date, and what renews it; made once for all builds of `mkdocs serve`."""
    compare = runpy.run_path(str(ROOT / "scripts" / "stale_figures.py"))
    with tempfile.TemporaryDirectory() as folder:
        return (*compare["stale_gallery"](), *compare["stale_notebook"](Path(folder)))


def on_files(files: Files, config: Any) -> Files:  # noqa: ANN401 - mkdocs' own mapping
    """Add the pages outside docs/, and the notebook as a page."""
    for source, page in _OUTSIDE.items():
        text = (ROOT / source).read_text(encoding="utf-8").replace("](docs/", "](")
        files.append(File.generated(config, page, content=_relinked(text)))
    notebook = json.loads((ROOT / "docs" / _NOTEBOOK).read_text(encoding="utf-8"))
    files.append(File.generated(config, _TUTORIAL, content="\n\n".join(map(_cell_text, notebook["cells"]))))
    return files


def on_page_markdown(markdown: str, page: Any, **_: object) -> str:  # noqa: ANN401 - as above
    """Write the captions of the gallery; lead links to the pages outside docs/ and to the notebook to the site's."""
    if page.file.src_uri == _GALLERY:
        return str(runpy.run_path(str(ROOT / "docs" / "gallery" / "make_gallery.py"))["gallery_page"](captions=True))
    return _relinked(markdown) if page.file.src_uri not in _OUTSIDE.values() else markdown


def _relinked(markdown: str) -> str:
    """Text with links to pages of the site."""
    for source, page in _OUTSIDE.items():
        markdown = re.sub(rf"\]\((\.\./)?{source}", f"]({page}", markdown)
    return markdown.replace(f"]({_NOTEBOOK})", f"]({_TUTORIAL})")


def _cell_text(cell: dict[str, Any]) -> str:
    """Markdown of a cell, with the text and the pictures that it gave."""
    source = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        return source
    shown = [f"```python\n{source}\n```"]
    for output in cell["outputs"]:
        data = output.get("data", {})
        if "image/png" in data:
            picture = "".join(data["image/png"]).replace("\n", "")
            shown.append(f'<img alt="figure drawn by the lines above" src="data:image/png;base64,{picture}">')
        elif "text/plain" in data:
            shown.append(f"```text\n{''.join(data['text/plain'])}\n```")
    return "\n\n".join(shown)
