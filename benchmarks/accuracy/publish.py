"""Take over what ``calcidem accuracy CONFIG --out DIR`` found: tables and figure into docs.

    python benchmarks/accuracy/publish.py DIR

replaces, in docs/accuracy.md, what stands between ``<!-- NAME -->`` and ``<!-- end -->`` by the table of that name in
DIR/accuracy.md, and copies the figure. Rows that the page leaves out stay out.
"""

import re
import shutil
import sys
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]
_PAGE = _ROOT / "docs" / "accuracy.md"
_TABLE = re.compile(r"<!-- (\w+) -->\n(.*?)\n<!-- end -->", re.DOTALL)


def publish(folder: Path) -> None:
    """Take over the result in a folder; a table of the page that the result has not is left as it is, and named."""
    tables = dict(_TABLE.findall((folder / "accuracy.md").read_text()))
    page = _PAGE.read_text()
    missing = [name for name, _ in _TABLE.findall(page) if name not in tables]
    _PAGE.write_text(_TABLE.sub(lambda found: _marked(found, tables), page))
    shutil.copy(folder / "accuracy.png", _PAGE.with_name("accuracy.png"))
    print(f"taken over: {', '.join(tables)}; left as it was: {', '.join(missing) or 'nothing'}")


def _marked(found: re.Match[str], tables: dict[str, str]) -> str:
    """Table of a page between its marks: the new one, without the rows that the page leaves out."""
    name, old = found[1], found[2]
    new = tables.get(name, old)
    kept, offered = _first_cells(old), _first_cells(new)
    if kept < offered:
        new = "\n".join(line for line in new.splitlines() if line.split(" | ")[0] not in offered - kept)
    return f"<!-- {name} -->\n{new}\n<!-- end -->"


def _first_cells(table: str) -> set[str]:
    """First cells of the rows of a table."""
    return {line.split(" | ")[0] for line in table.splitlines() if line.startswith("| ")}


if __name__ == "__main__":
    publish(Path(sys.argv[1]))
