"""Passwords in URLs of databases: removed from command lines, and hidden in all shown or stored text."""

import json
import os
import re
from collections.abc import Sequence
from urllib.parse import unquote_plus

from calcidem.storage.errors import StoreUnavailableError

PASSWORDS_VARIABLE = "CALCIDEM_PASSWORDS"
"""Variable with URLs by their form without passwords, as JSON; only the same user can read the environment."""

_IN_URL = re.compile(r"(\w[\w+.-]*://[^\s:/@?]*):([^@]*)@")
"""Scheme and user, and the password between the colon and the first @, as SQLAlchemy reads them."""

_ANY_IN_URL = re.compile(r"(\w[\w+.-]*://[^\s:/@?]*):([^\s'\"]*)@([^\s'\"]*)")
"""As `_IN_URL`, but up to the last @, so in doubt more is hidden; and the rest of the URL."""

_PAIR = re.compile(r"""([\w%+.-]+)(\s*=\s*)('(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|[^&\s'"]+)""")
"""Key and value in the query of a URL, or in a connection string."""


def hide_passwords(text: str) -> str:
    """Return a text in which ``***`` replaces each password of a URL or a connection string."""

    def without_user_password(found: re.Match[str]) -> str:
        return f"{found[1]}:***@{'' if '?' in found[2] else found[3]}"

    def without_value(found: re.Match[str]) -> str:
        return f"{found[1]}{found[2]}***" if _is_secret(found[1]) else found[0]

    return _PAIR.sub(without_value, _ANY_IN_URL.sub(without_user_password, text))


def keep_passwords_back(words: Sequence[str]) -> list[str]:
    """Return the words of a command line without the passwords in URLs, and put these URLs into the environment.

    Command lines are visible in lists of processes, error messages and campaigns. `with_passwords` finds the passwords
    in this process and in processes that it starts. `StoreUnavailableError` if the end of a password is unclear.
    """
    kept: dict[str, str] = {}
    shown = []
    for word in words:
        option, equals, url = word.partition("=") if word.startswith("-") else ("", "", word)
        bare = _without_passwords(url) if "://" in url else url
        kept |= {bare: url} if bare != url else {}
        shown.append(f"{option}{equals}{bare}")
    if kept:
        os.environ[PASSWORDS_VARIABLE] = json.dumps(_kept_back() | kept)
    return shown


def with_passwords(url: str) -> str:
    """Return a URL with the passwords that were removed from it."""
    return _kept_back().get(url, url)


def _kept_back() -> dict[str, str]:
    try:
        return {str(bare): str(url) for bare, url in json.loads(os.environ.get(PASSWORDS_VARIABLE, "{}")).items()}
    except (ValueError, AttributeError):
        raise StoreUnavailableError(
            f"{PASSWORDS_VARIABLE} in the environment is not what calcidem writes there.", "Unset it."
        ) from None


def _is_secret(key: str) -> bool:
    """Whether the value of a key, which may have escapes, is secret: those that PostgreSQL's library hides."""
    return unquote_plus(key).strip().lower().endswith(("password", "passwd", "secret", "scram_client_key"))


def _without_passwords(url: str) -> str:
    found = _IN_URL.match(url)
    shown = url if found is None else f"{found[1]}@{url[found.end() :]}"
    address, mark, query = shown.partition("?")
    if found is not None and ("@" in address[len(found[1]) + 1 :] or "?" in found[2]):
        raise StoreUnavailableError(
            f"{hide_passwords(url)}: it is not clear where the password ends.",
            "Write an @ in a password as %40, and a ? as %3F.",
        )
    pairs = [pair for pair in query.split("&") if not _is_secret(pair.partition("=")[0])]
    return f"{address}{mark if any(pairs) else ''}{'&'.join(pairs)}"
