import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest

from calcidem.sweep.processes import ProcessIdentity, ProcessWatch


@pytest.fixture
def sleeper() -> Iterator[subprocess.Popen[bytes]]:
    """Return a process that does nothing."""
    process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    yield process
    process.kill()
    process.wait()


def identity_of(process: subprocess.Popen[bytes]) -> ProcessIdentity:
    """Return the identity that the process would report itself."""
    return replace(ProcessIdentity.of_this_process(), process=process.pid)


def soon(condition: Callable[[], object]) -> bool:
    """Tell whether the condition holds within 5 s."""
    end = time.monotonic() + 5.0
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


def test_a_running_process_has_not_ended(sleeper: subprocess.Popen[bytes]) -> None:
    """A watched process is not among the ended ones while it runs."""
    watch = ProcessWatch()
    watch.add(7, identity_of(sleeper))
    assert watch.find_ended() == set()


@pytest.mark.parametrize("stopped", [False, True], ids=["running", "stopped"])
def test_a_killed_process_has_ended(sleeper: subprocess.Popen[bytes], stopped: bool) -> None:
    """A process that is killed, even a stopped one, is soon among the ended ones, until it is removed."""
    watch = ProcessWatch()
    watch.add(7, identity_of(sleeper))
    if stopped:
        sleeper.send_signal(signal.SIGSTOP)
    assert watch.kill(7)
    assert soon(lambda: watch.find_ended() == {7})
    sleeper.wait()
    assert watch.kill(7)  # nobody else can be hit: the descriptor still means the dead process
    watch.remove(7)
    assert watch.find_ended() == set()


def test_processes_elsewhere_are_not_watched(sleeper: subprocess.Popen[bytes]) -> None:
    """A process of another machine with the same number is left alone."""
    watch = ProcessWatch()
    watch.add(7, replace(identity_of(sleeper), machine="another boot pid:[1]"))
    assert not watch.kill(7)
    assert sleeper.poll() is None


def test_a_process_dies_with_its_parent() -> None:
    """After `die_with_parent` a process does not survive the kill of the one that started it."""
    child = "from calcidem.launch.starter import die_with_parent; import time; die_with_parent();"
    child += "print('ready', flush=True); time.sleep(60)"
    parent = "import subprocess, sys; p = subprocess.Popen([sys.executable, '-c', sys.argv[1]], "
    parent += "stdout=subprocess.PIPE, text=True); p.stdout.readline(); print(p.pid, flush=True); p.wait()"
    process = subprocess.Popen([sys.executable, "-c", parent, child], stdout=subprocess.PIPE)
    assert process.stdout is not None
    watch = ProcessWatch()
    watch.add(1, replace(ProcessIdentity.of_this_process(), process=int(process.stdout.readline())))
    assert watch.find_ended() == set()
    process.kill()
    process.communicate()
    assert soon(lambda: watch.find_ended() == {1})
