"""Errors that are the user's to cure: told in one message without a traceback, with the exit code they mean."""

from calcidem.app.config.errors import ConfigurationError
from calcidem.dem.sample.packing import PackingError
from calcidem.storage.errors import (
    CampaignMismatchError,
    ForeignDatabaseError,
    NewerSchemaError,
    OlderSchemaError,
    StoreError,
    StoreUnavailableError,
    UnknownCampaignError,
    UnknownCellError,
)
from calcidem.sweep import EXIT_ERROR, LaunchError

_EXIT_BAD_INPUT = 2
"""Bad configuration or arguments."""

EXIT_ROUNDING = 3
"""`calcidem verify`: what is stored is what is computed, but for rounding."""

USER_ERRORS = (ConfigurationError, LaunchError, PackingError, StoreError, OSError)

_BAD_INPUT = (
    CampaignMismatchError,
    ConfigurationError,
    FileExistsError,
    FileNotFoundError,
    ForeignDatabaseError,
    LaunchError,
    NewerSchemaError,
    OlderSchemaError,
    StoreUnavailableError,
    UnknownCampaignError,
    UnknownCellError,
)


def exit_code_of(error: BaseException) -> int:
    """Exit code of a program that ends because of an error."""
    return _EXIT_BAD_INPUT if isinstance(error, _BAD_INPUT) else EXIT_ERROR
