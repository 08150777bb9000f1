"""The command line: what it writes, what it refuses, and how it ends."""

import os
import pty
import re
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, get_type_hints

import pytest
import typer
import xarray as xr
from places import CHECKOUT, TUTORIAL

import calcidem
from calcidem.app.cli.main import PANELS, command_function
from calcidem.app.cli.options import say

if TYPE_CHECKING:
    from conftest import Workshop

pytestmark = pytest.mark.slow

COMMANDS = [name for panel in PANELS.values() for name in panel]


def test_help_and_typos_do_not_wait_for_numerical_libraries() -> None:
    """What computes nothing, the help of each command included, loads none of the libraries that take seconds."""
    program = """
import sys
from typer.testing import CliRunner
from calcidem.app.cli.main import _build_application
application = _build_application()
heavy = {"matplotlib", "mpi4py.MPI", "numba", "pandas", "scipy", "sqlalchemy", "xarray"}
for *words, code, said in [
    ("--help", 0, "sensitivity"),
    ("--version", 0, "calcidem "), ("rnu", 2, "'rnu'"),
    ("query", "--lmit", "3", 2, "--limit"),
    *((name, "--help", 0, f"calcidem {name} ") for name in sys.argv[1:]),
]:
    shown = CliRunner().invoke(application, words, prog_name="calcidem")
    assert (shown.exit_code, said in shown.output) == (code, True), (words, shown.output)
    assert not heavy & set(sys.modules), (words, heavy & set(sys.modules))
"""
    command = [sys.executable, "-c", program, *COMMANDS]
    variables = os.environ | {"PYTHONPATH": str(CHECKOUT)}
    done = subprocess.run(command, check=False, env=variables, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_ranks_do_not_wait_for_what_only_reads_and_reports() -> None:
    """Before its first cell a rank loads no library of statistics, tables or graphs."""
    program = """
import sys
import calcidem.app.campaign.run, calcidem.sweep.ranks, calcidem.app.cli.views, calcidem.app.config.reader
heavy = {"matplotlib", "netCDF4", "networkx", "pandas", "scipy.signal", "scipy.stats", "xarray"}
assert not heavy & set(sys.modules), heavy & set(sys.modules)
"""
    variables = os.environ | {"PYTHONPATH": str(CHECKOUT)}
    done = subprocess.run([sys.executable, "-c", program], check=False, env=variables, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("words", "found"),
    [("st", "status stability"), ("query --co", "--content --columns")],
)
def test_the_shell_completes_commands_and_options(words: str, found: str) -> None:
    """`calcidem st<TAB>` has status and stability, and does not wait for numerical libraries."""
    program = """
import sys
sys.modules |= dict.fromkeys(("numba", "scipy", "sqlalchemy", "xarray"))  # importing them fails
sys.argv[0] = "calcidem"
from calcidem.app.cli.main import main
main()
"""
    variables = {"_CALCIDEM_COMPLETE": "complete_bash", "COMP_WORDS": f"calcidem {words}"}
    variables |= {"COMP_CWORD": str(len(words.split())), "PYTHONPATH": str(CHECKOUT)}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, check=True, env=os.environ | variables, capture_output=True, text=True)
    assert done.stdout.split() == found.split()


def shown_on_a_terminal(arguments: list[str], **variables: str) -> str:
    """What the command writes on a pseudo-terminal, with these variables."""
    master, slave = pty.openpty()
    names = {"CI", "FORCE_COLOR", "GITHUB_ACTIONS", "NO_COLOR"}
    kept = {name: value for name, value in os.environ.items() if name not in names}
    process = subprocess.Popen(
        [sys.executable, "-m", "calcidem", *arguments],
        stdout=slave,
        stderr=slave,
        env=kept | {"PYTHONPATH": str(CHECKOUT), "TERM": "xterm-256color"} | variables,
    )
    os.close(slave)
    shown = b""
    with suppress(OSError):  # Linux ends a terminal that nobody writes any more with an error
        while data := os.read(master, 1 << 16):
            shown += data
    os.close(master)
    assert process.wait() == 0, shown
    return shown.decode()


def test_escape_codes_are_for_terminals() -> None:
    """A terminal gets colours, with NO_COLOR none; a rank of mpirun, whose terminal is none, gets no escape at all."""
    colour = re.compile(r"\x1b\[[0-9;]*3[0-7]m")
    assert colour.search(shown_on_a_terminal(["run", "--help"]))
    assert not colour.search(shown_on_a_terminal(["run", "--help"], NO_COLOR="1"))
    assert "\x1b" not in shown_on_a_terminal(["run", "--help"], OMPI_COMM_WORLD_SIZE="3")


def test_prose_breaks_between_words_on_a_terminal_alone(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No word or number is cut, indented lines stay indented, and a pipe has one line for each sentence."""
    text = "0 are finished, 13 samples\n  76.4 GB are free in /a/folder/with/a/long-name"
    say(text)
    assert capsys.readouterr().out == f"{text}\n"
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "18")
    say(text)
    assert capsys.readouterr().out.splitlines() == [
        *("0 are finished, 13", "samples", "  76.4 GB are free", "  in", "  /a/folder/with/a/long-name")
    ]


def test_every_command_can_be_quiet_or_tell_more(workshop: "Workshop") -> None:
    """--quiet leaves notes out, --verbose adds the time and the traceback of an error; both are results as before."""
    workshop.configure()
    (workshop.folder / "quick.db").write_bytes(TUTORIAL.read_bytes())
    plain, told = (workshop.run("query", "quick.db", *options) for options in ((), ("--verbose",)))
    assert told.output == plain.output
    assert "calcidem query: " in told.errors
    assert "s of CPU" in told.errors
    failed = workshop.run("query", "none.db", "-v")
    assert failed.code == 2
    assert "Traceback" in failed.errors


@pytest.mark.parametrize("name", COMMANDS)
def test_no_option_takes_what_is_no_number(name: str) -> None:
    """Options of real numbers refuse nan and infinities, those of whole numbers have a smallest one."""
    for option, hint in get_type_hints(command_function(name), include_extras=True).items():
        for information in getattr(hint, "__metadata__", ()):
            shown = str(hint.__origin__)
            if "float" in shown:
                assert information.parser is not None, option
                for text in ("nan", "inf", "-inf", "1e999", ""):
                    with pytest.raises(typer.BadParameter):
                        information.parser(text)
            elif "int" in shown:
                assert information.min is not None, option


def test_init_writes_what_run_reads_and_keeps_what_is_there(workshop: "Workshop") -> None:
    """`init` writes calcidem.toml, refuses to write it again, and writes the other preset on demand."""
    assert workshop.run("init").code == 0
    text = (workshop.folder / "calcidem.toml").read_text(encoding="utf-8")
    assert 'name = "quick"' in text
    again = workshop.run("init")
    assert again.code == 2
    assert "calcidem.toml" in again.errors
    assert "Traceback" not in again.errors
    assert (workshop.folder / "calcidem.toml").read_text(encoding="utf-8") == text
    assert workshop.run("init", "paper.toml", "--preset", "paper").code == 0
    assert "seeds = 116" in (workshop.folder / "paper.toml").read_text(encoding="utf-8")
    assert workshop.run("init", "own.toml", "--grain-size", "1mm", "--stress", "20kPa", "--contents", "0,3").code == 0
    assert "2 contents = 8 cells" in workshop.run("run", "own.toml", "--check").output
    lattice = [f"{column}.5e-3,{row}.5e-3,5e-4" for row in range(30) for column in range(30)]
    (workshop.folder / "disks.csv").write_text("\n".join(["x,y,radius", *lattice]), encoding="utf-8")
    assert workshop.run("init", "disks.toml", "--disks", "disks.csv").code == 0
    assert "if its disks are loose" in workshop.run("run", "disks.toml", "--check").output


def test_a_campaign_from_run_to_export(workshop: "Workshop", invoke: Callable[..., str]) -> None:
    """`run` reports packing, velocities and paths; `status` and `export` find what it stored."""
    gentle = "amplitude = 1e-4\ntransmitter_half_width = 0.01"
    short = f"{gentle}\n[wave.frequency]\ncontent = [0.0, 0.66]\nfrequency = [17e3, 17e3]"
    workshop.configure(seeds=2, contents=(0.1, 0.66), wave=short)
    database = workshop.folder / "elsewhere" / "mine.db"
    done = workshop.run("run", "c.toml", "--db", str(database), "--output", "out")
    assert done.code == 0, done.errors
    assert "coordination number" in done.output
    assert "2/2" in done.output
    assert str(database.with_suffix(".nc")) in done.output
    assert "\x1b" not in done.output, "no colours and no bar without a terminal"
    with xr.open_dataset(database.with_suffix(".nc")) as exported, calcidem.open_campaign(database) as campaign:
        assert exported["vs"].equals(campaign.vs())
        assert campaign.vs().notnull().any()
        assert campaign.to_xarray(["effective_vs"])["effective_vs"].notnull().all()
    status = invoke("status", database)
    assert "2 seeds x 2 contents" in status
    assert "Run 1" in status
    invoke("export", database, workshop.folder / "again.nc")
    assert (workshop.folder / "again.nc").exists()


def test_the_packing_can_be_made_alone(workshop: "Workshop") -> None:
    """`packing` reports on the packing and makes no database."""
    workshop.configure()
    done = workshop.run("run", "c.toml", "--packing-only")
    assert done.code == 0, done.errors
    assert "porosity" in done.output
    assert not workshop.database.exists()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("status", "none.db"), 2, "none.db does not exist"),
        (("status", "c.toml"), 2, "c.toml: file is not a database"),
        (("run", "c.toml", "--ranks", "-1"), 2, "--ranks"),
        (("run", "c.toml", "--rank", "2"), 2, "--ranks"),
        (("frobnicate",), 2, "frobnicate"),
        (("init", "none/c.toml"), 2, "none/c.toml"),
    ],
)
def test_wrong_arguments_are_refused_without_a_traceback(
    workshop: "Workshop", arguments: tuple[str, ...], code: int, words: str
) -> None:
    """What cannot be done is said in one message that names it."""
    workshop.configure()
    refused = workshop.run(*arguments)
    assert refused.code == code
    assert words in refused.errors
    assert "Traceback" not in refused.errors


def test_a_content_over_the_maximum_leaves_no_database(workshop: "Workshop") -> None:
    """What only the packing can tell is refused after it is made and before anything else is."""
    table = "frequency = { content = [0.0, 90.0], frequency = [4e3, 25e3] }"
    workshop.configure(contents=(0.0, 60.0), wave=table)
    refused = workshop.run("run", "c.toml")
    assert refused.code == 2
    assert "campaign.contents = [0.0, 60.0]: the packing holds at most" in refused.errors
    assert not workshop.database.exists()


def test_run_in_process_gives_the_campaign(
    workshop: "Workshop", monkeypatch: pytest.MonkeyPatch, expected: dict[tuple[int, float], tuple[object, ...]]
) -> None:
    """`calcidem.run` computes without MPI, gives the open campaign, and the same bits as the command."""
    monkeypatch.setenv("CALCIDEM_CACHE", str(workshop.cache))
    workshop.configure(seeds=(2, 3), contents=(5.0,))
    with calcidem.run(workshop.folder / "c.toml", db=workshop.database) as campaign:
        assert campaign.vs().shape == (2, 1)
    assert workshop.cells() == {key: cell for key, cell in expected.items() if key in {(2, 5.0), (3, 5.0)}}


@pytest.mark.parametrize("name", COMMANDS)
def test_no_help_text_has_markup(name: str) -> None:
    """Square brackets before a letter are marks to the renderer of --help, which leaves the word out."""
    hints = get_type_hints(command_function(name), include_extras=True).values()
    texts = [text for hint in hints for note in getattr(hint, "__metadata__", ()) for text in (note.help, note.metavar)]
    assert not [text for text in (command_function(name).__doc__, *texts) if re.search(r"\[[a-z/#@]", text or "")]
