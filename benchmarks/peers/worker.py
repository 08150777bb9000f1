"""Child side of the benchmark: one program, one scene, commands on stdin, replies on stdout.

Only the standard library and numpy, because YADE and LAMMPS bring their own Python.
"""

import json
import sys
import time
from collections.abc import Callable

import numpy as np

MARK = "@reply "  # programs print banners; replies start with this


class Engine:
    """What a program has to be able to do."""

    def reset(self) -> None:
        """Set the scene up anew."""
        raise NotImplementedError

    def run(self, steps: int) -> None:
        """Advance by some steps."""
        raise NotImplementedError

    def state(self) -> "np.ndarray":
        """(N, 3) x, y (m) and angular velocity (rad/s), in the order of the scene."""
        raise NotImplementedError


def serve(make: Callable[[str], Engine], arguments: "list[str]") -> None:
    """Answer ``reset``, ``run STEPS`` and ``state FILE`` until ``quit``; the first argument is the scene file."""
    engine = make(arguments[0])
    reply({"ready": True})
    for line in sys.stdin:
        command, *rest = line.split()
        if command == "quit":
            break
        if command == "reset":
            engine.reset()
            reply({})
        elif command == "run":
            before = time.process_time()
            engine.run(int(rest[0]))
            reply({"seconds": time.process_time() - before})
        elif command == "state":
            np.save(rest[0], engine.state())
            reply({})


def reply(content: "dict[str, object]") -> None:
    """Answer one command."""
    sys.stdout.write(MARK + json.dumps(content) + "\n")
    sys.stdout.flush()
