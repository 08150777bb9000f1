"""Distributed Monte-Carlo campaigns of discrete-element simulations of calcite-cemented sand.

`run` computes a campaign in this process, `open_campaign` reads one, `load_paper_campaign` gives the numbers of the one
that comes with the package; `calcidem.dem` simulates scenes of your own.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    __version__: str
    from calcidem.app.campaign.opened import OpenedCampaign, load_paper_campaign, open_campaign
    from calcidem.app.campaign.run import run

__all__ = ["OpenedCampaign", "load_paper_campaign", "open_campaign", "run"]

_HOMES = {
    "OpenedCampaign": "calcidem.app.campaign.opened",
    "load_paper_campaign": "calcidem.app.campaign.opened",
    "open_campaign": "calcidem.app.campaign.opened",
    "run": "calcidem.app.campaign.run",
}


def __getattr__(name: str) -> object:
    """Import on first use: whoever needs the kernels alone does not wait for the database."""
    if name == "__version__":
        return import_module("importlib.metadata").version("calcidem")
    if name not in _HOMES:
        raise AttributeError(f"module 'calcidem' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)
