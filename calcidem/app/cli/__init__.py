"""Commands beside `init`, `run`, `packing` and `export`, one module each.

They need libraries that take a second or two to load, so only the module of the command that was typed is loaded; all
of them are when it comes to listing them.
"""

from collections.abc import Sequence
from importlib import import_module

import typer

COMMANDS = {
    "status": ("status", "status"),
    "query": ("query", "query"),
    "show": ("report", "show"),
    "analyse": ("report", "analyse_campaign"),
    "report": ("report", "report"),
    "study": ("report", "study"),
    "plan": ("plan", "plan"),
    "retry": ("retry", "retry"),
    "merge": ("merge", "merge"),
    "import": ("import_netcdf", "import_file"),
    "sample": ("sample", "export_sample"),
    "verify": ("verify", "verify_cells"),
    "explain": ("explain", "explain_campaign"),
    "accuracy": ("accuracy", "measure_accuracy"),
    "stability": ("accuracy", "map_stability"),
    "calibrate": ("calibrate", "calibrate_campaign"),
    "sensitivity": ("sensitivity", "measure_sensitivity"),
    "doctor": ("doctor", "doctor"),
}
"""Module of `calcidem.app.cli` and function in it, by the name of the command."""


PRESENT = ("init", "run", "packing", "export")
"""Commands of the command line itself, which load what they need when they run."""


def register(app: typer.Typer, arguments: Sequence[str]) -> None:
    """Add the command that is asked for to an application, or all of them if it is none of those known.

    Parameters
    ----------
    app
        Gets the commands.
    arguments
        Of the command line, without the program's name.
    """
    asked = next((argument for argument in arguments if not argument.startswith("-")), None)
    if asked in PRESENT:
        return
    for name, (module, function) in COMMANDS.items():
        if name == asked or asked not in COMMANDS:
            app.command(name)(getattr(import_module(f"calcidem.app.cli.{module}"), function))
