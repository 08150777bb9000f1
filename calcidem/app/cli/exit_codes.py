"""End of a command by an error: one message without a traceback, and an exit code."""

import errno
import os
import platform
import sys
import tempfile
import traceback
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from calcidem.app.cli.options import IS_VERBOSE, say
from calcidem.app.config.schema import ConfigurationError
from calcidem.dem.engine.fields import FieldError
from calcidem.dem.kernels.gpu import GpuError
from calcidem.dem.sample.cement import CementCapacityError, UnknownPatternError
from calcidem.dem.sample.packing import PackingError, PackingFileError
from calcidem.input_file import InputFileError
from calcidem.storage.errors import (
    DiskError,
    InvalidRecordError,
    LeaseHeldError,
    LeaseLostError,
    StoreError,
    StoreInterruptedError,
    StoreLockedError,
    hide_passwords,
)
from calcidem.sweep.schedule import EXIT_ERROR, EXIT_RESUMABLE, LaunchError, SweepError
from calcidem.version import __version__

_EXIT_BAD_INPUT = 2
"""Bad configuration, arguments or files."""

EXIT_ROUNDING = 3
"""`calcidem verify`: stored and computed numbers are the same to rounding."""

_BAD_INPUT = (
    CementCapacityError, ConfigurationError, FieldError, GpuError, InputFileError, LaunchError, PackingFileError,
    StoreError, UnknownPatternError, OSError,
)  # fmt: skip

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

_CURE_OF_ERRNO = {
    errno.ENOENT: "check the name; a folder for results has to exist",
    errno.EEXIST: "give another name, or remove what is there",
    errno.EISDIR: "give the name of a file",
    errno.ENOTDIR: "a part of the name is not a folder; check it",
    errno.ENAMETOOLONG: "give a shorter name",
    errno.EACCES: "give one that you may use, or change its permissions",
    errno.EPERM: "give one that you may use, or change its permissions",
    errno.EROFS: "give one in a folder that can be written",
} | dict.fromkeys(_FULL, "free some space, or give a place that has some")


def _exit_code_of(error: BaseException) -> int:
    """Exit code of a program that ends by an error."""
    if isinstance(error, StoreLockedError | StoreInterruptedError):
        return EXIT_RESUMABLE
    if isinstance(error, OSError):
        return _EXIT_BAD_INPUT if error.errno in {None, *_CURE_OF_ERRNO} - {*_FULL} else EXIT_ERROR
    # Other input would not remedy these.
    circumstances = DiskError, InvalidRecordError, LeaseHeldError, LeaseLostError, StoreLockedError
    is_input = isinstance(error, _BAD_INPUT) and not isinstance(error, circumstances) and type(error) is not StoreError
    return _EXIT_BAD_INPUT if is_input else EXIT_ERROR


def tell_error(error: Exception) -> int:
    """Write the cause and the remedy, or the place of the traceback of an unexpected error; return the exit code."""
    # Without memory for the stack of a thread, Python raises a RuntimeError; without memory for the MemoryError of a
    # function, it raises a SystemError.
    no_memory = str(error) == "can't start new thread" or str(error).endswith("without setting an exception")
    if no_memory or isinstance(error, MemoryError):
        text = (
            f"memory, or the number of processes, has reached its limit ({str(error) or type(error).__name__}): use "
            "fewer ranks, or raise the limit (ulimit -v, ulimit -u); what was stored before is safe."
        )
    elif isinstance(error, OSError) and error.errno is not None and error.strerror is not None:
        name = error.filename if error.filename2 is None else error.filename2  # of two names, the second is the target
        named = "" if name is None else f"{name}: "
        cure = _CURE_OF_ERRNO.get(error.errno, "check the name and the disk")
        text = f"{named}{error.strerror[:1].lower()}{error.strerror[1:]}; {cure}"
    elif isinstance(error, (*_BAD_INPUT, PackingError, SweepError)):
        text = str(error)
    else:
        text = f"calcidem stopped at an unexpected error: {type(error).__name__}: {error}"
        try:
            path = _log_error(error)
        except MemoryError as lack:
            return tell_error(lack)
        text += (
            f"\nPlease report it with the log {path}; what was stored before is safe."
            if path
            else f"\nNo log could be written:\n{''.join(traceback.format_exception(error))}"
        )
    if IS_VERBOSE.get():
        text += f"\n{''.join(traceback.format_exception(error))}"
    say(hide_passwords(f"Error: {text}"), err=True)
    return _exit_code_of(error)


def _log_error(error: BaseException) -> Path | None:
    """Write the traceback into a new file, in this folder or that for temporary files; None if neither is possible."""
    program = f"calcidem {__version__}, Python {platform.python_version()}, {platform.platform()}"
    text = hide_passwords("\n".join([program, repr(sys.argv), "".join(traceback.format_exception(error))]))
    name = f"calcidem-error-{datetime.now(UTC):%Y%m%d-%H%M%S}-{os.getpid()}.log"
    for folder in (Path.cwd, tempfile.gettempdir):
        with suppress(OSError):
            path = Path(folder()) / name
            path.write_text(text, encoding="utf-8", errors="backslashreplace")
            return path
    return None
