"""The workers of a Dask cluster as an executor."""

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager, suppress

from calcidem.sweep.sweep_end import LaunchError

_CONNECT_TIMEOUT = 10.0
"""Seconds in which the scheduler has to answer."""

_TIME_TO_CLOSE = 3.0
"""Seconds in which it cancels running batches; one that has died does not answer."""


@contextmanager
def dask_executor(address: str) -> Iterator[Executor]:
    """Connect to a scheduler, and cancel in the end the batches that its workers have not begun.

    `LaunchError` if no scheduler answers at the address, or Dask is not installed.
    """
    try:
        from distributed import Client  # noqa: PLC0415 - an extra of the package
    except ImportError as error:
        raise LaunchError(f"--dask {address}: Dask is missing ({error}); pip install 'calcidem[dask]'") from error
    try:
        client = Client(address, timeout=_CONNECT_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:  # a time-out is an OSError
        raise LaunchError(
            f"--dask {address}: no scheduler answers there ({error}); give the address that `dask scheduler` writes, "
            "like tcp://host:8786"
        ) from error
    try:
        yield client.get_executor(pure=False)
    finally:
        with suppress(Exception):  # whatever it was, the outcomes are stored and the client is no longer needed
            client.close(timeout=_TIME_TO_CLOSE)
