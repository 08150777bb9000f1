"""Checks that a stored campaign is the expected one, with cells of this program's physics."""

from typing import TYPE_CHECKING

from calcidem.app.config.schema import PHYSICS_VERSION, Configuration
from calcidem.storage.errors import CampaignMismatchError
from calcidem.storage.records import CampaignRecord

if TYPE_CHECKING:
    from calcidem.storage.sql.store import Store  # which the ranks do not need


def physics_version(record: CampaignRecord) -> object:
    """`PHYSICS_VERSION` of the program that computed a stored campaign."""
    return record.parameters.get("physics_version", "unknown")


def refuse_other_physics(record: CampaignRecord, configuration: Configuration | None = None) -> None:
    """Raise `CampaignMismatchError` unless a campaign was computed with this program's `PHYSICS_VERSION`.

    If a configuration is given, the physics must be the same, too.
    """
    stored = physics_version(record)
    if stored != PHYSICS_VERSION:
        raise CampaignMismatchError(
            f"The campaign '{record.name}' was computed with physics version {stored}, this calcidem has version "
            f"{PHYSICS_VERSION}: the same cells get other bits.",
            "Its results can be read, reported and exported as before. Use the calcidem that computed it for more "
            "cells or to verify it, or begin a new database.",
        )
    if configuration is not None:
        record.refuse_other(configuration.record())


def choose_campaign(store: "Store", configuration: Configuration) -> bool:
    """Choose the configuration's campaign in a store; return whether the store has it.

    `CampaignMismatchError` if it has another campaign of that name, or this campaign under another name.
    """
    name = configuration.campaign.name
    for record in store.campaigns():
        if record.name == name:
            refuse_other_physics(record, configuration)
            store.use_campaign(name)
            return True
    for record in store.campaigns():
        if record.hash == configuration.hash:
            raise CampaignMismatchError(
                f"campaign.name = '{name}': the database has this campaign under the name '{record.name}'.",
                f"Set campaign.name to '{record.name}', or give another database.",
            )
    return False
