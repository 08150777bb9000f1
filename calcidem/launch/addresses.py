"""Addresses at which a command listens to ranks: loopback if all are on its host, else reachable ones."""

import os
import socket
import struct
import subprocess
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

_LOOPBACK = "127.0.0.1"

_SIOCGIFADDR = 0x8915
"""Asks the kernel for the address of a network interface, man 7 netdevice."""

_HOST_FILES = ("hostfile", "host_file", "nodefile", "machinefile")
"""Parts of the names of variables whose value is a file with hosts: PBS_NODEFILE, PE_HOSTFILE, PRTE_MCA_..."""

_RANK_FILE = "rankfile"
"""The same, for files that name hosts elsewhere."""

_DEFAULT_HOST_FILES = ("prte-default-hostfile", "openmpi-default-hostfile")
"""Files with hosts in the folder etc of a launcher."""


def listening_addresses(mpirun: str, variables: Mapping[str, str] = os.environ) -> list[str]:
    """Addresses at which ranks of a launcher can reach this host, loopback first.

    The arguments are path and environment of the launcher.
    """
    hosts = _hosts_of_launcher(mpirun, variables)
    if hosts is None:
        return _own_addresses()
    found = [_LOOPBACK]
    for host in hosts:
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as route:
                route.connect((host, 9))  # sends nothing; the kernel only chooses the source address
                found.append(route.getsockname()[0])
        except OSError:
            return _own_addresses()
    return list(dict.fromkeys(found))


def _hosts_of_launcher(mpirun: str, variables: Mapping[str, str]) -> list[str] | None:
    """Other hosts on which a launcher may start ranks; None if they cannot be known."""
    if variables.get("MPIRUN"):
        return None  # it may be a script with its own options
    found: set[str] = set()
    if variables.get("SLURM_JOB_NUM_NODES", "1") != "1":
        try:
            command = ["scontrol", "show", "hostnames", variables["SLURM_JOB_NODELIST"]]
            found |= set(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split())  # noqa: S603 - Slurm's own
        except (OSError, KeyError, subprocess.CalledProcessError):
            return None
    folder = Path(mpirun).resolve().parents[1] / "etc"
    files = [folder / name for name in _DEFAULT_HOST_FILES if (folder / name).is_file()]
    for name, value in variables.items():
        if _RANK_FILE in name.lower():
            return None
        if any(word in name.lower() for word in _HOST_FILES):
            files.append(Path(value))
    for file in files:
        try:
            lines = (line.partition("#")[0].split() for line in file.read_text(encoding="utf-8").splitlines())
            found |= {words[0].rpartition("@")[2].partition(":")[0] for words in lines if words}
        except (OSError, UnicodeDecodeError):
            return None
    own = socket.gethostname()
    return sorted(found - {own, own.partition(".")[0], "localhost", _LOOPBACK})


def _own_addresses() -> list[str]:
    """Addresses of the network interfaces of this host, a loopback address first."""
    import fcntl  # noqa: PLC0415 - Windows, which has no ranks, lacks it

    found = []
    for _, name in socket.if_nameindex():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket, suppress(OSError):
            answer = fcntl.ioctl(any_socket.fileno(), _SIOCGIFADDR, struct.pack("256s", name.encode()))
            found.append(socket.inet_ntoa(answer[20:24]))
    return found
