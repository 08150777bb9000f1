"""Operating-system support against processes that die, stop or outlive their launcher (Linux)."""

import contextlib
import ctypes
import os
import platform
import select
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Self


@dataclass(frozen=True, slots=True)
class ProcessIdentity:
    """Identity of a process for other processes on the same machine."""

    process: int
    """Its number."""
    machine: str
    """Equal for two processes if and only if process numbers have the same meaning for both: same boot of the same
    kernel, same namespace (containers).
    """
    host: str
    """Name of the machine."""

    @classmethod
    def of_this_process(cls) -> Self:
        """Return the identity of the calling process."""
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        namespace = Path("/proc/self/ns/pid").readlink()
        return cls(process=os.getpid(), machine=f"{boot} {namespace}", host=platform.node())


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_MEMORY_KEPT, _LARGEST_BLOCK_KEPT = 1 << 27, 1 << 25  # bytes; some versions of glibc refuse more than the second


def keep_freed_memory() -> None:
    """Let the C library keep the memory of freed arrays for later ones (glibc; elsewhere without effect).

    By default it returns memory to the kernel at once, and the kernel fills it with zeros at each new request. For
    arrays of some hundred kilobytes this takes half of NumPy's time.
    """
    with contextlib.suppress(OSError, AttributeError):
        library = ctypes.CDLL(None)
        library.mallopt(_M_TRIM_THRESHOLD, _MEMORY_KEPT)
        library.mallopt(_M_MMAP_THRESHOLD, _LARGEST_BLOCK_KEPT)


class ProcessWatch:
    """Processes on this machine, each identified by a key of the caller.

    File descriptors refer to them, so reused process numbers cannot be confused, and one call checks all of them.
    Processes on other machines or on a kernel before Linux 5.3 cannot be watched: they are never reported as ended, and
    `kill` returns False.
    """

    def __init__(self) -> None:
        self._descriptor_of: dict[int, int] = {}
        self._key_of: dict[int, int] = {}
        self._poll = select.poll()
        self._machine = ProcessIdentity.of_this_process().machine

    def add(self, key: int, identity: ProcessIdentity) -> None:
        """Begin to watch a process, if this machine can watch it."""
        if identity.machine != self._machine:
            return
        with contextlib.suppress(OSError):
            descriptor = os.pidfd_open(identity.process)
            self._poll.register(descriptor, select.POLLIN)
            self._descriptor_of[key] = descriptor
            self._key_of[descriptor] = key

    def find_ended(self) -> set[int]:
        """Return the keys of all watched processes that have ended."""
        return {self._key_of[descriptor] for descriptor, _ in self._poll.poll(0)}

    def kill(self, key: int) -> bool:
        """Kill a process, even a stopped one or one in compiled code; return whether it is watched."""
        if key not in self._descriptor_of:
            return False
        with contextlib.suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._descriptor_of[key], signal.SIGKILL)
        return True

    def remove(self, key: int) -> None:
        """Stop watching a process."""
        descriptor = self._descriptor_of.pop(key, None)
        if descriptor is not None:
            self._poll.unregister(descriptor)
            del self._key_of[descriptor]
            os.close(descriptor)
