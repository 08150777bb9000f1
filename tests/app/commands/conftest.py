"""A small real database, and the commands as users type them."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from places import TUTORIAL

from calcidem.app.campaign.opened import Campaign, open_campaign
from calcidem.storage.sql.store import Store


@pytest.fixture(scope="session")
def database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the tutorial's database, in the present schema; tests only read it."""
    path = Path(shutil.copy(TUTORIAL, tmp_path_factory.mktemp("tutorial")))
    Store(path).close()
    return path


@pytest.fixture
def campaign(database: Path) -> Iterator[Campaign]:
    """Open the campaign of that database."""
    with open_campaign(database) as opened:
        yield opened
