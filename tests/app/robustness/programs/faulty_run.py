"""A rank of `calcidem run` in which one thing goes wrong on order, once; otherwise the program as it is.

Environment: FAULT, VICTIM (worker, master, mpirun), MOMENT (before, while, after the commit of a result) and
FAULT_FOLDER, where it is noted that the fault has happened, which process each rank is, and what was acknowledged.
"""

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from sqlalchemy import Engine, event

from calcidem.app.campaign import run as campaign
from calcidem.app.campaign.cells import CellComputation
from calcidem.app.campaign.run import StoreSink
from calcidem.app.cli.main import main
from calcidem.sweep.schedule import Batch, BatchOutcome

FAULT, VICTIM, MOMENT = (os.environ.get(name, "") for name in ("FAULT", "VICTIM", "MOMENT"))
FOLDER = Path(os.environ["FAULT_FOLDER"])
RANK = int(os.environ.get("OMPI_COMM_WORLD_RANK", "0"))
MPIRUN = int(os.environ.get("MPIRUN_PROCESS", "0"))

SIGNALS = {"SIGKILL": signal.SIGKILL, "segfault": signal.SIGSEGV, "SIGSTOP": signal.SIGSTOP}

STOPPED_FOR = 2.0
"""Seconds after which a stopped master or launcher is let go on, as its operator would."""


def endless_loop() -> None:
    """Compute for ever in compiled code: unlike CDLL, PyDLL keeps the interpreter's lock meanwhile."""
    ctypes.PyDLL(None).sleep(1000)


def fault_of_exception() -> None:
    """Raise what nobody expects."""
    raise RuntimeError("on order")


OWN_FAULTS: dict[str, Callable[[], Any]] = {
    "exception": fault_of_exception,
    "exit(1)": lambda: sys.exit(1),
    "_exit(1)": lambda: os._exit(1),
    "segfault": lambda: ctypes.string_at(0),
    "SIGKILL": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "SIGSTOP": lambda: os.kill(os.getpid(), signal.SIGSTOP),
    "endless loop": endless_loop,
}
"""What a process can do to itself."""


def is_first_time() -> bool:
    """Whether the fault has not happened yet, in this run or an earlier one."""
    try:
        (FOLDER / "happened").touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


class FaultyComputation:
    """The computation of a worker, with a fault before its first or after its first result was stored."""

    def __init__(self, compute: Callable[..., Any]) -> None:
        self._compute = compute
        self._batches = 0

    def __call__(self, batch: Batch[Any], raise_if_stopped: Callable[[], None]) -> Any:  # noqa: ANN401 - as the sweep has it
        """Compute a batch, or do what was ordered."""
        self._batches += 1
        if FAULT and self._batches > 1:
            time.sleep(0.5)  # a commit has all results that have come, and the first shall be stored by then
        due = {"before": 1, "after": 2}.get(MOMENT)
        if VICTIM == "worker" and self._batches == due and is_first_time():
            if FAULT == "time limit":
                while True:
                    raise_if_stopped()
                    time.sleep(0.01)
            OWN_FAULTS[FAULT]()
        return self._compute(batch, raise_if_stopped)


class FaultySink(StoreSink):
    """The sink of the master, with a fault around the second commit of results, and a list of what it has stored."""

    commits = 0
    committing: Sequence[BatchOutcome[Any, Any]] = ()

    def store(self, outcomes: Sequence[BatchOutcome[Any, Any]], /) -> None:
        """Store outcomes, and do what was ordered on the way."""
        FaultySink.commits += 1
        happens("before", outcomes)
        FaultySink.committing = outcomes
        super().store(outcomes)
        FaultySink.committing = ()
        with (FOLDER / "acknowledged").open("a") as file:
            file.writelines(f"{seed} {content}\n" for outcome in outcomes for seed, content in outcome.batch.cells)
        happens("after", outcomes)


@event.listens_for(Engine, "commit")
def commit(_connection: object) -> None:
    """Do what was ordered while the rows are written and not committed."""
    if FaultySink.committing:
        happens("while", FaultySink.committing)


def happens(moment: str, outcomes: Sequence[BatchOutcome[Any, Any]]) -> None:
    """Let the fault happen if it is due at this moment."""
    external = VICTIM in {"master", "mpirun"} or MOMENT == "while"
    if not external or moment != MOMENT or FaultySink.commits < 2 or not is_first_time():
        return
    if VICTIM == "worker":
        os.kill(int((FOLDER / f"rank-{outcomes[0].rank}").read_text()), SIGNALS[FAULT])
        return
    victim = os.getpid() if VICTIM == "master" else MPIRUN
    if FAULT == "SIGSTOP":
        let_go_on_later(victim)
    if VICTIM == "mpirun":
        os.kill(victim, SIGNALS[FAULT])
        time.sleep(0.5)  # so that this commit is the one that it disturbs
    else:
        OWN_FAULTS[FAULT]()


def let_go_on_later(victim: int) -> None:
    """Have another process continue a stopped one."""
    child = os.fork()
    if child == 0:
        time.sleep(STOPPED_FOR)
        os.kill(victim, signal.SIGCONT)
        os._exit(0)
    threading.Thread(target=os.waitpid, args=(child, 0), daemon=True).start()


(FOLDER / f"rank-{RANK}").write_text(str(os.getpid()))
campaign.CellComputation = lambda *arguments: FaultyComputation(CellComputation(*arguments))  # type: ignore[assignment]
campaign.StoreSink = FaultySink  # type: ignore[misc]
main()
