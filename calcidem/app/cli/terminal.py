"""What reaches a terminal: text that cannot control it, and a log of what nobody expected. Loads no large library."""

import os
import platform
import sys
import tempfile
import traceback
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from io import TextIOWrapper
from pathlib import Path

from calcidem.storage.passwords import hide_passwords
from calcidem.version import __version__

_ESCAPES = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if chr(code) not in "\n\t"}
"""Control characters (Unicode category Cc, ECMA-48), which move the cursor, colour, or make a terminal answer."""


def printable(text: object) -> str:
    """Text that a terminal shows and does not obey: control characters but line feed and tab as escapes."""
    return str(text).translate(_ESCAPES)


def print_any_text() -> None:
    """Have output written in any encoding: what it lacks, and parts of file names that are no text, as escapes."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def strange_argument(arguments: Sequence[str]) -> str:
    """What is wrong with an argument that has control characters, for a person; empty if none has."""
    for number, argument in enumerate(arguments, 1):
        if (shown := printable(argument)) != argument:
            return f"argument {number} = '{shown}': has control characters; write it without, or rename the file"
    return ""


def log_error(error: BaseException) -> Path | None:
    """Write the traceback into a new file, in this folder or the one for temporary files; None if none can be made."""
    program = f"calcidem {__version__}, Python {platform.python_version()}, {platform.platform()}"
    text = hide_passwords("\n".join([program, repr(sys.argv), "".join(traceback.format_exception(error))]))
    name = f"calcidem-error-{datetime.now(UTC):%Y%m%d-%H%M%S}-{os.getpid()}.log"
    for folder in (Path.cwd, tempfile.gettempdir):
        with suppress(OSError):
            path = Path(folder()) / name
            path.write_text(text, encoding="utf-8", errors="backslashreplace")
            return path
    return None
