"""Passwords in URLs of databases: removed from command lines, and hidden in all shown or stored text."""

import json
import os
import re
from collections.abc import Sequence
from urllib.parse import unquote

from calcidem.storage.errors import StoreUnavailableError

PASSWORDS_VARIABLE = "CALCIDEM_PASSWORDS"
"""Variable with passwords by URL, as JSON; only the same user can read the environment."""

_IN_URL = re.compile(r"(\w[\w+.-]*://[^\s:/@?]*):([^@]*)@")
"""Scheme and user, and the password between the colon and the first @, as SQLAlchemy reads them."""

_IN_QUERY = re.compile(r"([?&])password=([^&\s]*)&?", re.IGNORECASE)

_ANY_IN_URL = re.compile(r"(\w[\w+.-]*://[^\s:/@?]*):[^\s'\"]*@")
"""As `_IN_URL`, but up to the last @, so in doubt more is hidden."""

_ANY_IN_TEXT = re.compile(r"(\bpassword\s*=\s*)('(?:[^'\\]|\\.)*'|[^&\s'\"]+)", re.IGNORECASE)


def hide_passwords(text: str) -> str:
    """Return a text in which ``***`` replaces each password of a URL or a connection string."""
    return _ANY_IN_TEXT.sub(r"\1***", _ANY_IN_URL.sub(r"\1:***@", text))


def keep_passwords_back(words: Sequence[str]) -> list[str]:
    """Return the words of a command line without the passwords in URLs, and put these into the environment.

    Command lines are visible in lists of processes, error messages and campaigns. `password_of` finds the passwords in
    this process and in processes that it starts. `StoreUnavailableError` if the end of a password is unclear.
    """
    kept: dict[str, str] = {}
    shown = [_without_password(word, kept) for word in words]
    if kept:
        os.environ[PASSWORDS_VARIABLE] = json.dumps(_kept_back() | kept)
    return shown


def password_of(url: str) -> str | None:
    """Return the password that was removed from a URL, without escapes; None without one."""
    kept = _kept_back().get(url)
    return None if kept is None else unquote(kept)


def _kept_back() -> dict[str, str]:
    kept: dict[str, str] = json.loads(os.environ.get(PASSWORDS_VARIABLE, "{}"))
    return kept


def _without_password(word: str, kept: dict[str, str]) -> str:
    """Remove the password from a word, which may be an option with a URL as its value."""
    option, equals, url = word.partition("=") if word.startswith("-") else ("", "", word)
    found = _IN_URL.match(url)
    shown = url if found is None else f"{found[1]}@{url[found.end() :]}"
    in_query = _IN_QUERY.search(shown) if "://" in shown else None
    if in_query is not None:
        shown = _IN_QUERY.sub(r"\1", shown).rstrip("?&")
    if found is not None and "@" in shown[len(found[1]) + 1 :].partition("?")[0]:
        raise StoreUnavailableError(
            f"{hide_passwords(url)}: it is not clear where the password ends.", "Write an @ in a password as %40."
        )
    password = found[2] if found is not None else in_query[2] if in_query is not None else None
    if password is None:
        return word
    kept[shown] = password
    return f"{option}{equals}{shown}"
