"""Commands beside `init`, `run`, `packing`, `status` and `export`, one module each.

They need libraries that take a second or two to load, so only the module of the command that was typed is loaded; all
of them are when it comes to listing them.
"""

from collections.abc import Sequence
from importlib import import_module

import typer

COMMANDS = {
    "query": ("query", "query"),
    "show": ("report", "show"),
    "analyse": ("report", "analyse_campaign"),
    "report": ("report", "report"),
    "plan": ("plan", "plan"),
    "retry": ("retry", "retry"),
    "merge": ("merge", "merge"),
    "import": ("import_netcdf", "import_file"),
    "sample": ("export_sample", "export_sample"),
    "verify": ("verify", "verify_cells"),
    "explain": ("explain", "explain_campaign"),
    "accuracy": ("accuracy", "accuracy"),
    "stability": ("stability", "stability"),
    "calibrate": ("calibrate", "calibrate_campaign"),
    "doctor": ("doctor", "doctor"),
}
"""Module here and function in it, by the name of the command."""


def register(app: typer.Typer, arguments: Sequence[str], present: Sequence[str]) -> None:
    """Add the command that is asked for to an application, or all of them if it is none of those present.

    Parameters
    ----------
    app
        Gets the commands.
    arguments
        Of the command line, without the program's name.
    present
        Names of the commands that the application has already.
    """
    asked = next((argument for argument in arguments if not argument.startswith("-")), None)
    if asked in present:
        return
    for name, (module, function) in COMMANDS.items():
        if asked in (name, None) or asked not in COMMANDS:
            app.command(name)(getattr(import_module(f"{__name__}.{module}"), function))
