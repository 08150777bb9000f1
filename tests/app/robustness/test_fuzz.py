"""No input ends in a traceback: configurations, tables of disks and of targets, filters and arguments of any kind.

Commands are used as from a shell, in this process, up to where they would begin to compute.
"""

import gzip
import json
import os
import socket
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, fields
from datetime import date
from enum import Enum
from functools import cache
from inspect import Signature, signature
from pathlib import Path
from random import Random
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.models import OptionInfo
from workbench import DISKS, OWN_DISKS, PLAN, TARGETS, Workbench

from calcidem.app.cli import main as command_line
from calcidem.app.cli.main import command_function
from calcidem.app.config.presets import preset_text
from calcidem.app.config.schema import SECTIONS

PRESET = tomllib.loads(preset_text("quick"))
KEYS = sorted({field.name for types in SECTIONS.values() for kind in types.values() for field in fields(kind)})

EVIL_TEXT: tuple[str, ...] = (
    *("", " ", ".", "..", "/", "~nobody/x", "\x1b[31mred\x1b[0m", "\x9b2J", "a\0b", "a\nb", "[/red]", "nan", "ä" * 300),
    *("\u202e", "a" * 300, "a" * 5000, "%s{0}", "-1", "1e999", "9" * 5000, "quick.db", "folder", "sqlite://", "x://y"),
)
EVIL_NUMBERS: tuple[float, ...] = (
    *(0, -1, 1, 2**53 + 1, 2**63 - 1, 2**63, 10**400, -(10**400), 1_000_000, 1_000_001),
    *(0.0, -0.0, 1e308, -1e308, 5e-324, 1e-30, 1e30, 1e12, float("nan"), float("inf"), float("-inf"), 0.5, 3.0, 100.0),
)

scalars = st.one_of(
    st.sampled_from(EVIL_NUMBERS),
    st.sampled_from(EVIL_TEXT),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=8),
    st.just(date(2026, 1, 1)),
)
values = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(KEYS) | st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=8,
)


def toml(value: object) -> str:
    """Value in TOML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    if isinstance(value, str | bool):
        return json.dumps(value)
    return str(value) if isinstance(value, int | date) else repr(value)


# Inputs


@st.composite
def configurations(draw: st.DrawFn) -> bytes:
    """Draw a preset in which some keys, types and values are others."""
    document: dict[str, Any] = {section: dict(entries) for section, entries in PRESET.items()}
    for _ in range(draw(st.integers(1, 3))):
        section = draw(st.sampled_from(sorted(SECTIONS)))
        known = sorted({field.name for kind in SECTIONS[section].values() for field in fields(kind)})
        key = draw(st.sampled_from(known) if draw(st.integers(0, 9)) else st.sampled_from(EVIL_TEXT))
        document.setdefault(section, {})[key] = draw(values)
    if not draw(st.integers(0, 9)):
        document[draw(st.sampled_from(EVIL_TEXT))] = draw(values)
    text = "".join(
        f"[{json.dumps(name)}]\n" + "".join(f"{json.dumps(key)} = {toml(value)}\n" for key, value in entries.items())
        if isinstance(entries, dict)
        else f"{json.dumps(name)} = {toml(entries)}\n"
        for name, entries in sorted(document.items(), key=lambda item: isinstance(item[1], dict))
    )
    return text.encode()


def spoiled(content: bytes, pieces: tuple[bytes, ...] = ()) -> st.SearchStrategy[bytes]:
    """Draw a file's content with bytes lost, changed and added."""
    noise = st.binary(max_size=12) | st.sampled_from(
        (b"\0", b"\x1b[2J", b"\xff\xfe", b"\xef\xbb\xbf", b"\n", b'"', b"," * 9, b"9" * 5000, b"[" * 2000, *pieces)
    )
    edit = st.tuples(st.integers(0, len(content)), st.integers(0, 30), noise)

    def apply(edits: list[tuple[int, int, bytes]]) -> bytes:
        changed = content
        for start, length, added in edits:
            changed = changed[:start] + added + changed[start + length :]
        return changed

    encodings = st.sampled_from(("utf-8", "utf-8-sig", "utf-16", "utf-32", "latin-1"))
    recoded = encodings.map(lambda name: content.decode().encode(name, "replace"))
    return st.one_of(st.lists(edit, min_size=1, max_size=4).map(apply), st.binary(max_size=60), recoded)


CELLS = (
    b"1e308",
    b"nan",
    b"-inf",
    b"1e999",
    b"a" * 131_073,
    b'"',
    b"1_0",
    b"",
    b"-1",
    b"0",
    b"0.0011",
    b"\x1b[31m",
    b"x,y,radius",
)

QUANTITIES = ("vs", "seed", "content", "status", "reason", "steps", "host")
WORDS = (
    *(
        "vs",
        "seed",
        "content",
        "status",
        "reason",
        "steps",
        "host",
        "None",
        "1",
        "-1",
        "'done'",
        "1e400",
        "'",
        '"',
        ",",
    ),
    *(" > ", " == ", " in ", " is ", " and ", " or ", " not ", "(", ")", "[", "]", "0x" + "f" * 3000, "9" * 400),
    *("-" * 300, "(" * 250, "not " * 300, "vs > 1 or " * 300, *EVIL_TEXT),
)
filters = st.lists(st.sampled_from(WORDS), max_size=9).map("".join) | st.text(max_size=30)


@dataclass(frozen=True)
class Parameter:
    """Argument or option of a command.

    Attributes
    ----------
    word
        Name in the function.
    option
        Empty for an argument.
    """

    word: str
    option: str
    kind: type
    required: bool


@cache
def parameters(command: str) -> tuple[Parameter, ...]:
    """Arguments and options of a command."""
    function = command_function(command)
    found = []
    for name, hint in get_type_hints(function, include_extras=True).items():
        if name == "return":
            continue
        plain, declared = get_args(hint) if get_origin(hint) is Annotated else (get_args(hint)[0].__origin__, None)
        declared = declared or get_args(get_args(hint)[0])[1]
        kind = next(part for part in (*get_args(plain), plain) if part is not type(None))
        kind = (get_args(kind) or (kind,))[0]
        words = (
            declared.default,
            *(declared.param_decls or ()),
        )  # the first of Option("--name") is in the default's place
        names = [word for word in words if isinstance(word, str) and word.startswith("--")]
        option = (names or [f"--{name.replace('_', '-')}"])[0] if isinstance(declared, OptionInfo) else ""
        required = signature(function).parameters[name].default is Signature.empty
        found.append(Parameter(name, option, kind, required))
    return tuple(found)


PATHS: tuple[str, ...] = (
    *(
        "good.toml",
        "quick.db",
        "evil.db",
        "quick.nc",
        "empty",
        "noise",
        "folder",
        "missing",
        "missing/x",
        "targets.csv",
    ),
    *("good.csv", "new.nc", "new.db", "new.vtu", "new.csv", "quick.db/x", "sqlite:///new.db", "folder/new.html"),
    *("good.toml.bak", "postgresql+psycopg://nobody@127.0.0.1:1/none"),
)

PLAUSIBLE = {
    "database": ("quick.db", "quick.db", "evil.db"),
    "db": ("quick.db",),
    "sources": ("quick.db",),
    "configuration": ("good.toml",),
    "plan": ("plan.toml", "good.toml"),
    "target": ("targets.csv", "0.5%"),
    "out": ("new.nc", "new.csv", "new.vtu", "new.html", "folder", "new.toml"),
    "netcdf": ("new.nc", "quick.nc"),
    "file": ("quick.nc", "new.toml"),
    "content": ("5", "0.66"),
    "campaign": ("quick",),
    "columns": ("all", "seed,vs", "vs,status", "reason,host"),
    "sort": ("-vs", "seed,-content"),
    "where": ("vs > 1300", "status == 'done'", "vs is None", "seed in (1, 2)"),
    "only": ("step_fraction 0.4", "precision float64"),
    "parameter": ("sand.wave_stiffness_factor", "cement.bond_modulus=1e9:1e12", "pattern.p_share"),
}
"""What people give, by the name of the function's parameter."""


def command_line_of(number: int) -> list[str]:
    """One of very many command lines: most of its arguments are plausible."""
    random = Random(number)
    # A right line of `serve` serves until it is stopped.
    name = random.choice([name for panel in command_line.PANELS.values() for name in panel if name != "serve"])
    words = [name]
    for parameter in parameters(name):
        value = random.choice(PLAUSIBLE.get(parameter.word, PATHS))
        if issubclass(parameter.kind, Enum):
            value = str(random.choice(list(parameter.kind)))
        elif issubclass(parameter.kind, int | float):
            value = random.choice(("1", "2", "3", "5", "0.66", "5.0"))
        if random.random() < 0.1:
            drawn = "".join(
                chr(random.choice((random.randrange(1, 256), random.randrange(1, 0xD800)))) for _ in range(4)
            )
            value = random.choice((random.choice(EVIL_TEXT).replace("\0", ""), str(random.choice(EVIL_NUMBERS)), drawn))
        if random.random() < 0.1:
            value = random.choice(PATHS)
        if not parameter.option:
            words += [value] if random.random() < 0.97 else []
        elif random.random() < (0.97 if parameter.required else 0.3):
            words += [parameter.option] if parameter.kind is bool else [parameter.option, value]
    return words


command_lines = st.integers(0, 2**40).map(command_line_of)


# What is done with them


def use_configuration(bench: Workbench, content: bytes) -> None:
    """Begin to compute it."""
    bench.judge("run", "own.toml", own_toml=content)


def use_disks(bench: Workbench, content: bytes) -> None:
    """Begin a campaign on the disks of a file."""
    text = OWN_DISKS.encode()
    bench.judge("run", "own.toml", own_toml=text, own_csv=content)


def use_targets(bench: Workbench, content: bytes) -> None:
    """Begin to fit a campaign to a table."""
    bench.judge("calibrate", "good.toml", "--target", "own.csv", "--out", "new.toml", own_csv=content)


def use_filter(bench: Workbench, text: str) -> None:
    """Ask for the cells that meet a condition."""
    bench.judge("query", "quick.db", "--where", text)


def use_words(bench: Workbench, words: list[str]) -> None:
    """Type them."""
    bench.judge(*words)


def use_plan(bench: Workbench, content: bytes) -> None:
    """Begin to compute the variants of a plan."""
    bench.judge("sensitivity", "own.toml", "--db", "new.db", own_toml=content)


@dataclass(frozen=True)
class Subject:
    """A kind of input.

    Attributes
    ----------
    inputs
        From which it is drawn.
    use
        What is done with it.
    few, many
        How many are tried in the default run and in the full one.
    """

    inputs: st.SearchStrategy[Any]
    use: Callable[[Workbench, Any], None]
    few: int
    many: int


SUBJECTS = {
    "configurations": Subject(configurations(), use_configuration, 20, 400),
    "bytes of a configuration": Subject(spoiled(preset_text("quick").encode()), use_configuration, 4, 150),
    "tables of disks": Subject(spoiled(DISKS.encode(), CELLS), use_disks, 15, 200),
    "tables of targets": Subject(spoiled(TARGETS, CELLS), use_targets, 8, 100),
    "plans of variants": Subject(spoiled(PLAN), use_plan, 10, 100),
    "filters": Subject(filters, use_filter, 20, 400),
    "command lines": Subject(command_lines, use_words, 12, 600),
}


def fuzz(bench: Workbench, subject: Subject, count: int, *, always_the_same: bool) -> None:
    """Try so many inputs of a kind."""

    @settings(
        max_examples=count,
        deadline=None,
        derandomize=always_the_same,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(subject.inputs)
    def try_input(drawn: object) -> None:
        subject.use(bench, drawn)

    try_input()


@pytest.mark.parametrize("subject", SUBJECTS)
def test_no_input_ends_in_a_traceback(bench: Workbench, subject: str) -> None:
    """Some inputs of each kind are taken or refused in sentences, with exit code 2."""
    fuzz(bench, SUBJECTS[subject], SUBJECTS[subject].few, always_the_same=True)


@pytest.mark.full
@pytest.mark.parametrize("subject", SUBJECTS)
def test_no_input_of_thousands_ends_in_a_traceback(bench: Workbench, subject: str) -> None:
    """The same for 2,000 inputs, others each time."""
    fuzz(bench, SUBJECTS[subject], SUBJECTS[subject].many, always_the_same=False)


# Damaged and odd files of every kind, and command lines, always the same

READERS: tuple[tuple[str, ...], ...] = (
    ("run", "own.toml"),
    ("run", "own.toml", "--check"),
    ("accuracy", "own.toml"),
    ("sensitivity", "own.plan", "--db", "new.db"),
    ("run", "disks.toml"),
    ("init", "new.toml", "--disks", "own.csv"),
    ("import", "own.csv", "--out", "new.csv"),
    ("import", "own.dump", "--out", "new.csv"),
    ("calibrate", "good.toml", "--target", "own.targets", "--out", "new.toml"),
    ("report", "quick.db", "--measured", "own.targets"),
    ("predict", "quick.db", "--content", "5", "--pattern", "own.pattern"),
    ("import", "own.nc", "--db", "new.db"),
    ("status", "own.db"),
    ("query", "own.db"),
    ("export", "own.db", "new.nc"),
    ("merge", "quick.db", "own.db", "--out", "new.db"),
    ("verify", "own.db", "--integrity"),
)
"""Commands that read a file: the word that begins with ``own`` is its name, or `disks.toml` names it."""

DUMP = "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n90\nITEM: BOX BOUNDS ff ff ff\n0 0.02\n0 0.03\n0 0\n"
DUMP += "ITEM: ATOMS id type x y z radius\n"
DUMP += "".join(
    f"{n} 1 {','.join(line.split(',')[:2]).replace(',', ' ')} 0 0.001\n" for n, line in enumerate(DISKS.split()[1:])
)


def damaged(random: Random, content: bytes) -> bytes:
    """Content with some damage, or in other wrapping."""
    for _ in range(random.randint(1, 3)):
        place, length = random.randrange(len(content) + 1), random.choice((1, 1, 4, 30, 2000))
        noise = random.choice(
            (random.randbytes(length), bytes(length), b"9" * length, b"\xff\xfe", b'"', b"[" * length)
        )
        content = random.choice(
            (
                content[:place],
                content[:place] + noise + content[place + length :],
                content[:place] + noise + content[place:],
                content[:place] + content[place + length :],
                gzip.compress(content),
                content.decode("latin-1").encode(random.choice(("utf-8-sig", "utf-16", "utf-16-be", "utf-32"))),
                content,
            )
        )
    return content


def odd_files(folder: Path) -> tuple[Path, ...]:
    """Names of what is no ordinary file, or a very large one."""
    os.mkfifo(folder / "pipe")
    (folder / "loop").symlink_to(folder / "loop")
    (folder / "zero").symlink_to("/dev/zero")
    with (folder / "sparse").open("wb") as file:
        file.truncate(10**12)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(folder / "socket"))
    kernel = ("/dev/zero", "/dev/null", "/dev/full", "/proc/self/mem", "/proc/self/maps", "/proc/kmsg", "/proc/version")
    return (*folder.iterdir(), *map(Path, kernel), folder, Path("missing"))


def damaged_input(bench: Workbench, odd: tuple[Path, ...], number: int) -> tuple[list[str], dict[str, bytes]]:
    """One of very many command lines and the files that it reads: a quarter is of odd files, half of damaged ones."""
    random = Random(number)
    whole = {
        "own.toml": bench.files["good.toml"],
        "own.plan": bench.files["plan.toml"],
        "own.csv": DISKS.encode(),
        "own.dump": DUMP.encode(),
        "own.targets": TARGETS,
        "own.pattern": b"first,second\n1,2\n5,7\n",
        "own.nc": bench.files["quick.nc"],
        "own.db": bench.files["quick.db"],
    }
    words = list(random.choice(READERS))
    name = next((word for word in words if word.startswith("own.")), "own.csv")
    if number % 4 == 0:
        return command_line_of(number), {}
    if number % 4 == 1:
        words = [str(random.choice(odd)) if word == name else word for word in words]
        return words, {"disks_toml": OWN_DISKS.replace("own.csv", str(random.choice(odd))).encode()}
    return words, {name.replace(".", "_"): damaged(random, whole[name]), "disks_toml": OWN_DISKS.encode()}


@pytest.mark.full
def test_two_thousand_damaged_files_and_command_lines(bench: Workbench, tmp_path: Path) -> None:
    """Each ends with a documented code and in sentences, without waiting, and a refusal leaves every file as it was."""
    odd, wrong = odd_files(tmp_path), []
    for number in range(2000):
        words, files = damaged_input(bench, odd, number)
        try:
            bench.judge(*words, **files)
        except UnicodeDecodeError:
            pass  # Parquet on the standard output
        except AssertionError as error:
            wrong.append(f"{number}: {words}: {str(error)[:1000]}")
    assert not wrong, f"{len(wrong)} of 2000: " + "\n".join(wrong)
