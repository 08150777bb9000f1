"""Messages between master and workers, and collective operations of all ranks.

    worker                              master (rank 0)
    HELLO    identity of its process ->
                                     <- TASK     a batch
    OUTCOME  outcome of the batch    ->
                                     <- STOP     how the sweep ended
                                     <- END      the program is over

Nothing here blocks. Messages are received and sent by requests that are tested between sleeps, so an idle rank uses
hardly any time, and a dead or silent partner delays no one. Sends are synchronous: when one has completed, the other
side has begun to receive it. The communicator may carry other messages before and after a sweep, but not during it.

The collective operations of `Ranks` also sleep while they wait. Blocking ones of MPI keep a core busy on every waiting
rank, for instance while rank 0 makes a packing.
"""

import pickle
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI

from calcidem.sweep.backoff import wait_until

ValueT = TypeVar("ValueT")

MASTER = 0
"""Rank of the master."""


class Tag(IntEnum):
    """Meaning of a message."""

    HELLO = 7401
    TASK = 7402
    OUTCOME = 7403
    STOP = 7404
    END = 7405


@dataclass(slots=True)
class Incoming:
    """A message being received."""

    source: int
    tag: Tag
    """Rank of the sender, and meaning."""
    _buffer: bytearray
    _request: MPI.Request

    def arrived(self) -> bool:
        """Return whether the message is complete; `mpi4py.MPI.Exception` if the sender has died meanwhile (ULFM)."""
        return self._request.Test()

    def value(self) -> Any:  # noqa: ANN401 - whatever was sent
        """Return the value sent, once the message is complete."""
        return pickle.loads(self._buffer)  # noqa: S301 - written by another rank of the same program


class Ranks:
    """Ranks of a communicator: messages between two, and collective operations."""

    def __init__(self, comm: MPI.Comm) -> None:
        self._comm = comm

    def send(self, value: Any, destination: int, tag: Tag) -> MPI.Request:  # noqa: ANN401 - any picklable
        """Begin to send a picklable value; the request must be kept and tested."""
        payload = pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)
        return self._comm.Issend([payload, MPI.BYTE], destination, tag)

    def receive(self, source: int) -> Incoming | None:
        """Begin to receive a message if one is waiting, else return None.

        `mpi4py.MPI.Exception` if the source, or with ANY_SOURCE a rank not yet acknowledged as failed, has died (ULFM).
        """
        status = MPI.Status()
        message = self._comm.Improbe(source, MPI.ANY_TAG, status)
        if message is None:
            return None
        buffer = bytearray(status.Get_count(MPI.BYTE))
        request = message.Irecv([buffer, MPI.BYTE])
        return Incoming(status.Get_source(), Tag(status.Get_tag()), buffer, request)

    @staticmethod
    def is_over(request: MPI.Request) -> bool:
        """Return whether a message was received, or its receiver has died (ULFM)."""
        try:
            return request.Test()
        except MPI.Exception:
            return True

    def failed(self) -> frozenset[int]:
        """Return the ranks that MPI reports as failed; none without ULFM."""
        group = self._comm.Get_failed()
        try:
            if group.Get_size() == 0:
                return frozenset()
            everyone = self._comm.Get_group()
            try:
                return frozenset(group.Translate_ranks(range(group.Get_size()), everyone))
            finally:
                everyone.Free()
        finally:
            group.Free()

    def acknowledge_failures(self) -> None:
        """Make probes for any source work again after ranks have failed."""
        group = self._comm.Get_failed()
        self._comm.Ack_failed(group.Get_size())
        group.Free()

    def release(self, ranks: Collection[int], limit: float) -> None:
        """Let other ranks end, which wait for this; return once they have received it, or after ``limit`` seconds."""
        requests = []
        for rank in ranks:
            with suppress(MPI.Exception):  # it has died
                requests.append(self._comm.Issend([b"", MPI.BYTE], rank, Tag.END))
        wait_until(lambda: all(self.is_over(request) for request in requests), limit)

    def wait_for_release(self) -> None:
        """Return once rank 0 lets this one end, or has died (ULFM)."""
        with suppress(MPI.Exception):
            wait_until(self._comm.Irecv([bytearray(), MPI.BYTE], MASTER, Tag.END).Test)

    def broadcast(self, value: ValueT | None) -> ValueT:
        """Return on all ranks the picklable value of rank 0; values of the others are ignored."""
        payload = (
            bytearray(pickle.dumps(value, pickle.HIGHEST_PROTOCOL)) if self._comm.Get_rank() == MASTER else bytearray()
        )
        size = np.array([len(payload)], dtype=np.int64)
        wait_until(self._comm.Ibcast(size, MASTER).Test)
        if self._comm.Get_rank() != MASTER:
            payload = bytearray(int(size[0]))
        wait_until(self._comm.Ibcast([payload, MPI.BYTE], MASTER).Test)
        received: ValueT = pickle.loads(payload)  # noqa: S301 - written by rank 0 of the same program
        return received

    def gather(self, value: ValueT) -> list[ValueT]:
        """Return on rank 0 the picklable values of all ranks, in the order of the ranks; on the others none."""
        payload = np.frombuffer(pickle.dumps(value, pickle.HIGHEST_PROTOCOL), dtype=np.uint8)
        sizes = np.zeros(self._comm.Get_size(), dtype=np.int64)
        wait_until(self._comm.Igather(np.array([payload.size], dtype=np.int64), sizes, MASTER).Test)
        received = np.empty(sizes.sum(), dtype=np.uint8)
        wait_until(self._comm.Igatherv(payload, [received, sizes, MPI.BYTE], MASTER).Test)
        ends = np.cumsum(sizes)
        parts = (received[end - size : end] for end, size in zip(ends, sizes, strict=True))
        return [pickle.loads(part.tobytes()) for part in parts] if self._comm.Get_rank() == MASTER else []  # noqa: S301 - as above

    def share_on_node(self, actions: Sequence[Callable[[], object]]) -> None:
        """Call each action on one rank of each node; return on all ranks once all are done.

        For instance to fill a compile cache that the ranks of a node share.
        """
        node = self._comm.Split_type(MPI.COMM_TYPE_SHARED)
        for action in actions[node.Get_rank() :: node.Get_size()]:
            action()
        node.Free()
        wait_until(self._comm.Ibarrier().Test)
