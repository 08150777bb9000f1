"""Bad input that was reported once, stored text that tries to control a terminal, and errors nobody foresaw."""

import gzip
import io
import os
import sys
from contextlib import redirect_stderr
from pathlib import Path
from typing import NoReturn

import pytest
from workbench import DISKS, EVIL_STORED, OWN_DISKS, TARGETS, Workbench

from calcidem.app.cli.main import main
from calcidem.app.config.presets import preset_text

# What was reported once: command, file own.toml or own.csv, and words of the answer
REPORTED: dict[str, tuple[tuple[str, ...], dict[str, bytes], str]] = {
    "brackets too deep": (("run", "own.toml"), {"own_toml": b"a = " + b"[" * 5000}, "own.toml"),
    "tables too deep": (
        ("run", "own.toml"),
        {"own_toml": b"wave." + b"a." * 900 + b"a = 1"},
        "tables or lists in one another",
    ),
    "a number of 401 digits": (
        ("run", "own.toml"),
        {"own_toml": b"[campaign]\nseeds = 1" + b"0" * 400},
        "more than 64 bits",
    ),
    "a number of 4,400 digits": (("run", "own.toml"), {"own_toml": b"[campaign]\nseeds = 1" + b"0" * 4400}, "not TOML"),
    "a box of 1e308 m": (
        ("run", "own.toml"),
        {"own_toml": b"[packing]\nwidth = 1e308"},
        "packing.width = 1e+308: is out of range",
    ),
    "a box of 1e6 m": (("run", "own.toml"), {"own_toml": b"[packing]\nwidth = 1e6"}, "4.66e+10 disks fit into the box"),
    "a billion seeds": (("run", "own.toml"), {"own_toml": b"[campaign]\nseeds = 1000000000"}, "at most 1000000 seeds"),
    "a zero byte in a path": (("run", "own.toml"), {"own_toml": b'[run]\noutput = "a\\u0000b"'}, "run.output"),
    "a name of 300 letters": (
        ("run", "own.toml"),
        {"own_toml": b'[run]\noutput = "' + b"a" * 300 + b'"'},
        "run.output",
    ),
    "colours in a name": (("run", "own.toml"), {"own_toml": b'[campaign]\nname = "\\u001b[31m"'}, "control characters"),
    "colours in a key": (("run", "own.toml"), {"own_toml": b'["\\u001b[31m"]'}, "unknown section"),
    "UTF-16 without a mark": (
        ("run", "own.toml"),
        {"own_toml": preset_text("quick").encode("utf-16-le")},
        "own.toml is not text (it has zero bytes)",
    ),
    "Latin-1": (
        ("run", "own.toml"),
        {"own_toml": "# Körner".encode("latin-1")},
        "own.toml is not text (byte 4 is not UTF-8, perhaps Latin-1); save the file as UTF-8",
    ),
    "a text that unpacks to too much": (
        ("run", "own.toml"),
        {"own_toml": gzip.compress(bytes(5_000_000))},
        "own.toml has more than 4 MB; check the name",
    ),
    "a damaged deflate stream": (
        ("import", "own.csv", "--out", "new.csv"),
        {"own_csv": gzip.compress(DISKS.encode())[:100] + b"?" * 100},
        "own.csv is damaged and can't be unpacked",
    ),
    "a device of targets": (
        ("calibrate", "good.toml", "--target", "/dev/zero", "--out", "new.toml"),
        {},
        "/dev/zero is a pipe or a device",
    ),
    "a report that is no page": (("report", "quick.db", "--out", "x.pdf"), {}, "give it the ending .html"),
    "a table of no known format": (
        ("query", "quick.db", "--out", "x.xyz"),
        {},
        "ends with none of .json, .csv, .parquet, .txt",
    ),
    "a device of disks": (("init", "a.toml", "--disks", "/dev/zero"), {}, "/dev/zero is a pipe or a device"),
    "a device to import": (("import", "/dev/zero", "--db", "new.db"), {}, "/dev/zero is a pipe or a device"),
    "a device of contacts": (
        ("predict", "quick.db", "--content", "5", "--pattern", "/dev/zero"),
        {},
        "/dev/zero is a pipe or a device",
    ),
    "a file of the kernel": (("run", "/proc/self/mem"), {}, "/proc/self/mem can't be read"),
    "a program": (("run", "own.toml"), {"own_toml": Path(sys.executable).read_bytes()}, "own.toml"),
    "a device": (("run", "/dev/zero"), {}, "/dev/zero is a pipe or a device"),
    "a folder": (("run", "folder"), {}, "folder is a folder; give the name of a file"),
    "a field of 131,073 letters": (
        ("run", "disks.toml"),
        {"own_csv": b"x,y,radius\n" + b"a" * 131_073},
        "line 2: 'aaaaaaaaaaaa",
    ),
    "an open quote": (("run", "disks.toml"), {"own_csv": b'x,y,radius\n"1,2,3\n4,5,6\n'}, "line 2"),
    "a disk at 1e308 m": (
        ("run", "disks.toml"),
        {"own_csv": b"x,y,radius\n0.01,1e308,0.001\n"},
        "line 2: x = 0.01, y = 1e+308",
    ),
    "disks on a device": (
        ("run", "device.toml"),
        {"device_toml": OWN_DISKS.replace("own.csv", "/dev/zero").encode()},
        "device",
    ),
    "a content that is none": (("accuracy", "good.toml", "--content", "nan"), {}, "'nan' is not a content"),
    "an array that is none": (
        ("export", "quick.db", "new.nc", "--without", "paths"),
        {},
        "is not one of 'path', 'section', 'cement'",
    ),
    "an option of disks": (("import", "quick.nc", "--db", "new.db", "--timestep", "0"), {}, "--timestep: leave it out"),
    "an option of a plan": (("sensitivity", "damping", "--db", "quick.db", "--only-table"), {}, "--only-table: leave"),
    "a plan that is a campaign": (
        ("sensitivity", "good.toml", "--db", "new.db"),
        {},
        (
            "configuration: is missing; add it contents: is missing; add it seeds: is missing; add it "
            "campaign: is not known; leave it out"
        ),
    ),
    "two kinds of rehearsal": (("run", "good.toml", "--check", "--packing-only"), {}, "--packing-only: leave it"),
    "a snapshot of a table": (
        ("import", "own.csv", "--out", "new.csv", "--timestep", "3"),
        {"own_csv": DISKS.encode()},
        "has no snapshots",
    ),
    "a pause that is none": (("status", "quick.db", "--watch", "--interval", "nan"), {}, "'nan' is not a number of"),
    "a grain of 20 digits": (
        ("predict", "quick.db", "--content", "5", "--pattern", "own.csv"),
        {"own_csv": b"first,second\n1,10000000000000000000\n"},
        "own.csv: ",
    ),
    "a grain below 0": (
        ("predict", "quick.db", "--content", "5", "--pattern", "own.csv"),
        {"own_csv": b"-1,3\n"},
        "-1 and 3",
    ),
    "a seed of 401 digits": (("query", "quick.db", "--seed", "1" + "0" * 400), {}, "--seed"),
    "a filter of a huge number": (("query", "quick.db", "--where", f"vs < 0x{'f' * 3000}"), {}, "40 cells"),
    "a filter that is none": (("query", "quick.db", "--where", "vs >"), {}, "can't be read"),
    "text and number": (("query", "quick.db", "--where", "status > 3"), {}, "status"),
    "colours in an argument": (("status", "\x1b[31m.db"), {}, "control characters"),
    "the root as a file": (("init", "/"), {}, "/ is a folder or a device"),
    "a file that is there": (("init", "good.toml"), {}, "good.toml"),
    "a sand over a file": (("init", "good.toml", "--grain-size", "1mm"), {}, "good.toml"),
    "a size without unit": (("init", "a.toml", "--grain-size", "3"), {}, "is not a grain size"),
    "another mineral": (("init", "a.toml", "--grain-size", "3mm", "--mineral", "gold"), {}, "quartz, carbonate"),
    "a grading that is none": (("init", "a.toml", "--grading", "good.toml"), {}, "column size: is missing"),
    "a device of sizes": (("init", "a.toml", "--grading", "/dev/zero"), {}, "/dev/zero is a pipe or a device"),
    "a pattern that is none": (
        ("predict", "quick.db", "--content", "5", "--pattern", "own.csv"),
        {"own_csv": b"no contacts"},
        "no line of two grain numbers",
    ),
    "a sand's content": (("init", "a.toml", "--grain-size", "3mm", "--contents", "1,x"), {}, "--contents"),
    "a sand of no size": (("init", "a.toml", "--stress", "20kPa"), {}, "give --grain-size"),
    "disks with a size": (("init", "a.toml", "--disks", "good.toml", "--grain-size", "3mm"), {}, "have their sizes"),
    "disks that are none": (("init", "a.toml", "--disks", "good.toml"), {}, "no column x, y, radius"),
    "a sand and an example": (("init", "a.toml", "--grain-size", "3mm", "--full"), {}, "leave --preset"),
    "a folder to write to": (("query", "quick.db", "--out", "folder"), {}, "folder is a folder or a device"),
    "no file for NetCDF": (("export", "quick.db", "folder"), {}, "folder"),
}


@pytest.mark.parametrize("case", REPORTED)
def test_what_was_reported_is_said_in_a_sentence(bench: Workbench, case: str) -> None:
    """Each input that once ended in a traceback, or in none that helps, is answered in words that name it."""
    words, files, said = REPORTED[case]
    files |= {"disks_toml": OWN_DISKS.encode()} if "disks.toml" in words else {}
    assert said in " ".join(bench.judge(*words, **files).replace("│", " ").split())


@pytest.mark.parametrize(
    "words",
    [
        ("run", "pipe"),
        ("init", "a.toml", "--disks", "pipe"),
        ("calibrate", "good.toml", "--target", "pipe", "--out", "new.toml"),
        ("predict", "quick.db", "--content", "5", "--pattern", "pipe"),
        ("import", "pipe", "--db", "new.db"),
        ("import", "pipe", "--out", "new.csv"),
        ("sensitivity", "pipe", "--db", "new.db"),
        ("report", "quick.db", "--measured", "pipe"),
    ],
)
def test_a_pipe_is_not_waited_for(bench: Workbench, words: tuple[str, ...]) -> None:
    """A pipe without a writer is refused by name, wherever a file is read."""
    os.mkfifo(bench.folder / "pipe")
    try:
        assert "pipe is a pipe or a device; give the name of a file" in bench.judge(*words)
    finally:
        (bench.folder / "pipe").unlink()


@pytest.mark.parametrize("variable", ["OMP_NUM_THREADS", "NUMBA_NUM_THREADS"])
@pytest.mark.parametrize("text", ["0", "abc", "1.5", "9" * 5000])
def test_a_number_of_threads_that_is_none_is_refused(
    bench: Workbench, monkeypatch: pytest.MonkeyPatch, variable: str, text: str
) -> None:
    """The libraries that read it would end in a traceback, or take another number."""
    monkeypatch.setenv(variable, text)
    assert f"{variable}={text}: set it to a whole number from 1" in bench.judge("query", "quick.db")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("name", ["own.toml", "own.csv"])
def test_a_byte_order_mark_is_no_matter(bench: Workbench, name: str, encoding: str) -> None:
    """Files as Windows saves them are read: nothing is said until computing begins."""
    contents = {"own.toml": OWN_DISKS.encode(), "own.csv": DISKS.encode()}
    contents[name] = contents[name].decode().encode(encoding)
    said = bench.judge("run", "own.toml", **{key.replace(".", "_"): content for key, content in contents.items()})
    assert said.startswith("Packing: the disks in")


@pytest.mark.parametrize(
    "line",
    [
        "query quick.db --out quick.db",
        "export quick.db quick.db",
        "report quick.db --with-studies --out quick.db",
        "calibrate good.toml --target own.csv --out quick.db",
        "sensitivity plan.toml --db new.db --out quick.db",
    ],
)
def test_no_command_writes_over_a_database(bench: Workbench, line: str) -> None:
    """Each refuses to before it computes anything, and leaves the database as it was."""
    assert "quick.db is a database" in "".join(bench.judge(*line.split(), own_csv=TARGETS).split("\n"))
    assert (bench.folder / "quick.db").read_bytes() == bench.files["quick.db"]


SHOWN = (
    "status",
    "status --format json",
    "query --columns all",
    "query --format csv --columns reason,host",
    "verify",
)


@pytest.mark.parametrize("line", [*SHOWN, "show --seed 1 --content 0", "query --campaign none"])
def test_stored_text_does_not_control_a_terminal(bench: Workbench, line: str) -> None:
    """Texts of a database are shown with their control characters as escapes, and are no markup."""
    command, *options = line.split()
    bench.judge(command, "evil.db", *options)


def test_a_damaged_export_is_told_as_one(bench: Workbench) -> None:
    """A NetCDF file with bytes lost in the middle of its signals is named, whatever its library says."""
    content = bench.files["quick.nc"]
    middle = len(content) // 2
    damaged = content[:middle] + bytes(2000) + content[middle + 2000 :]
    assert "Error: own.nc is damaged" in bench.judge("import", "own.nc", "--db", "new.db", own_nc=damaged)


def test_check_says_what_would_be_computed_and_does_nothing(bench: Workbench) -> None:
    """`run --check` reads and checks, with the database and the packing where there are any, and makes no file."""
    said = bench.judge("run", "good.toml", "--check")
    assert said.startswith(
        "Campaign quick: 4 seeds x 6 contents = 24 cells; 0 are finished, 21 samples are to be computed."
    )
    assert "results/quick.db, new" in said
    assert "4663 disks; they hold these contents" in said
    assert "20 are finished, 4 samples are to be computed" in bench.judge(
        "run", "good.toml", "--check", "--db", "quick.db"
    )
    assert "Packing: not made yet" in bench.judge("run", "own.toml", "--check", own_toml=b"[packing]\nseed = 99")
    too_much = b"[campaign]\ncontents = [60.0]\n[packing]\nseed = 1\n[wave]\nfrequency = 9e3\n"
    assert "the packing holds at most" in bench.judge("run", "own.toml", "--check", own_toml=too_much)
    assert not (bench.folder / "results").exists()


def test_what_nobody_foresaw_leaves_a_log(bench: Workbench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Any other error ends with 1, one message without a traceback, and the path of a file that has it."""

    def fail(*_arguments: object, **_options: object) -> NoReturn:
        raise ZeroDivisionError(EVIL_STORED)

    monkeypatch.setattr("calcidem.app.campaign.status.CampaignStatus.read", fail)
    with pytest.raises(AssertionError, match="ZeroDivisionError"):
        bench.judge("status", "quick.db")
    (log,) = bench.folder.glob("calcidem-error-*.log")
    assert "Traceback" in log.read_text()
    monkeypatch.setattr("sys.argv", ["calcidem", "status", "quick.db"])
    with redirect_stderr(io.StringIO()) as said, pytest.raises(SystemExit, match="1"):
        main()
    assert "ZeroDivisionError" in said.getvalue()
    assert "calcidem-error-" in said.getvalue()
    assert "\x1b" not in said.getvalue()
    assert "Traceback" not in said.getvalue()
