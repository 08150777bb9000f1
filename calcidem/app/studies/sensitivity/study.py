"""Computing the variants, or what is left of them, and reading what is there."""

from collections.abc import Callable, Sequence

import xarray as xr

from calcidem.analysis.sensitivity import Change, compare
from calcidem.app.campaign.run import run
from calcidem.app.studies.sensitivity.plan import Variant
from calcidem.storage.campaign import open_stored_campaign
from calcidem.storage.errors import UnknownCampaignError


def compute(variants: Sequence[Variant], say: Callable[[str], None]) -> None:
    """Compute all cells that the database lacks, variant by variant; the same call goes on after a stop.

    Parameters
    ----------
    variants
        Of one plan.
    say
        Told of every variant.

    Raises
    ------
    CampaignMismatchError
        If the database has a variant of that name with other parameters.
    """
    for number, variant in enumerate(variants, start=1):
        say(f"{number} of {len(variants)}: {variant.name}")
        run(variant.configuration).close()


def velocities(variant: Variant) -> xr.DataArray | None:
    """Vs of the planned cells of a variant, m/s along (seed, content); None if nothing of it was computed."""
    plan = variant.configuration.campaign
    try:
        with open_stored_campaign(variant.configuration.database, variant.name) as campaign:
            # A database may hold more, from an earlier plan.
            return campaign.vs().reindex(seed=list(plan.seed_numbers), content=sorted(plan.contents))
    except UnknownCampaignError:
        return None


def changes(variants: Sequence[Variant]) -> dict[str, tuple[Change, ...]]:
    """Compare every computed variant with what it is an alternative to, by its name."""
    found = {variant.name: velocities(variant) for variant in variants}
    compared = {}
    for variant in variants:
        own, other = found[variant.name], found[variant.against]
        if own is not None and other is not None:
            compared[variant.name] = compare(own, other)
    return compared
