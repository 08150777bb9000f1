"""A sweep as a sequence of events: the master's thread that exchanges messages, the one that stores, and the workers."""

import heapq
import random
from collections import deque
from dataclasses import dataclass

INTERVAL = 0.1
"""Seconds between the beginnings of two groups, as in `calcidem.sweep.group_commit`."""

SLICE = 5e-3
"""Seconds for which a thread keeps Python's interpreter lock while another one waits for it."""

SPREAD = 0.5
"""Batches take their mean time up to so much less or more, all values alike: cheap and expensive contents."""


@dataclass(frozen=True)
class Costs:
    """What a batch costs the master, s.

    Attributes
    ----------
    message
        CPU time of the thread that exchanges messages, for a batch: receive the outcome, hand out the next batch.
    transit
        What a worker waits for its next batch when the master has nothing else to do, without `message`.
    group_cpu, batch_cpu
        CPU time of the storing thread for a transaction, and for each batch in it.
    group_disk, batch_disk
        Its waiting for the disk, likewise; messages are exchanged meanwhile.
    """

    message: float
    transit: float
    group_cpu: float
    batch_cpu: float
    group_disk: float
    batch_disk: float


def durations(batches: int, mean: float) -> list[float]:
    """Times of the batches, s: evenly spread around the mean in a random order that is always the same."""
    order = list(range(batches))
    random.Random(17).shuffle(order)
    return [mean * (1.0 + SPREAD * (2.0 * (position + 0.5) / batches - 1.0)) for position in order]


def simulate(workers: int, times: list[float], costs: Costs) -> float:
    """Wall time of a sweep over batches that take so long, s.

    The two threads of the master share one core and the interpreter lock, so that they never compute at once: after each
    message, and while there is none, the storing thread computes for a slice.
    """
    left = deque(times)
    arrivals = [(0.0, worker) for worker in range(workers)]  # workers that join, then outcomes
    computing, stored = set[int](), 0
    now = next_begin = disk_until = end = 0.0
    cpu_left = waiting = in_group = 0.0
    storing = False
    while stored < len(times):
        if storing and cpu_left <= 0.0 and now >= disk_until:
            storing, stored = False, stored + int(in_group)
            end = now
        if not storing and waiting and now >= next_begin:
            storing, in_group, waiting, next_begin = True, waiting, 0.0, now + INTERVAL
            cpu_left = costs.group_cpu + in_group * costs.batch_cpu
        idle = True
        if arrivals and arrivals[0][0] <= now:
            _, worker = heapq.heappop(arrivals)
            now += costs.message
            waiting += worker in computing
            computing.discard(worker)
            if left:
                computing.add(worker)
                heapq.heappush(arrivals, (now + costs.transit + left.popleft(), worker))
            idle = False
        if storing and cpu_left > 0.0:
            now += min(SLICE, cpu_left)
            cpu_left -= SLICE
            if cpu_left <= 0.0:
                disk_until = now + costs.group_disk + in_group * costs.batch_disk
            idle = False
        if idle:
            events = [time for time, _ in arrivals[:1]]
            events += [disk_until] if storing else ([next_begin] if waiting else [])
            now = max(now, min(events, default=now))
    return end


def efficiency(workers: int, mean: float, costs: Costs, batches_of_one: int = 100) -> float:
    """Share of their time that the workers compute, from the first batch to the last transaction."""
    times = durations(workers * batches_of_one, mean)
    return sum(times) / workers / simulate(workers, times, costs)
