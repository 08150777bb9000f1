"""A small real database, and the commands as users type them."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from calcidem.app.campaign.opened import OpenedCampaign, open_campaign
from calcidem.app.cli.main import build_application
from calcidem.storage.sql.store import open_store

TUTORIAL = Path(__file__).parents[3] / "docs" / "tutorial"


@pytest.fixture(scope="session")
def database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the tutorial's database, in the present schema; tests only read it."""
    path = Path(shutil.copy(TUTORIAL / "quick.db", tmp_path_factory.mktemp("tutorial")))
    open_store(path).close()
    return path


@pytest.fixture
def campaign(database: Path) -> Iterator[OpenedCampaign]:
    """Open the campaign of that database."""
    with open_campaign(database) as opened:
        yield opened


@pytest.fixture
def invoke() -> Callable[..., str]:
    """Run a command line that must succeed and give what it prints."""

    def run(*arguments: object, exit_code: int = 0) -> str:
        words = [str(argument) for argument in arguments]
        result = CliRunner().invoke(build_application(words), words)
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        assert result.exit_code == exit_code, result.output
        return result.output

    return run
