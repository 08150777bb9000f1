"""The live page in a process of its own, and what a client that is no browser does with it."""

import http.client
import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from places import CHECKOUT

PATIENCE = 60.0
"""Seconds after which an answer counts as missing."""

ADDRESS = re.compile(r"Live page: (http://127\.0\.0\.1:(\d+)/\?token=([\w-]{43}))\n")
"""What is printed."""


@dataclass(frozen=True)
class Live:
    """A running server."""

    process: "subprocess.Popen[str]"
    port: int
    token: str
    databases: tuple[Path, ...]

    @property
    def url(self) -> str:
        """What opens the page."""
        return f"http://127.0.0.1:{self.port}/?token={self.token}"

    def ask(
        self, path: str, method: str = "GET", *, cookie: bool = True, **headers: str
    ) -> tuple[int, dict[str, str], bytes]:
        """Give status, headers and content of an answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        with closing(connection):
            known = {"Cookie": f"calcidem_{self.port}={self.token}"} if cookie else {}
            connection.request(method, path, headers=known | headers)
            answer = connection.getresponse()
            return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()

    def events(self) -> Iterator[tuple[str, dict[str, object]]]:
        """Give what the server tells."""
        with socket.create_connection(("127.0.0.1", self.port), PATIENCE) as connection:
            cookie = f"Cookie: calcidem_{self.port}={self.token}"
            connection.sendall(f"GET /events HTTP/1.1\r\nHost: 127.0.0.1\r\n{cookie}\r\n\r\n".encode())
            with connection.makefile(encoding="utf-8") as lines:
                name = ""
                for line in lines:
                    if line.startswith("event: "):
                        name = line.removeprefix("event: ").strip()
                    elif line.startswith("data: "):
                        yield name, json.loads(line.removeprefix("data: "))


def start(*arguments: object) -> "subprocess.Popen[str]":
    """Start the command."""
    environment = os.environ | {"PYTHONPATH": str(CHECKOUT)}
    command = [sys.executable, "-m", "calcidem", "serve", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


@contextmanager
def serve(*arguments: object) -> Iterator[Live]:
    """Start the command with databases and options, wait for its address, and kill it in the end."""
    process = start(*arguments)
    try:
        assert process.stdout is not None
        address = ADDRESS.fullmatch(process.stdout.readline())
        assert address, process.communicate()
        yield Live(process, int(address[2]), address[3], tuple(Path(one) for one in arguments if isinstance(one, Path)))
    finally:
        process.kill()
        process.wait()
