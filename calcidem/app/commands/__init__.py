"""Commands beside `init`, `run`, `packing` and `export`, one module each.

They need libraries that take a second or two to load, so only the module of the command that was typed is loaded; all
of them are when it comes to listing them.
"""

from collections.abc import Sequence
from importlib import import_module

import typer

COMMANDS = {
    "status": ("commands.status", "status"),
    "query": ("commands.query", "query"),
    "show": ("commands.report", "show"),
    "analyse": ("commands.report", "analyse_campaign"),
    "report": ("commands.report", "report"),
    "study": ("commands.report", "study"),
    "plan": ("commands.plan", "plan"),
    "retry": ("commands.retry", "retry"),
    "merge": ("commands.merge", "merge"),
    "import": ("commands.import_netcdf", "import_file"),
    "sample": ("commands.export_sample", "export_sample"),
    "verify": ("commands.verify", "verify_cells"),
    "explain": ("commands.explain", "explain_campaign"),
    "accuracy": ("commands.accuracy", "measure_accuracy"),
    "stability": ("commands.accuracy", "map_stability"),
    "calibrate": ("commands.calibrate", "calibrate_campaign"),
    "sensitivity": ("commands.sensitivity", "measure_sensitivity"),
    "doctor": ("commands.doctor", "doctor"),
}
"""Module of `calcidem.app` and function in it, by the name of the command."""


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
            app.command(name)(getattr(import_module(f"calcidem.app.{module}"), function))
