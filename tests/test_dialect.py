"""The habits of the code that no linter knows, see CONTRIBUTING.md."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "calcidem"
MODULES = sorted(PACKAGE.rglob("*.py"))
MOST_LINES = 5_700
"""Of a room: a larger one has something in it that wants a room of its own."""


def test_annotations_are_evaluated() -> None:
    """No module postpones its annotations."""
    assert [path for path in MODULES if "from __future__" in path.read_text(encoding="utf-8")] == []


def test_app_consists_of_rooms() -> None:
    """No module stands loose in `calcidem.app` but the room of one file."""
    assert {path.name for path in (PACKAGE / "app").glob("*.py")} == {"__init__.py", "disks.py"}


def test_no_room_is_too_large() -> None:
    """No folder of the second level, nor the scheduler, has more lines than a reader can hold."""
    lines: dict[str, int] = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).parts
        room = "/".join(parts[:-1][: 1 if parts[0] == "sweep" else 2])
        lines[room] = lines.get(room, 0) + len(path.read_text(encoding="utf-8").splitlines())
    assert max(lines.values()) <= MOST_LINES, lines
