import subprocess
import sys
import time
from pathlib import Path


def lives(process: int) -> bool:
    """Whether a process runs, and is not a zombie."""
    try:
        return Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def ends_soon(process: int) -> bool:
    """Whether a process ends within 5 s."""
    end = time.monotonic() + 5.0
    while lives(process):
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


def test_a_process_dies_with_its_parent() -> None:
    """After `die_with_parent` a process does not survive the kill of the one that started it."""
    child = "from calcidem.sweep.ranks import die_with_parent; import time; die_with_parent();"
    child += "print('ready', flush=True); time.sleep(60)"
    parent = "import subprocess, sys; p = subprocess.Popen([sys.executable, '-c', sys.argv[1]], "
    parent += "stdout=subprocess.PIPE, text=True); p.stdout.readline(); print(p.pid, flush=True); p.wait()"
    process = subprocess.Popen([sys.executable, "-c", parent, child], stdout=subprocess.PIPE)
    assert process.stdout is not None
    grandchild = int(process.stdout.readline())
    assert lives(grandchild)
    process.kill()
    process.communicate()
    assert ends_soon(grandchild)


def test_a_process_ends_after_another_one() -> None:
    """A worker ends by itself some time after rank 0, also where no launcher ends it."""
    other = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    program = "import sys, time; from calcidem.sweep.ranks import end_after; end_after(int(sys.argv[1]), 0.1, 75);"
    worker = subprocess.Popen(
        [sys.executable, "-c", f"{program} print('ready', flush=True); time.sleep(60)", str(other.pid)],
        stdout=subprocess.PIPE,
    )
    assert worker.stdout is not None
    worker.stdout.readline()
    time.sleep(0.3)
    assert worker.poll() is None
    other.kill()
    other.wait()
    assert worker.wait(5.0) == 75
