"""Collective operations that sleep while they wait.

The blocking ones of MPI keep a core busy on every rank that waits, which is most of them while rank 0 makes a
packing or one rank of a node compiles.
"""

import pickle
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from mpi4py import MPI

from calcidem.sweep.protocol import MASTER, wait_until

ValueT = TypeVar("ValueT")


def barrier(comm: MPI.Comm, limit: float = float("inf")) -> None:
    """Return once all ranks have called this, or after ``limit`` seconds."""
    request = comm.Ibarrier()
    wait_until(request.Test, limit)


def broadcast(comm: MPI.Comm, value: ValueT | None) -> ValueT:
    """Return on all ranks the picklable value that rank 0 gives; what the others give is ignored."""
    payload = bytearray(pickle.dumps(value, pickle.HIGHEST_PROTOCOL)) if comm.Get_rank() == MASTER else bytearray()
    size = np.array([len(payload)], dtype=np.int64)
    wait_until(comm.Ibcast(size, MASTER).Test)
    if comm.Get_rank() != MASTER:
        payload = bytearray(int(size[0]))
    wait_until(comm.Ibcast([payload, MPI.BYTE], MASTER).Test)
    received: ValueT = pickle.loads(payload)  # noqa: S301 - written by rank 0 of the same program
    return received


def once_per_node(comm: MPI.Comm, action: Callable[[], object]) -> None:
    """Call `action` on one rank of each node, and return on all ranks once all nodes are done.

    Meant to fill a compile cache that the ranks of a node share.
    """
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    if node.Get_rank() == 0:
        action()
    node.Free()
    barrier(comm)
