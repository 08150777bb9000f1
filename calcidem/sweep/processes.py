"""Support of the operating system for processes (Linux)."""

import contextlib
import ctypes
import os
import select
import signal
import sys
import threading
import time
from typing import Any

# Loaded here, since the next function also runs between fork and exec.
_LIBC: Any = ctypes.CDLL(None, use_errno=True) if sys.platform == "linux" else None


def die_with_parent(parent: int | None = None) -> None:
    """Let the kernel kill this process as soon as its parent ends.

    A caller that knows the process number of its parent gives it, since the parent may have ended before this call.

    Otherwise a rank whose mpirun was killed would run for ever. It is a descendant of mpirun or, on other nodes, of its
    daemon, which ends when it loses mpirun. Call this before MPI is initialised: if the launcher has ended by then, the
    initialisation fails and the rank ends. `OSError` if the kernel refuses.
    """
    parent = parent or os.getppid()
    if _LIBC.prctl(1, signal.SIGKILL, 0, 0, 0) != 0:  # PR_SET_PDEATHSIG
        number = ctypes.get_errno()
        raise OSError(number, f"prctl(PR_SET_PDEATHSIG): {os.strerror(number)}")
    if os.getppid() != parent:  # it ended before the request, so its death will not be signalled
        os.kill(os.getpid(), signal.SIGKILL)


def exists(process: int) -> bool:
    """Whether a process of this machine with this number exists."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def end_after(process: int, grace: float, exit_code: int) -> None:
    """End this process some seconds after the end of another one of this machine, unless it ends by itself.

    A thread waits for this. `srun` does not end a job when one of its tasks is killed, as mpirun does.
    """
    try:
        descriptor = os.pidfd_open(process)
    except OSError:
        return  # before Linux 5.3, or it has just ended and MPI is being informed

    def wait_and_end() -> None:
        select.select([descriptor], [], [])
        time.sleep(grace)
        os._exit(exit_code)

    threading.Thread(target=wait_and_end, name="watch-master", daemon=True).start()


def keep_freed_memory() -> None:
    """Let the C library keep the memory of freed arrays for later ones (glibc; elsewhere without effect).

    By default it returns memory to the kernel at once, and the kernel fills it with zeros at each new request. For
    arrays of some hundred kilobytes this takes half of NumPy's time.
    """
    with contextlib.suppress(OSError, AttributeError):
        _LIBC.mallopt(-1, 1 << 27)  # M_TRIM_THRESHOLD, bytes
        _LIBC.mallopt(-3, 1 << 25)  # M_MMAP_THRESHOLD; some versions of glibc refuse more
