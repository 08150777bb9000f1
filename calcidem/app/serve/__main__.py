"""Live page of a run: it reads its task from standard input, and ends with the run."""

import json
import os
import socket
import sys

from calcidem.app.serve.address import PageAddress
from calcidem.app.serve.server import LivePage
from calcidem.sweep.ranks import die_with_parent


def _show_run() -> None:
    """Serve the page until a signal, or the end of the parent process."""
    if sys.platform == "linux":
        die_with_parent()
    os.nice(10)
    told = json.load(sys.stdin)
    address = PageAddress(socket.socket(fileno=told["descriptor"]), told["host"], told["token"])
    LivePage([(told["database"], told["campaign"])], address).serve(wait=True)
    os._exit(0)  # as in `calcidem serve`


if __name__ == "__main__":
    _show_run()
