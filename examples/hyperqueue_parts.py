"""A campaign in parts with HyperQueue, then merged: `python examples/hyperqueue_parts.py CONFIG OUT.db PARTS [SERVER]`.

Without a folder of a server, it starts one with a worker that has all cores of this machine. On a cluster start
`hq server start` and its workers yourself, and give the folder of the server. Given again, it goes on where it stopped.
"""

import os
import subprocess
import sys

from hyperqueue import Client, Job, LocalCluster
from hyperqueue.cluster import WorkerConfig


def compute(client: Client, config: str, parts: int) -> None:
    """Compute each part as a task of one core, in a process and a database of its own."""
    job = Job(default_workdir=".", default_env=dict(os.environ))
    for part in range(1, parts + 1):
        job.program(["calcidem", "run", config, "--part", f"{part}/{parts}", "--db", f"part-{part}.db"])
    client.wait_for_jobs([client.submit(job)])


def main() -> None:
    """Make the packing, compute all parts, and merge them."""
    if len(sys.argv) < 4:
        sys.exit(f"Give a configuration, a database and a number of parts:\n{__doc__}")
    config, out, parts = sys.argv[1], sys.argv[2], int(sys.argv[3])
    subprocess.run(["calcidem", "run", config, "--packing-only"], check=True)
    if len(sys.argv) > 4:  # a folder of a server was given
        compute(Client(sys.argv[4]), config, parts)
    else:
        with LocalCluster(worker_config=WorkerConfig()) as cluster:
            compute(cluster.client(), config, parts)
    databases = [f"part-{part}.db" for part in range(1, parts + 1)]
    subprocess.run(["calcidem", "merge", *databases, "--out", out], check=True)


if __name__ == "__main__":
    main()
