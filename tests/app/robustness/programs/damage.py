"""Damage single places of a database and look at what reading it gives: values, or a sentence, never a traceback.

For each damage a copy of a small real database is changed in one place (bytes of a row, blob, index, page or header; a
value; a truncation), and everything that reads it is tried.
"""

import random
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from calcidem.app.campaign.opened import open_campaign
from calcidem.app.campaign.packing import packing_record, stored_packing
from calcidem.app.cli.main import _build_application
from calcidem.ends import CellStatus
from calcidem.storage.errors import StoreError
from calcidem.storage.records import CellKey, CellResult
from calcidem.storage.sql.store import Store

SOURCE = Path(__file__).parents[4] / "docs" / "tutorial" / "quick.db"
SEEDS = (1, 2)

Generator = random.Random
Damage = Callable[[Path, Generator], str]


def make_database(path: Path) -> None:
    """Copy some seeds of the tutorial's campaign."""
    with Store(SOURCE, read_only=True) as whole, Store(path) as store:
        record = whole.use_campaign()
        store.begin_campaign(replace(record, seeds=(*SEEDS, 99)))
        store.begin_run(whole.runs()[0][1])
        store.save_packing(packing_record(stored_packing(whole.packing()), index=0, packing_hash="of no importance"))
        store.record_results(result for result in whole.results(with_arrays=True) if result.key.seed in SEEDS)
        store.record_results([CellResult(CellKey(99, 0.0), CellStatus.FAILED, "of no importance")])


# Damages: each changes a file and says what it did


def damage_bytes(path: Path, generator: Generator) -> str:
    """Overwrite some bytes anywhere."""
    count, place = generator.choice((1, 1, 1, 8, 64, 600)), generator.randrange(path.stat().st_size)
    _write(path, place, generator.randbytes(count))
    return f"{count} bytes at {place}"


def damage_bit(path: Path, generator: Generator) -> str:
    """Flip one bit of a page that holds rows or keys, or lists of them."""
    content = path.read_bytes()
    pages = [start for start in range(0, len(content), 4096) if content[start + 100 * (start == 0)] in {2, 5, 10, 13}]
    place = generator.choice(pages) + generator.randrange(4096)
    _write(path, place, bytes([content[place] ^ 1 << generator.randrange(8)]))
    return f"one bit at {place}"


def damage_header(path: Path, generator: Generator) -> str:
    """Overwrite a byte of the file's header."""
    place = generator.randrange(100)
    _write(path, place, generator.randbytes(1))
    return f"header byte {place}"


def truncate(path: Path, generator: Generator) -> str:
    """Cut the file off."""
    size = generator.randrange(path.stat().st_size)
    with path.open("r+b") as file:
        file.truncate(size)
    return f"cut off at {size}"


def damage_page(path: Path, generator: Generator) -> str:
    """Empty a page, or put another one in its place."""
    pages = path.stat().st_size // 4096
    place, other = generator.randrange(pages), generator.randrange(pages)
    content = path.read_bytes()[other * 4096 : (other + 1) * 4096] if generator.randrange(2) else bytes(4096)
    _write(path, place * 4096, content)
    return f"page {place}" + (f" is page {other}" if any(content) else " is empty")


def damage_value(path: Path, generator: Generator) -> str:
    """Change a value of a row behind the constraints."""
    with sqlite3.connect(path, isolation_level=None) as connection:
        connection.execute("PRAGMA ignore_check_constraints=ON")
        tables = ("result", "attempt", "arrays", "packing", "run")
        table = generator.choice((*tables, *tables, "cell", "campaign", "calcidem_schema"))
        column = generator.choice([row[1] for row in connection.execute(f"PRAGMA table_info({table})")])
        rowid, value = generator.choice(connection.execute(f"SELECT rowid, {column} FROM {table}").fetchall())  # noqa: S608 - of our own
        changed = _changed(value, generator)
        try:
            connection.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (changed, rowid))  # noqa: S608 - of our own
        except sqlite3.IntegrityError:
            changed = value
    connection.close()
    return f"{table}.{column}: {str(value)[:20]!r} -> {str(changed)[:20]!r}"


DAMAGES: tuple[Damage, ...] = (
    damage_bytes,
    damage_bit,
    damage_header,
    truncate,
    damage_page,
    damage_value,
    damage_value,
)


def _changed(value: Any, generator: Generator) -> Any:  # noqa: ANN401 - whatever a database holds
    if isinstance(value, bytes):
        place = generator.randrange(len(value) or 1)
        return value[:place] + generator.randbytes(1) + value[place + 1 :]
    if isinstance(value, str) and value and generator.random() < 0.7:
        place = generator.randrange(len(value))
        return value[:place] + generator.choice("\x1b\0x0]{9") + value[place + 1 :]
    close = [value + 1, value * 1.0000000001, -value, value * 1e300] if isinstance(value, int | float) else []
    return generator.choice([*close, None, "text", b"\xff\xfe", 0, -1, 2**62, 1e308, ""])


def _write(path: Path, place: int, content: bytes) -> None:
    with path.open("r+b") as file:
        file.seek(place)
        file.write(content[: path.stat().st_size - place])


# What is tried with a damaged file


def read_all(path: Path) -> None:
    """Read everything that is stored."""
    with open_campaign(path) as campaign:
        for _ in (*campaign.select(with_arrays=True), *campaign.select(), *campaign.store.history()):
            pass
        campaign.vs()
        campaign.runs()
        stored_packing(campaign.store.packing())


COMMANDS = (
    ("status", "DB"),
    ("query", "DB", "--columns", "all", "--format", "csv"),
    ("query", "DB", "--where", "vs > 100", "--sort=-vs", "--limit", "3"),
    ("export", "DB", "OUT"),
    ("verify", "DB", "--integrity"),
    ("status", "DB", "--format", "json"),
)


def tracebacks(path: Path, out: Path) -> Iterator[str]:
    """Run commands on a damaged file; name those that end with an exception that is no sentence for the user."""
    for command in COMMANDS:
        words = [{"DB": str(path), "OUT": str(out)}.get(word, word) for word in command]
        found = CliRunner().invoke(_build_application(), words).exception
        if found is not None and not isinstance(found, SystemExit | StoreError):
            yield f"{' '.join(command)}: {type(found).__name__}: {found}"


def judge(path: Path, folder: Path) -> tuple[str, list[str]]:
    """Whether a damaged file can be read, and what is wrong with how it is told."""
    wrong = []
    try:
        read_all(path)
        readable = "read"
    except StoreError as error:
        readable = type(error).__name__
    except Exception as error:  # noqa: BLE001 - it is what is looked for
        readable = "traceback"
        wrong.append(f"{type(error).__name__}: {error}")
    wrong += tracebacks(path, folder / "out.nc")
    (folder / "out.nc").unlink(missing_ok=True)
    return readable, wrong


def damage_and_judge(original: Path, folder: Path, number: int) -> tuple[str, str, str, list[str]]:
    """Do damage of a number, always the same, to a copy, and judge it: kind, place, how it is read, what is wrong."""
    generator = random.Random(number)
    damage = DAMAGES[number % len(DAMAGES)]
    path = folder / "damaged.db"
    for old in folder.glob("damaged.db*"):
        old.unlink()
    shutil.copy(original, path)
    place = damage(path, generator)
    return (damage.__name__, place, *judge(path, folder))
