"""Run the commands of a page of the documentation in a new folder, and write below each what it printed.

    python scripts/page_outputs.py docs/your-sand.md docs/tutorial/tutorial.ipynb

A block ``sh`` or ``python`` is run, a block whose first line is ``# NAME.toml`` or ``# NAME.csv`` is written as that
file; a block ``text`` gets what the one before it printed. Figures that the page shows are taken over from the folder.
A notebook is run on a copy of the database beside it.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calcidem.storage.sql.store import Store

ROOT = Path(__file__).parents[1]
_WIDTH = "110"  # columns of a terminal: what the site shows without scrolling
_BLOCK = re.compile(r"^```(\w+)\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
_HOME = "/home/me"

PAGES = sorted({ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")})
"""Pages that may tell what to type."""

RECORDED = ROOT / "docs" / "your-sand.md"
"""The page that shows what its commands print, and is run as a whole."""

_STARTS = r"calcidem |python |pip |mkdocs |pytest |apt-get |cmake |make |mkdir |\. |\./"
_TYPED = re.compile(
    r"(?:^<!-- long: ([^>]*) -->\n\n?)?"
    rf"(?:^```(\w+)\n(.*?)^```|((?:^    (?:{_STARTS})[^\n]*\n(?:^ {{5,}}[^\n]*\n)*)+))",
    re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Block:
    """Lines of a page to be typed or written to a file.

    Attributes
    ----------
    language, text
        What it is, and its lines.
    reason
        Why no test runs it; empty for those that are run.
    """

    language: str
    text: str
    reason: str

    @property
    def commands(self) -> list[str]:
        """Commands, without comments and with their continuation lines."""
        whole = (line.split(" #")[0].split(" || ")[0].strip() for line in self.text.replace("\\\n", "").splitlines())
        return [line for line in whole if line] if self.language == "sh" else []


def typed_blocks(page: Path) -> Iterator[Block]:
    """Fenced blocks of a page but those that are only shown (``text``), and indented ones that begin with a command."""
    for reason, language, fenced, indented in _TYPED.findall(page.read_text(encoding="utf-8")):
        if language != "text":
            yield Block(language or "sh", fenced or re.sub(r"^    ", "", indented, flags=re.MULTILINE), reason)


def text_with_outputs(text: str, folder: Path) -> str:
    """Text of a page with what its commands print in a folder.

    Raises
    ------
    subprocess.CalledProcessError
        If one of them fails.
    """
    folder = folder.resolve()
    printed = ""

    def follow(block: re.Match[str]) -> str:
        nonlocal printed
        language, lines = block[1], block[2]
        if language == "text":
            return f"```text\n{printed}```\n"
        if language in {"sh", "python"}:
            program = ["bash", "-e", "-c"] if language == "sh" else [sys.executable, "-c"]
            shown = subprocess.run(  # noqa: S603 - our own pages
                [*program, lines],
                cwd=folder,
                env=_environment(folder),
                check=True,
                text=True,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            ).stdout
            shown = shown.replace(f"{folder}/.cache", f"{_HOME}/.cache/calcidem").replace(str(folder), f"{_HOME}/sand")
            printed = "".join(f"{line.rstrip()}\n" for line in shown.splitlines())
        elif name := re.match(r"# (\S+\.(?:toml|csv))\n", lines):
            (folder / name[1]).write_text(lines, encoding="utf-8")
        return block[0]

    return _BLOCK.sub(follow, text)


def run_notebook(file: Path, folder: Path) -> Any:  # noqa: ANN401 - nbformat's own mapping
    """Notebook with what its cells give, as text and pictures, on a copy of its database in a folder."""
    import nbclient  # noqa: PLC0415 - only notebooks need it
    import nbformat  # noqa: PLC0415 - as above

    Store(shutil.copy(file.with_name("quick.db"), folder)).close()  # in the present schema
    os.environ["PYTHONPATH"] = str(ROOT)  # the kernel is to import the calcidem of this copy
    notebook = nbformat.read(file, as_version=4)
    nbclient.NotebookClient(
        notebook, timeout=300, record_timing=False, resources={"metadata": {"path": str(folder)}}
    ).execute()
    for output in (output for cell in notebook.cells for output in cell.get("outputs", ())):
        output.get("data", {}).pop("text/html", None)  # xarray's is as large as a picture
    return notebook


def _environment(folder: Path) -> dict[str, str]:
    """Environment in which `calcidem` is that of this copy of the repository, CALCIDEM, and has no packing yet."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    places = {"PYTHONPATH": str(ROOT), "CALCIDEM": str(ROOT), "CALCIDEM_CACHE": str(folder / ".cache")}
    return os.environ | places | {"PATH": path, "COLUMNS": _WIDTH}


def main() -> None:
    """Renew the pages named."""
    for page in map(Path, sys.argv[1:]):
        with tempfile.TemporaryDirectory() as folder:
            if page.suffix == ".ipynb":
                import nbformat  # noqa: PLC0415 - as above

                nbformat.write(run_notebook(page, Path(folder)), page)
                continue
            text = text_with_outputs(page.read_text(encoding="utf-8"), Path(folder))
            page.write_text(text, encoding="utf-8")
            for picture in re.findall(r"\]\(([\w-]+\.png)\)", text):
                shutil.copy(next(Path(folder).rglob(picture)), page.parent / picture)


if __name__ == "__main__":
    main()
