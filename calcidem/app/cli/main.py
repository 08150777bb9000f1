"""The command `calcidem`."""

import gc
import inspect
import logging
import os
import signal
import sys
import time
import warnings
from collections.abc import Callable
from functools import partial, wraps
from importlib import import_module
from io import TextIOWrapper
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from calcidem.app.cli.options import IS_QUIET, IS_VERBOSE, say
from calcidem.storage.errors import keep_passwords_back
from calcidem.sweep.ranks import THREAD_VARIABLES, launcher, whole_number
from calcidem.version import __version__, source_commit
from calcidem.wording import CampaignWarning, listening, printable

PANELS = {
    "Compute": {
        "init": "Write a configuration to start from.",
        "run": "Compute a campaign, or continue it after a stop.",
    },
    "See results": {
        "status": "Progress, Vs so far, what went wrong; also while it runs.",
        "report": "One HTML page with all tables, figures and cells.",
        "serve": "The same in the browser, live.",
        "query": "Cells that meet conditions, as a table or a file.",
        "show": "One cell: its quantities, why it has no velocity, figures, a movie.",
    },
    "Move data": {
        "export": "A campaign as NetCDF, or one sample for ParaView or as CSV.",
        "import": "An exported campaign, or disks of LAMMPS, YADE or PFC.",
        "merge": "Join databases of one campaign.",
    },
    "Vary and fit": {
        "predict": "Vs of a sample that was not simulated.",
        "sensitivity": "How Vs depends on frequency, damping and other choices.",
        "calibrate": "Fit parameters to measured velocities.",
    },
    "Check the method": {
        "verify": "Compute stored cells again and compare; check for damage.",
        "accuracy": "Error against run time of every setting, and what is left out.",
        "stability": "Extreme values: which are stable, refused or stopped.",
    },
}
"""Short help of each command."""

_MODULES = dict(zip(PANELS, ("run", "results", "exchange", "studies", "studies"), strict=True))
"""Module of the commands of each panel."""

_COMMON_OPTIONS: dict[str, Any] = {
    "quiet": Annotated[bool, typer.Option("--quiet", "-q", help="Write results and errors only.")],
    "verbose": Annotated[bool, typer.Option("--verbose", "-v", help="Also write times, and tracebacks of errors.")],
}
"""Options of every command, by the names of their arguments."""


class _LazyGroup(TyperGroup):
    """Commands whose modules are imported on use, since they need libraries that take seconds to load.

    Click's recipe for a lazy group loads all commands to list their summaries; here `PANELS` has these.
    """

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[Any, Any, list[str]]:  # noqa: ANN401 - Click's own, which typer brings along or does not
        """Replace the entry of the list by the command itself, a function with its docstring as help."""
        name, command, rest = super().resolve_command(ctx, args)
        if name is not None:
            function = command_function(name)
            paragraphs = (" ".join(paragraph.split()) for paragraph in (function.__doc__ or "").split("\n\n"))
            alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
            alone.command(name, help="\n\n".join(paragraphs))(_with_common_options(name, function))
            command = self.commands[name] = typer.main.get_command(alone)
        return name, command, rest


def main() -> None:
    """Entry point: run a command, and report an error in one message."""
    for variable in THREAD_VARIABLES:
        os.environ.setdefault(variable, "1")  # each rank has one core; effective only before numpy is imported
    gc.set_threshold(10_000)  # new objects; Python's 700 cost a tenth of a short command, while libraries load
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # unknown characters, and bytes of file names that are not text
            stream.reconfigure(errors="backslashreplace")
    if launcher() is not None:  # mpirun gives its ranks a pseudo-terminal, even if their output goes to a file
        os.environ["TERM"] = "dumb"
    if sys.argv[1:2] in (["merge"], ["import"], ["export"]):
        _remove_files_on_signals()
    for number, argument in enumerate(sys.argv[1:], 1):
        if (shown := printable(argument)) != argument:
            cure = "has control characters; write it without, or rename the file"
            sys.stderr.write(f"Error: argument {number} = '{shown}': {cure}\n")
            sys.exit(2)
    try:
        for variable in THREAD_VARIABLES:
            whole_number(variable)
        sys.argv[1:] = keep_passwords_back(sys.argv[1:])
        _build_application()()
    except Exception as error:  # noqa: BLE001 - the last resort: whatever it is, it is told in one message
        from calcidem.app.cli.exit_codes import tell_error

        sys.exit(tell_error(error))


def _remove_files_on_signals() -> None:
    """Have SIGTERM and SIGHUP end the command as Ctrl-C does, which removes its temporary files."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:  # not under nohup
            signal.signal(number, lambda received, _frame: sys.exit(128 + received))


def _show_version(wanted: bool) -> None:
    """Write the version, with the commit if known, and end."""
    if wanted:
        commit, changed = source_commit()
        told = f" (commit {commit[:12]}{', changed' if changed else ''})" if commit else ""
        typer.echo(f"calcidem {__version__}{told}")
        raise typer.Exit


def _build_application() -> typer.Typer:
    """Application with a list of all commands; only the used one is imported."""
    application = typer.Typer(
        cls=_LazyGroup,
        help="How much does the shear-wave velocity of sand vary because calcite cements its grains at random places?"
        "\n\nBegin with: calcidem init; calcidem run --ranks 0; calcidem report results/quick.db",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )

    @application.callback()
    def take_options(
        _version: Annotated[
            bool, typer.Option("--version", help="Show the version.", callback=_show_version, is_eager=True)
        ] = False,
    ) -> None:
        """Options of all commands."""

    for panel, commands in PANELS.items():
        for name, summary in commands.items():
            application.command(name, help=summary, rich_help_panel=panel)(lambda: None)
    return application


def command_function(name: str) -> Callable[..., None]:
    """Function `<name>_command` in the module of the command's panel."""
    panel = next(panel for panel, commands in PANELS.items() if name in commands)
    function: Callable[..., None] = getattr(import_module(f"calcidem.app.cli.{_MODULES[panel]}"), f"{name}_command")
    return function


def _with_common_options(name: str, function: Callable[..., None]) -> Callable[..., None]:
    """Function of a command with the options of all commands."""

    @wraps(function)
    def command(*, quiet: bool, verbose: bool, **given: Any) -> None:  # noqa: ANN401 - what the function takes
        IS_QUIET.set(quiet)
        IS_VERBOSE.set(verbose)
        warnings.simplefilter("ignore", CampaignWarning)  # which are written as sentences
        begin = time.perf_counter()
        try:
            with listening(partial(say, err=True), least=logging.ERROR if quiet else logging.INFO):
                function(**given)
        finally:
            if verbose:
                seconds = f"{time.perf_counter() - begin:.2f} s, {time.process_time():.2f} s of CPU"
                sys.stderr.write(f"calcidem {name}: {seconds} with its libraries\n")

    signature = inspect.signature(function)
    options = [
        inspect.Parameter(option, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=annotation)
        for option, annotation in _COMMON_OPTIONS.items()
    ]
    command.__signature__ = signature.replace(parameters=[*signature.parameters.values(), *options])  # type: ignore[attr-defined]  # which typer reads
    command.__annotations__ = function.__annotations__ | _COMMON_OPTIONS
    return command
