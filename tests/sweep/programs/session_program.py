"""Does one thing that concerns all ranks, as told by the first argument."""

import io
import sys
import time
from typing import NoReturn

from calcidem.sweep.session import Session


class NoMemory(io.StringIO):
    """Output of a process that has no memory left."""

    def write(self, _text: str) -> NoReturn:
        """Fail."""
        raise MemoryError

    def flush(self) -> NoReturn:
        """Fail."""
        raise MemoryError


def main() -> None:
    """Broadcast, do something once for the node, raise on one rank, or sleep while rank 0 is busy."""
    with Session() as session:
        what = sys.argv[1]
        if what == "broadcast":
            received = session.broadcast({"big": b"x" * 3_000_000} if session.rank == 0 else None)
            assert received is not None
            assert received["big"] == b"x" * 3_000_000
        elif what == "gather":
            sys.stdout.write(f"{[len(text) for text in session.gather('x' * (session.rank * 100_000))]}\n")
        elif what == "once":
            session.share_on_node([lambda: sys.stdout.write("once\n")])
        elif what == "raise" and session.rank == 1:
            raise RuntimeError("on order")
        elif what == "no memory" and session.rank == 1:
            sys.stderr = NoMemory()
            raise MemoryError
        elif what in {"raise", "no memory"}:
            session.broadcast(None)
            time.sleep(60)
        elif what == "wait":
            if session.rank == 0:
                time.sleep(2.0)
            start = time.process_time()
            session.broadcast(1)
            sys.stdout.write(f"{time.process_time() - start}\n")
        session.end(0)


if __name__ == "__main__":
    main()
