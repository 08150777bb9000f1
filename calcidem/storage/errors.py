"""Errors of the store, each with cause and remedy; passwords of databases are hidden in all shown or stored text."""

import json
import os
import re
from collections.abc import Sequence
from urllib.parse import unquote_plus


class StoreError(Exception):
    """Base of all errors of the store.

    Attributes
    ----------
    problem : str
        The cause, with the place (file or URL) and the value.
    cure : str
        The remedy.
    """

    def __init__(self, problem: str, cure: str) -> None:
        super().__init__(f"{problem} {cure}")
        self.problem = problem
        self.cure = cure

    def __reduce__(self) -> tuple[type["StoreError"], tuple[str, str]]:
        """Pickle with both arguments, so that an error can be sent between MPI ranks."""
        return type(self), (self.problem, self.cure)


class StoreLockedError(StoreError):
    """Another process kept the database locked for longer than the waiting time."""


class DiskError(StoreError):
    """Reading or writing the file failed: the disk is full, a quota, or a network."""


class ReadOnlyStoreError(StoreError):
    """The file, its folder or the server session doesn't allow writing."""


class StoreUnavailableError(StoreError):
    """The file can't be opened, or the database server can't be reached."""


class StoreInterruptedError(StoreUnavailableError):
    """The server ended an open connection: it was restarted, or the network failed."""


class ForeignDatabaseError(StoreError):
    """The file or database exists but was not made by calcidem."""


class OtherSchemaError(StoreError):
    """An earlier or later calcidem wrote the database or file; this version does not read its tables."""


class DamagedStoreError(StoreError):
    """The file's content is damaged."""


DAMAGE_REMEDY = (
    "It was not written to. Move it away, check the disk, and 'calcidem import' an earlier export into a new "
    "database, or compute the campaign again; 'sqlite3 FILE .recover' saves what can be read."
)
"""Remedy for a damaged database."""


class OutputRefusedError(StoreError):
    """A file to write has the name of a database or of another file, an unknown format, or was replaced meanwhile."""


class CampaignMismatchError(StoreError):
    """A campaign has another physical configuration, packing or outcome of a cell in another database or file."""


class UnknownCampaignError(StoreError):
    """The store has no such campaign, or several of which one has to be named."""


class UnknownCellError(StoreError):
    """A cell that is not part of the campaign's plan."""


class InvalidRecordError(StoreError):
    """The database's constraints refused a record."""


class QueryError(StoreError):
    """A filter expression that can't be understood."""


class LeaseHeldError(StoreError):
    """Another process is the master of this campaign."""


class LeaseLostError(StoreError):
    """Another process has taken over the campaign; this one must not write any more."""


PASSWORDS_VARIABLE = "CALCIDEM_PASSWORDS"
"""Variable with URLs by their form without passwords, as JSON; only the same user can read the environment."""

_IN_URL = re.compile(r"(\w[\w+.-]*://[^\s:/@?]*):([^@]*)@")
"""Scheme and user, and the password between the colon and the first @, as SQLAlchemy reads them."""

_ANY_IN_URL = re.compile(r"(\w[\w+.-]*://[^\s:/@?]*):([^\n]*)@([^\s'\"]*)")
"""As `_IN_URL`, but up to the last @ of the line, so in doubt more is hidden; and the rest of the URL."""

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
