"""Take over what ``calcidem accuracy CONFIG --out DIR`` found: tables and figure into docs, errors into the package.

    python benchmarks/accuracy/publish.py DIR

replaces, in docs/accuracy.md, what stands between ``<!-- NAME -->`` and ``<!-- end -->`` by the table of that name in
DIR/accuracy.md, copies the figure, and writes the errors of each cell to calcidem/app/studies/accuracy/measured.json.
"""

import json
import re
import shutil
import sys
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]
_PAGE = _ROOT / "docs" / "accuracy.md"
_PACKAGED = _ROOT / "calcidem" / "app" / "studies" / "accuracy" / "measured.json"
_TABLE = re.compile(r"<!-- (\w+) -->\n(.*?)\n<!-- end -->", re.DOTALL)


def publish(folder: Path) -> None:
    """Take over the result in a folder; a table of the page that the result has not is left as it is, and named."""
    tables = dict(_TABLE.findall((folder / "accuracy.md").read_text()))
    page = _PAGE.read_text()
    missing = [name for name, _ in _TABLE.findall(page) if name not in tables]
    _PAGE.write_text(_TABLE.sub(lambda found: _marked(found[1], tables.get(found[1], found[2])), page))
    shutil.copy(folder / "accuracy.png", _PAGE.with_name("accuracy.png"))
    found = json.loads((folder / "accuracy.json").read_text())
    kept = ("setting", "seed", "content", "vs_error")
    cells = [{name: cell[name] for name in kept} for cell in found["study"]["cells"]]
    hashes = {name: found[name] for name in ("campaign_hash", "packing_hash")}
    _PACKAGED.write_text(json.dumps({**hashes, "study": {"cells": cells}}, separators=(",", ":")))
    print(f"taken over: {', '.join(tables)}; left as it was: {', '.join(missing) or 'nothing'}")


def _marked(name: str, table: str) -> str:
    """Table between its marks."""
    return f"<!-- {name} -->\n{table}\n<!-- end -->"


if __name__ == "__main__":
    publish(Path(sys.argv[1]))
