"""Where the outcomes of a sweep go."""

from collections.abc import Sequence
from typing import Any, Protocol

from calcidem.sweep.batch import Batch
from calcidem.sweep.outcome import BatchOutcome


class Sink(Protocol):
    """What the caller of a sweep gives to have its outcomes kept; used on rank 0 only.

    An outcome is acknowledged once `store` has returned, so it must be on disk by then. A sweep that was
    killed may have stored a batch that it computes again later: storing twice must equal storing once.
    An exception of the sink ends the sweep and is passed on.
    """

    def store(self, outcomes: Sequence[BatchOutcome[Any, Any]], /) -> None:
        """Keep final outcomes, one or several that arrived together."""

    def lost(self, batch: Batch[Any], reason: str, /) -> None:
        """Keep that a worker was lost over a batch; `batch.losses` counts this loss already.

        To be given back as `losses` when the same cells are planned again after a restart.
        """
