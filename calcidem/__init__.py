"""Distributed Monte-Carlo campaigns of discrete-element simulations of calcite-cemented sand.

Compute a campaign in this process and summarise it:

>>> import calcidem
>>> with calcidem.run("quick.toml", set={"campaign.seeds": 2}) as campaign:  # doctest: +SKIP
...     print(campaign.summary())

`run` computes a campaign, `open_campaign` reads a stored one, and `load_paper_campaign` returns the numbers of the
paper's campaign, which the package contains. `load_configuration` reads and checks a TOML file, and `preset_text`
returns one of the examples in `PRESETS`. `import_packing` imports disks of another program, and `read_signal` reads
velocities from a signal of a laboratory.
`calcidem.dem` simulates scenes of your own. `ConfigurationError`, `PackingError`, `StoreError`, `LaunchError` and
`WorkersLostError` name the problem and a remedy. Sentences are records of the logger ``calcidem``, advice is also a
`CampaignWarning`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from calcidem.version import __version__ as __version__

if TYPE_CHECKING:
    from calcidem import dem as dem
    from calcidem.app.campaign.opened import Campaign as Campaign
    from calcidem.app.campaign.opened import load_paper_campaign as load_paper_campaign
    from calcidem.app.campaign.opened import open_campaign as open_campaign
    from calcidem.app.campaign.run import run as run
    from calcidem.app.campaign.status import RunProgress as RunProgress
    from calcidem.app.campaign.status import RunStage as RunStage
    from calcidem.app.config.presets import PRESETS as PRESETS
    from calcidem.app.config.presets import preset_text as preset_text
    from calcidem.app.config.reader import load_configuration as load_configuration
    from calcidem.app.config.schema import Configuration as Configuration
    from calcidem.app.config.schema import ConfigurationError as ConfigurationError
    from calcidem.app.disks import import_packing as import_packing
    from calcidem.app.studies.laboratory_signal import read_signal as read_signal
    from calcidem.dem.sample.packing import PackingError as PackingError
    from calcidem.storage.errors import StoreError as StoreError
    from calcidem.sweep.schedule import LaunchError as LaunchError
    from calcidem.sweep.schedule import WorkersLostError as WorkersLostError
    from calcidem.wording import CampaignWarning as CampaignWarning

_HOMES = {
    "Campaign": "calcidem.app.campaign.opened",
    "CampaignWarning": "calcidem.wording",
    "PRESETS": "calcidem.app.config.presets",
    "Configuration": "calcidem.app.config.schema",
    "ConfigurationError": "calcidem.app.config.schema",
    "LaunchError": "calcidem.sweep.schedule",
    "PackingError": "calcidem.dem.sample.packing",
    "RunProgress": "calcidem.app.campaign.status",
    "RunStage": "calcidem.app.campaign.status",
    "StoreError": "calcidem.storage.errors",
    "WorkersLostError": "calcidem.sweep.schedule",
    "import_packing": "calcidem.app.disks",
    "load_configuration": "calcidem.app.config.reader",
    "load_paper_campaign": "calcidem.app.campaign.opened",
    "open_campaign": "calcidem.app.campaign.opened",
    "preset_text": "calcidem.app.config.presets",
    "read_signal": "calcidem.app.studies.laboratory_signal",
    "run": "calcidem.app.campaign.run",
}

__all__ = ["dem", *_HOMES]  # noqa: PLE0604 - names of a table


def __getattr__(name: str) -> object:
    """Import on first use, so that users of the kernels do not load the database."""
    if name == "dem":
        return import_module("calcidem.dem")
    if name not in _HOMES:
        raise AttributeError(f"module 'calcidem' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    """All public names, imported or not."""
    return sorted({*(name for name in globals() if name.startswith("_")), *__all__})
