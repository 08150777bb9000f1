"""Everything that users may rely on from version 1.0 on, as the program has it; kept in ``promise.json`` beside.

    python tests/compatibility/promise.py

writes that file anew. Names are added freely. Once the file says ``"released": true``, names go away with a new major
version only: docs/store.md has the rule.
"""

import inspect
import json
import sqlite3
import sys
import tempfile
from contextlib import closing
from pathlib import Path

import netCDF4
import typer
from kept import open_kept

import calcidem
from calcidem import dem
from calcidem.app.campaign.plots import CampaignPlots
from calcidem.app.cli.exit_codes import _EXIT_BAD_INPUT, EXIT_ROUNDING
from calcidem.app.cli.main import PANELS, _build_application
from calcidem.app.config.examples import key_references
from calcidem.storage.netcdf import export_netcdf
from calcidem.storage.sql.store import Store
from calcidem.sweep.schedule import EXIT_ERROR, EXIT_RESUMABLE

FILE = Path(__file__).with_name("promise.json")

Names = dict[str, list[str]]


def promised() -> dict[str, Names]:
    """Names of each kind, in groups."""
    return {
        "python": _python_names(),
        "commands": _commands(),
        "exit codes": {
            "complete, or verify: same bits": ["0"],
            "any other error": [str(EXIT_ERROR)],
            "bad input": [str(_EXIT_BAD_INPUT)],
            "verify: same to rounding": [str(EXIT_ROUNDING)],
            "stopped but resumable": [str(EXIT_RESUMABLE)],
        },
        "configuration": _configuration_keys(),
        "files": _columns_and_variables(),
    }


def _python_names() -> Names:
    """Public names, each with its parameters."""
    members = [("calcidem", calcidem), ("calcidem.dem", dem), ("calcidem.Campaign", calcidem.Campaign)]
    members += [("Campaign.plot", CampaignPlots)]
    found = {}
    for place, owner in members:
        for name in sorted(getattr(owner, "__all__", dir(owner))):
            if not name.startswith("_"):
                found[f"{place}.{name}"] = _parameters(getattr(owner, name))
    return found


def _parameters(kind: object) -> list[str]:
    """Names of what is given in a call; nothing for an error, a constant or a property."""
    if not callable(kind) or (isinstance(kind, type) and issubclass(kind, BaseException)):
        return []
    return [name for name in inspect.signature(kind).parameters if name != "self" and not name.startswith("_")]


def _commands() -> Names:
    """Options of each command, and its arguments in their order."""
    group = typer.main.get_command(_build_application())
    context = group.make_context("calcidem", [], resilient_parsing=True)
    found = {"": sorted(option for parameter in group.params for option in parameter.opts if option[:2] == "--")}
    common = {"--help", "-h", "--quiet", "-q", "--verbose", "-v"}
    found["each"] = sorted(common)
    for name in (name for commands in PANELS.values() for name in commands):
        _, command, _ = group.resolve_command(context, [name])
        options = {o for p in command.params if p.param_type_name == "option" for o in (*p.opts, *p.secondary_opts)}
        arguments = [str(p.metavar or p.name) for p in command.params if p.param_type_name == "argument"]
        found[name] = arguments + sorted(options - common)
    return found


def _configuration_keys() -> Names:
    """Keys of each section."""
    found: Names = {}
    for key in key_references():
        found.setdefault(key.section, []).append(key.name)
    return {section: sorted(keys) for section, keys in found.items()}


def _columns_and_variables() -> Names:
    """Columns of the view of whole cells, and variables of an exported file."""
    with tempfile.TemporaryDirectory() as folder:
        database, exported = open_kept("db", Path(folder)), Path(folder) / "now.nc"
        with Store(database) as store:
            store.use_campaign()
            export_netcdf(store, exported)
        with closing(sqlite3.connect(database)) as connection:
            columns = [row[1] for row in connection.execute("PRAGMA table_info(cells)")]
        with netCDF4.Dataset(exported) as file:
            groups = {"": file} | file.groups
            variables = {f"NetCDF group {name or '/'}": sorted(group.variables) for name, group in groups.items()}
    return {"database view cells": columns} | variables


def lost_names(before: dict[str, Names], now: dict[str, Names]) -> list[str]:
    """Names that were promised and are not there any more."""
    return [
        f"{kind}: {group} {name}".rstrip()
        for kind, groups in before.items()
        for group, names in groups.items()
        for name in ("", *names)
        if group not in now.get(kind, {}) or (name and name not in now[kind][group])
    ]


def main() -> None:
    """Write the file, unless a released name would be missing from it."""
    now = promised()
    kept = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {"released": False, "names": {}}
    major = int(calcidem.__version__.split(".")[0])
    lost = lost_names(kept["names"], now)
    if lost and kept["released"] and major == kept["major"]:
        sys.exit(f"Promised until version {major + 1}: " + "; ".join(lost))
    text = json.dumps({"released": kept["released"], "major": major, "names": now}, indent=1)
    FILE.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
