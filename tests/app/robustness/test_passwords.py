"""Nobody sees the password of a database: a real PostgreSQL server asks for one, and the password has a mark."""

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import xarray as xr
from sqlalchemy import create_engine, text

from calcidem.storage.errors import PASSWORDS_VARIABLE, StoreError, hide_passwords, keep_passwords_back, with_passwords
from calcidem.storage.records import RunRecord
from calcidem.storage.sql.engine import Address

if TYPE_CHECKING:
    from conftest import Workshop

MARK = "Quarz7"
PASSWORD = f"{MARK}@sand:/?"
ESCAPED = f"{MARK}%40sand%3A%2F%3F"


@pytest.fixture
def no_passwords(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget afterwards what was kept back."""
    monkeypatch.setenv(PASSWORDS_VARIABLE, "{}")


@pytest.mark.parametrize(
    ("typed", "shown"),
    [
        (f"postgresql://me:{ESCAPED}@host:5432/sand", "postgresql://me@host:5432/sand"),
        (f"--db=postgresql+psycopg://me:{ESCAPED}@/sand?host=/run", "--db=postgresql+psycopg://me@/sand?host=/run"),
        (f"postgresql://host/sand?user=me&password={ESCAPED}", "postgresql://host/sand?user=me"),
        (f"postgresql://host/sand?password={ESCAPED}&user=me", "postgresql://host/sand?user=me"),
        (f"postgresql://host/sand?pass%77ord={ESCAPED}&user=me", "postgresql://host/sand?user=me"),
        (f"postgresql://host/sand?PASS%57ORD={ESCAPED}", "postgresql://host/sand"),
        (f"--db=postgresql://me@host/sand?sslpassword={ESCAPED}", "--db=postgresql://me@host/sand"),
        (f"postgresql://h/d?oauth_client_secret={ESCAPED}&sslmode=require", "postgresql://h/d?sslmode=require"),
        (f"postgresql://me:{ESCAPED}@h/d?sslpassword={ESCAPED}&x=1", "postgresql://me@h/d?x=1"),
    ],
)
@pytest.mark.usefixtures("no_passwords")
def test_a_password_leaves_the_command_line_and_is_found_again(typed: str, shown: str) -> None:
    """What the command goes on with has no password; the store finds it, and shows none."""
    (word,) = keep_passwords_back([typed])
    assert word == shown
    address = Address.parse(word.removeprefix("--db="))
    assert PASSWORD in {address.url.password, *address.url.query.values()}
    assert address.url == Address.parse(typed.removeprefix("--db=")).url
    assert MARK not in str(address)


@pytest.mark.usefixtures("no_passwords")
def test_words_without_a_password_stay() -> None:
    """Files, options, addresses without a password and the time of day are as they were typed."""
    words = ["run", "c.toml", "--db", "postgresql://me@host/sand", "-n=3", "a:b@c", "sqlite:///x.db", "12:30"]
    assert keep_passwords_back(words) == words
    assert os.environ[PASSWORDS_VARIABLE] == "{}"


@pytest.mark.parametrize(
    "address",
    [
        f"postgresql://me:a@{MARK}@host/sand",
        f"nosuch://me:a@{MARK}@host:b/sand",
        f"postgresql://host:5432/sand?password=a@{MARK}",
    ],
)
@pytest.mark.usefixtures("no_passwords")
def test_a_password_with_a_bare_at_sign_is_refused_unseen(address: str) -> None:
    """Half of such a password would be taken for the host and be shown."""
    with pytest.raises(StoreError, match="%40") as refused:
        keep_passwords_back([address])
    assert MARK not in str(refused.value)


@pytest.mark.parametrize("value", ["{Quarz7", '["Quarz7"]', "7"])
def test_a_foreign_value_of_the_variable_is_refused_unseen(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What calcidem has not written there names the variable, not its value."""
    monkeypatch.setenv(PASSWORDS_VARIABLE, value)
    with pytest.raises(StoreError, match=PASSWORDS_VARIABLE) as refused:
        with_passwords("postgresql+psycopg://user@host/sand")
    assert MARK not in str(refused.value)


def test_text_is_shown_and_stored_without_passwords() -> None:
    """Connection strings in messages, and command lines of other programs in a run's provenance, lose theirs."""
    for line in (
        f"python my.py postgresql://me:{ESCAPED}@host/sand",
        f"connecting to 'host=h password={MARK} user=me' failed",
        f"postgresql://host/sand?password={MARK}&user=me",
        f"postgresql://me:a@{MARK}@host/sand",
        f"postgresql://host/sand?sslpassword={MARK}&user=me",
        f"postgresql://host/sand?pass%77ord={MARK}",
        f'invalid options in sslmode=require sslpassword = "{MARK}"',
        f"postgresql://host:5432/sand?password=a@{MARK}",
        f"postgresql://me:it's {MARK}@host:5432/sand cannot be reached",
    ):
        assert MARK not in hide_passwords(line)
        assert hide_passwords(line)[:8] == line[:8]
        assert MARK not in RunRecord({}, "here", "some CPU", 1, line, datetime.now(UTC)).launch_line
    line = "calcidem run c.toml --db quick.db"
    assert hide_passwords(line) == line


@pytest.fixture
def server(postgresql_socket: Path) -> Iterator[str]:
    """Give the address, without its beginning and user, of a database whose owner has to give the password."""
    superuser = f"postgresql+psycopg://postgres@/postgres?host={postgresql_socket}"
    rules = postgresql_socket / "data" / "pg_hba.conf"
    before = rules.read_text()
    rules.write_text(f"local all marked scram-sha-256\n{before}")
    with create_engine(superuser, isolation_level="AUTOCOMMIT").connect() as connection:
        connection.execute(text(f"CREATE ROLE marked LOGIN PASSWORD '{PASSWORD}'"))
        connection.execute(text("CREATE DATABASE marked OWNER marked"))
        connection.execute(text("SELECT pg_reload_conf()"))
        time.sleep(0.5)
        yield f"@/marked?host={postgresql_socket}"
        connection.execute(text("DROP DATABASE marked WITH (FORCE)"))
        connection.execute(text("DROP ROLE marked"))
        rules.write_text(before)
        connection.execute(text("SELECT pg_reload_conf()"))


@pytest.mark.full
@pytest.mark.mpi
def test_a_password_is_found_nowhere(workshop: "Workshop", server: str, postgresql_socket: Path) -> None:
    """Neither output, dump, exports, pages nor the command lines of the program's children have the password."""
    workshop.configure()
    address = f"postgresql://marked:{ESCAPED}{server}"
    process = workshop.start("run", "c.toml", "--db", address, "--ranks", "3", "--report")
    typed = Path(f"/proc/{process.pid}/cmdline").read_bytes()
    seen: dict[int, bytes] = {}
    while process.poll() is None:
        for child in set(workshop.processes()) - {process.pid}:
            with suppress(OSError):
                line = Path(f"/proc/{child}/cmdline").read_bytes()
                if line != typed:  # until it has begun its own program, it shows what the user has typed
                    seen[child] = seen.get(child, b"") + line
    done = workshop.wait(process)
    assert done.code == 0, done.errors
    assert len(seen) >= 4, "mpirun and three ranks"
    assert "Database: postgresql+psycopg://marked:***@/marked?host=" in done.output
    said = [done.output, done.errors, *(line.decode() for line in seen.values())]
    (workshop.folder / "c.toml").unlink()  # its words are the user's
    for *words, code in (
        ("report", address, "--files", "folder", 0),
        ("status", address, "--format", "json", 0),
        ("status", address.replace("sand", "mud"), 2),
        ("status", address.replace("%40", "@"), 2),
        ("status", address, address, 2),
    ):
        told = workshop.run(*words)
        assert told.code == code, (words, told.errors)
        said += [told.output, told.errors]
    pg_dump = shutil.which("pg_dump") or next(str(path) for path in Path("/usr/lib/postgresql").glob("*/bin/pg_dump"))
    dump = [pg_dump, "-h", str(postgresql_socket), "-U", "postgres", "marked"]
    said.append(subprocess.run(dump, check=True, capture_output=True, text=True).stdout)
    assert "--ranks 3" in said[-1] or "run c.toml" in said[-1], "the command line is stored"
    netcdf = workshop.folder / "results" / "small.nc"
    said += [str(xr.open_dataset(netcdf).attrs), netcdf.with_suffix(".html").read_text()]
    assert not [text for text in said if MARK in text]
    files = [path for path in workshop.folder.rglob("*") if path.is_file()]
    assert {".nc", ".html", ".csv"} <= {path.suffix for path in files}
    assert not [path for path in files if MARK.encode() in path.read_bytes()]


@pytest.mark.full
@pytest.mark.mpi
def test_the_ways_of_libpq_bring_a_password_to_all_ranks(
    workshop: "Workshop", server: str, postgresql_socket: Path
) -> None:
    """PGPASSWORD, PGPASSFILE, a service file, and the configuration's own address give the password."""
    workshop.configure(seeds=1, contents=(9.0,))
    address = f"postgresql://marked{server}"
    refused = workshop.run("run", "c.toml", "--db", address)
    assert refused.code == 2
    assert "password" in refused.errors
    password_file, services = workshop.folder / "passwords", workshop.folder / "services"
    password_file.write_text(f"*:*:*:marked:{PASSWORD.replace(':', chr(92) + ':')}\n")
    password_file.chmod(0o600)
    services.write_text(
        f"[sand]\nhost={postgresql_socket}\nuser=marked\ndbname=marked\npassword={PASSWORD}\n", encoding="utf-8"
    )
    for variables, database in (
        ({"PGPASSWORD": PASSWORD}, address),
        ({"PGPASSFILE": str(password_file)}, address),
        ({"PGSERVICEFILE": str(services)}, "postgresql://?service=sand"),
    ):
        workshop.variables |= variables
        done = workshop.run("run", "c.toml", "--db", database, "--ranks", "2")
        assert done.code == 0, (variables.keys(), done.errors)
        assert MARK not in done.output + done.errors
        for name in variables:
            del workshop.variables[name]
    text = (workshop.folder / "c.toml").read_text()
    (workshop.folder / "c.toml").write_text(text + f'database = "postgresql://marked:{ESCAPED}{server}"\n')
    done = workshop.run("run", "c.toml", "--ranks", "2")
    assert done.code == 0, done.errors
    assert "Database: postgresql+psycopg://marked:***@" in done.output
    assert MARK not in done.output + done.errors
