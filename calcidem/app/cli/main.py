"""The command `calcidem`."""

import ast
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.resources import files

import typer

from calcidem.app.cli.terminal import print_any_text, printable, strange_argument

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")

COMMANDS = (
    *("init", "run", "packing", "export", "status", "query", "show", "analyse", "report", "study", "plan"),
    *("retry", "merge", "import", "sample", "verify", "explain", "accuracy", "stability", "calibrate"),
    *("sensitivity", "doctor"),
)

_COMPLETION_VARIABLES = ("COMP_WORDS", "_TYPER_COMPLETE_ARGS")
"""One of them has the words typed so far when a shell asks how they could go on."""


def main() -> None:
    """Entry point: run a command, and tell an error in one message."""
    for variable in _THREADS:
        os.environ.setdefault(variable, "1")  # each rank has one core; it counts only before numpy is loaded
    warnings.formatwarning = _format_warning
    typed = " ".join(os.environ.get(variable, "") for variable in _COMPLETION_VARIABLES)
    print_any_text()
    if wrong := strange_argument(sys.argv[1:]):
        sys.stderr.write(f"Error: {wrong}\n")
        sys.exit(2)
    try:
        build_application(sys.argv[1:] or typed.split()[1:])()
    except Exception as error:  # noqa: BLE001 - the last resort: whatever it is, it is told in one message
        from calcidem.app.cli.exit_codes import tell_error  # noqa: PLC0415 - loads numerical libraries

        sys.exit(tell_error(error))


def build_application(arguments: Sequence[str]) -> typer.Typer:
    """Application with the command that the arguments begin with, or with a list of all of them.

    Commands need libraries that take seconds to load, so only the module of the one asked for is imported. What a list
    shows of the others is read from their sources.
    """
    application = typer.Typer(
        help="How much does the shear-wave velocity of sand vary because calcite cements its grains at random places?",
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    application.callback()(lambda: None)  # without it typer takes a single command for the whole application
    asked = arguments[0] if arguments else ""
    for name in [asked] if asked in COMMANDS else COMMANDS:
        function: Callable[..., None] = lambda: None  # noqa: E731 - the list calls none of them
        if name == asked:
            function = getattr(import_module(f"calcidem.app.cli.{_module_name(name)}"), f"{name}_command")
        application.command(name, help=command_description(name))(function)
    return application


def _module_name(command: str) -> str:
    """Module of `calcidem.app.cli` with a command."""
    return "import_" if command == "import" else command


def command_description(command: str) -> str:
    """Docstring of a command, a line for each paragraph, without importing its module."""
    source = files("calcidem.app.cli").joinpath(f"{_module_name(command)}.py").read_text(encoding="utf-8")
    functions = (node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef))
    text = next(ast.get_docstring(node) or "" for node in functions if node.name == f"{command}_command")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.split("\n\n"))


def _format_warning(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
) -> str:
    """One line for what is meant for users, and where it comes from for all other warnings."""
    if issubclass(category, FutureWarning):
        return printable(f"Warning: {message}\n")
    return printable(f"{filename}:{lineno}: {category.__name__}: {message}\n" + (f"  {line}\n" if line else ""))


if __name__ == "__main__":
    main()
