"""The live page as a browser and its enemies see it: the real command, on loopback, on a real store."""

import asyncio
import errno
import json
import resource
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import numpy as np
import pytest
from live_page import ADDRESS, PATIENCE, Live, serve, start

from calcidem.analysis.velocity import NOTE_QUANTITIES, notes_on
from calcidem.app.campaign.status import CampaignStatus
from calcidem.app.serve import PageAddress, page_beside_run
from calcidem.app.serve.feed import CampaignFeed, CellColumns
from calcidem.app.serve.server import Hub, LivePage
from calcidem.ends import CellStatus
from calcidem.storage.records import CampaignRecord, CellKey, CellResult, canonical_hash
from calcidem.storage.sql.store import Store, read_campaign

pytestmark = pytest.mark.slow

HOSTILE = """<img src=x onerror=alert(1)>"'`&</script>"""
SEEDS, CONTENTS = (1, 2, 3), (0.0, 5.0)
NUMERICS = {
    "frequency": 8e3,
    "time_step": 1e-7,
    "stability_limit": 1.2e-7,
    "steps": 3000,
    "numerical_error": 0.01,
    "pulse_effect": 0.001,
}


def begin(database: Path | str, name: str = HOSTILE) -> None:
    """Make a database of a campaign none of whose cells is computed."""
    with Store(database) as store:
        store.begin_campaign(CampaignRecord(canonical_hash({}), name, "{}", CONTENTS, SEEDS, datetime.now(UTC)))


def record(database: Path | str, seed: int, content: float, vs: float | None, reason: str = "") -> None:
    """Store an outcome as another process does."""
    status = CellStatus.FAILED if vs is None else CellStatus.DONE
    with Store(database) as store:
        store.use_campaign()
        store.record_results(
            [CellResult(CellKey(seed, content), status, reason, vs=vs, **({} if vs is None else NUMERICS))]
        )


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    """Give a server of one campaign; at a SIGTERM it ends at once, with 0 and without a word."""
    database = tmp_path_factory.mktemp("live") / "campaign.db"
    begin(database)
    with serve(database) as running:
        yield running
        listening = running.events()
        next(listening)  # an open stream does not keep it
        running.process.send_signal(signal.SIGTERM)
        output, errors = running.process.communicate(timeout=5.0)
        assert (running.process.returncode, output, errors) == (0, "", "")
    assert list(database.parent.iterdir()) == [database]


def test_nobody_gets_in_without_the_token(live: Live) -> None:
    """Every address answers 403 without the cookie, with a wrong token, and under a foreign name."""
    for path in ("/", "/page.js", "/events", "/campaigns/0/records", "/campaigns/0/cell?seed=1&content=0", "/nothing"):
        assert live.ask(path, cookie=False)[0] == 403
        assert live.ask(path, cookie=False, Cookie=f"calcidem_{live.port}={'x' * 43}")[0] == 403
        assert live.ask(path, Host="rebound.example")[0] == 403
    assert live.ask("/?token=", cookie=False)[0] == 403
    assert live.ask(f"/?token={live.token[:-1]}%C3%A9", cookie=False)[0] == 403


def test_no_address_changes_anything(live: Live) -> None:
    """Whoever has the cookie can read only, so that pages of other origins cannot make a browser do more."""
    for path in ("/", "/events", "/campaigns/0/records", "/campaigns/0/cell?seed=1&content=0"):
        for method in ("POST", "PUT", "DELETE"):
            assert live.ask(path, method)[0] == 405


def test_the_token_opens_the_page_once_and_then_hides(live: Live) -> None:
    """The printed address gives a cookie that no script reads, and leads to an address without the token."""
    status, headers, _ = live.ask(f"/?token={live.token}", cookie=False)
    assert (status, headers["location"]) == (303, "/")
    assert headers["set-cookie"].startswith(f"calcidem_{live.port}={live.token}; HttpOnly;")
    status, headers, text = live.ask("/")
    assert status == 200
    assert live.token.encode() not in text
    assert headers["referrer-policy"] == "no-referrer"
    assert "default-src 'none'; script-src 'self';" in headers["content-security-policy"]
    assert live.ask("/", Host="localhost:1234")[0] == 200  # through a tunnel
    name = f"calcidem_{live.port}"
    for foreign in ('a={"x":1}', "foo=bar baz", "flag", f"{name}=old"):  # of other pages of the host
        assert live.ask("/", Cookie=f"{foreign}; {name}={live.token}; {foreign}")[0] == 200


def test_a_new_cell_is_told_within_seconds(live: Live) -> None:
    """An outcome that another process stores comes with its numbers, and the status counts it; a name stays data."""
    listening = live.events()
    name, told = next(listening)
    assert (name, told["name"]) == ("status", HOSTILE)
    assert len(unpacked(live.ask("/campaigns/0/records")[2])["seeds"]) == 3
    record(live.databases[0], 2, 5.0, 1234.5)
    for name, told in listening:
        if name == "status" and told.get("cells") == {"done": 1, "pending": 5}:
            break
    record(live.databases[0], 3, 5.0, 1300.0)
    name, told = next((name, told) for name, told in listening if name == "cells")
    assert told["places"] == [2 * 2 + 1]
    assert told["columns"]["vs"] == [1300.0]
    record(live.databases[0], 1, 0.0, None, HOSTILE)
    told = next(told for name, told in listening if name == "status" and told["reasons"])
    assert told["reasons"] == [{"outcome": "failed", "reason": HOSTILE, "contents": [0.0], "cells": 1}]
    records = unpacked(live.ask("/campaigns/0/records")[2])
    assert records["columns"]["vs"] == pytest.approx([np.nan, np.nan, np.nan, 1234.5, np.nan, 1300.0], nan_ok=True)
    assert records["columns"]["status"] == ["failed", "", "", "done", "", "done"]
    assert HOSTILE.encode() not in live.ask("/")[2]


def unpacked(packed: bytes) -> dict[str, dict[str, list[object]]]:
    """Take records apart as the browser does."""
    length = int.from_bytes(packed[:4], "little")
    records = json.loads(packed[4 : 4 + length])
    count = len(records["seeds"]) * len(records["contents"])
    types = {"Float32": "<f4", "Float64": "<f8", "Uint32": "<u4"}
    columns = {}
    for one in records["columns"]:
        assert (4 + length + one["offset"]) % 8 == 0
        values = np.frombuffer(packed, types[one["type"]], count, 4 + length + one["offset"]).tolist()
        columns[one["name"]] = [one["texts"][value] for value in values] if one["type"] == "Uint32" else values
    return records | {"columns": columns}


@pytest.mark.parametrize(
    "path", ["cell?seed=x&content=5", "cell?seed=1", "cell?seed=-1&content=5", "cell?content=nan&seed=1"]
)
def test_nonsense_is_refused(live: Live, path: str) -> None:
    """What names no cell is answered with 400, another campaign or packing with 404."""
    assert live.ask(f"/campaigns/0/{path}")[0] == 400
    assert live.ask("/campaigns/7/records")[0] == 404
    assert live.ask("/campaigns/0/packings/3")[0] == 404
    assert live.ask(f"/campaigns/{'9' * 5000}/records")[0] == 404
    assert live.ask(f"/campaigns/0/packings/{'9' * 5000}")[0] == 404


def test_connections_without_requests_keep_nobody_out(live: Live) -> None:
    """More half-sent requests than the server may have open files: the page answers at once, and its stream goes on."""
    files = resource.RLIMIT_NOFILE
    resource.prlimit(live.process.pid, files, (256, resource.prlimit(live.process.pid, files)[1]))
    with ExitStack() as opened:
        listening = live.events()
        next(listening)
        for number in range(400):
            one = opened.enter_context(socket.create_connection(("127.0.0.1", live.port), PATIENCE))
            one.sendall(b"GET / HTTP/1.1\r\nHost: 127" + b"." * (number % 2))
        begun = monotonic()
        assert live.ask("/")[0] == 200
        assert monotonic() - begun < 5.0
        record(live.databases[0], 3, 0.0, 1250.0)
        assert any(name == "cells" for name, _ in listening)


@pytest.mark.parametrize("ignored", [False, True])
def test_a_closed_terminal_ends_the_page(ignored: bool, tmp_path: Path) -> None:
    """Unless nohup protects it; a packing of a database that is away is answered with 503."""
    begin(database := tmp_path / "campaign.db")
    former = signal.signal(signal.SIGHUP, signal.SIG_IGN if ignored else signal.SIG_DFL)
    try:
        with serve(database) as running:
            database.unlink()
            assert running.ask("/campaigns/0/packings/0")[0] == 503
            running.process.send_signal(signal.SIGHUP)
            if ignored:
                assert running.ask("/")[0] == 200
                running.process.send_signal(signal.SIGTERM)
            output, errors = running.process.communicate(timeout=5.0)
            assert (running.process.returncode, output, errors) == (0, "", "")
    finally:
        signal.signal(signal.SIGHUP, former)


@pytest.mark.full
def test_a_half_sent_request_is_not_waited_for(live: Live) -> None:
    """Neither bytes that come one by one, nor an answer before, keep a connection."""
    begun = monotonic()
    with socket.create_connection(("127.0.0.1", live.port), PATIENCE) as one:
        one.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\nGET / HT")
        assert one.recv(65536).startswith(b"HTTP/1.1 403")
        with suppress(ConnectionError):
            while monotonic() - begun < 60.0:
                one.sendall(b"x")
                sleep(0.5)
    assert 9.0 < monotonic() - begun < 30.0


def test_a_port_in_use_is_refused(tmp_path: Path, invoke: Callable[..., str]) -> None:
    """The message has option, value and cure; so has that of a database which is not there."""
    database = tmp_path / "campaign.db"
    begin(database)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        process = start(database, "--port", str(port))
        errors = process.communicate(timeout=PATIENCE)[1]
    assert process.returncode == 2
    assert errors == f"Error: --port {port} is in use on 127.0.0.1; give another, or 0 for any that is free\n"
    assert "less than or equal to 65535" in invoke("serve", database, "--port", "70000", exit_code=2)


def command_lines() -> set[bytes]:
    """Give the command lines of all processes; one may end while it is looked at."""
    lines = set()
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            lines.add(path.read_bytes())
    return lines


def test_a_password_of_a_configuration_is_in_no_command_line() -> None:
    """The page beside a run does not show the password of the database's URL."""
    said: list[str] = []
    with page_beside_run("postgresql://nobody:MARKED-SECRET@127.0.0.1:1/none", "small", said.append):
        assert ADDRESS.fullmatch(f"{said[0]}\n")
        # A process that has begun a program has no command line for a moment.
        begun, lines = monotonic(), command_lines()
        while not any(b"calcidem.app.serve.server" in line for line in lines):
            assert monotonic() - begun < PATIENCE
            lines = command_lines()
    assert not any(b"MARKED-SECRET" in line for line in lines)


def test_a_feed_notices_whatever_happens_to_its_database(tmp_path: Path) -> None:
    """Cells that are pending again, a wider plan and a file in the place of another are seen; a status is the same."""
    database = tmp_path / "campaign.db"
    feed = CampaignFeed(0, str(database), None)
    feed.refresh()
    assert "does not exist" in feed.status()["problem"]
    begin(database, "first")
    record(database, 1, 5.0, None, "no memory")
    record(database, 2, 5.0, 1000.0)
    feed.refresh()
    assert feed.status()["problem"] == ""
    assert feed.status()["cells"] == CampaignStatus.read(database).counts == {"done": 1, "failed": 1, "pending": 4}
    with Store(database) as store:
        store.use_campaign()
        store.retry([CellStatus.FAILED])
    feed.refresh()
    assert feed.status()["cells"] == {"done": 1, "pending": 5}
    with Store(database) as store:
        store.use_campaign()
        store.extend((4, 5), (9.0,))
    feed.refresh()
    assert sum(feed.status()["cells"].values()) == 8
    database.unlink()
    begin(database, "second")
    feed.refresh()
    assert (feed.status()["name"], feed.status()["cells"]) == ("second", {"pending": 6})
    feed.close()


@pytest.mark.parametrize("kind", [PermissionError, BlockingIOError, OSError])
def test_a_database_that_cannot_be_read_for_a_while_is_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: type[OSError]
) -> None:
    """The page keeps what it has, says of when that is, and goes on once the file system answers."""
    database = tmp_path / "campaign.db"
    begin(database, "first")
    record(database, 1, 5.0, 1000.0)
    hub = Hub([CampaignFeed(0, str(database), None)])

    async def look() -> dict[str, Any]:
        await hub.refresh()
        return hub.feeds[0].status()

    def fail(*_: object, **__: object) -> None:
        raise kind(errno.EIO, "Input/output error")

    assert asyncio.run(look())["problem"] == ""
    with monkeypatch.context() as broken:
        broken.setattr(Path, "stat", fail)
        told = asyncio.run(look())
    assert "Input/output error" in told["problem"]
    assert "Shown is what was read at 20" in told["problem"]
    assert told["cells"] == {"done": 1, "pending": 5}
    record(database, 2, 5.0, 1000.0)
    told = asyncio.run(look())
    assert told["problem"] == ""
    assert told["cells"] == {"done": 2, "pending": 4}
    hub.close()


def test_an_error_of_the_watching_ends_the_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No task dies unseen: a page of old data would be taken for a new one."""
    database = tmp_path / "campaign.db"
    begin(database)

    def fail(_: CampaignFeed) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(CampaignFeed, "refresh", fail)
    with pytest.raises(ZeroDivisionError):
        LivePage([(str(database), None)], PageAddress.take()).serve()


@pytest.mark.full
def test_a_server_database_is_shown_without_its_password(postgresql_socket: Path) -> None:
    """A campaign on PostgreSQL is told cell by cell; the password of its URL is in nothing that is printed or sent."""
    psycopg = pytest.importorskip("psycopg")
    with psycopg.connect(f"host={postgresql_socket} user=postgres dbname=postgres", autocommit=True) as connection:
        connection.execute("CREATE DATABASE live")
    url, mark = "postgresql://postgres{}@/live?host=" + str(postgresql_socket), "o7-mark-7o"
    begin(url.format(""), "sand")
    with serve(url.format(f":{mark}")) as live:
        listening = live.events()
        said = [next(listening)]
        assert said[0][1]["name"] == "sand"
        record(url.format(""), 2, 5.0, 1234.5)
        while said[-1][1].get("cells") != {"done": 1, "pending": 5}:
            said.append(next(listening))
        pages = [live.ask(path)[2] for path in ("/", "/campaigns/0/records", "/campaigns/0/cell?seed=2&content=5")]
        live.process.send_signal(signal.SIGINT)
        output, errors = live.process.communicate(timeout=5.0)
    assert (live.process.returncode, output, errors) == (0, "", "")
    assert str(said[0][1]["database"]).startswith("postgresql")
    assert mark not in repr(said)
    assert not any(mark.encode() in page for page in pages)


def test_columns_are_those_of_the_store(tmp_path: Path) -> None:
    """Cells put in piece by piece are what a query of all gives, in its order."""
    database = tmp_path / "campaign.db"
    begin(database)
    for seed in SEEDS:
        record(database, seed, 5.0, 1000.0 + seed)
    names = ("seed", "content", "status", "vs", "reason", "steps")
    with Store(database, read_only=True) as store:
        store.use_campaign()
        rows = store.table(names)
        columns = CellColumns.empty(store.table(("seed", "content")), names[2:])
        assert columns.put(rows) == [1, 3, 5]
    found = columns.rows(names)
    for name in names[:4]:
        np.testing.assert_array_equal(found[name], rows[name])
    assert columns.put(rows) == []
    assert columns.settled() == 3


def test_a_feed_warns_as_the_report_does(small_database: Path) -> None:
    """Of near field and selection bias."""
    feed = CampaignFeed(0, str(small_database), None)
    with read_campaign(small_database) as store:
        wanted = notes_on(store.table(NOTE_QUANTITIES))
    assert wanted
    assert feed.status()["notes"] == wanted
    feed.close()
