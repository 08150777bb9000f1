"""The sensitivity studies of a stored campaign, run with its own packing and parameters."""

import os
from collections.abc import Callable, Sequence

import xarray as xr

from calcidem.app.campaign.packing import stored_packing
from calcidem.app.config.schema import Configuration
from calcidem.app.studies.frequency_and_damping import damping_study, frequency_study
from calcidem.storage.campaign import open_stored_campaign

STUDIES: dict[str, Callable[..., xr.Dataset]] = {"frequency": frequency_study, "damping": damping_study}


def run_studies(
    database: str | os.PathLike[str],
    names: Sequence[str] = ("frequency", "damping"),
    *,
    contents: Sequence[float] | None = None,
    campaign_name: str | None = None,
    check: Callable[[], None] = lambda: None,
) -> dict[str, xr.Dataset]:
    """Run sensitivity studies on the samples of a campaign; nothing is written to its database.

    Parameters
    ----------
    database
        SQLite file or database URL of a campaign whose packing is stored.
    names
        Studies, "frequency" and "damping".
    contents
        Percent; by default those of the study.
    campaign_name
        Which campaign, where the database has several.
    check
        Called every fraction of a second; may raise to end the study.

    Returns
    -------
    dict
        Result of each study, as `calcidem.app.report.write_report` takes them.

    Raises
    ------
    ValueError
        If a study is unknown, or the campaign cannot be computed again from what is stored.
    """
    unknown = sorted(set(names) - set(STUDIES))
    if unknown:
        raise ValueError(f"study {unknown[0]!r} does not exist; choose from {', '.join(STUDIES)}")
    with open_stored_campaign(database, campaign_name) as campaign:
        experiment = Configuration.from_physics(campaign.config).experiment(stored_packing(campaign.packing()))
    chosen = {} if contents is None else {"contents": tuple(contents)}
    return {name: STUDIES[name](experiment, check=check, **chosen) for name in names}
