"""Sends changes to all open pages; without an open page no database is read."""

import asyncio
import json
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TypeVar

from anyio import to_thread

from calcidem.app.serve.feed import CampaignFeed, Event

T = TypeVar("T")

_BETWEEN_LOOKS = 1.0
"""Shortest interval between two updates from a database, s."""

_BETWEEN_PIECES = 0.03
"""Seconds between two pieces of a large campaign, for requests of browsers."""

_LAST_LOOK = 0.5
"""Seconds for a last update."""

_SHARE = 0.1
"""Largest share of the time for reading; a large campaign is read less often."""

_SELDOMEST_LOOK = 4.0
"""Longest interval between two updates, s; if a run uses all cores, reading takes long but little CPU time."""

_SIGN_OF_LIFE = 15.0
"""Seconds after which browsers get a message in any case, for proxies."""

_LONGEST_QUEUE = 200
"""Largest number of messages waiting for a slow browser; beyond it the browser has to start again."""


@dataclass(eq=False)
class Hub:
    """Feeds of campaigns, and connected browsers."""

    feeds: Sequence[CampaignFeed]
    """Feeds by the number of their campaign on the page."""
    _listeners: set["asyncio.Queue[str | None]"] = field(default_factory=set)
    _wake: asyncio.Event = field(default_factory=asyncio.Event)
    _ended: bool = False

    async def watch(self) -> None:
        """Read everything once, then changes while a page is open; cancel it at the end."""
        await self.refresh()
        while not self._ended:
            if not self._listeners:
                self._wake.clear()
                await self._wake.wait()
            begin = time.monotonic()
            await self.refresh()
            spent = time.monotonic() - begin
            busy = any(feed.busy for feed in self.feeds)
            await asyncio.sleep(_BETWEEN_PIECES if busy else min(max(_BETWEEN_LOOKS, spent / _SHARE), _SELDOMEST_LOOK))

    async def refresh(self) -> None:
        """Read all databases once, and send the changes."""
        for feed in self.feeds:
            for event in await _in_thread(feed.refresh):
                self._tell(event)

    async def listen(self) -> AsyncIterator[str]:
        """Yield the state of each campaign, and then all changes, as server-sent events."""
        queue: asyncio.Queue[str | None] = asyncio.Queue(_LONGEST_QUEUE)
        self._listeners.add(queue)
        self._wake.set()
        try:
            for feed in self.feeds:
                yield _as_event(("status", await _in_thread(feed.status)))
            while True:
                try:
                    text = await asyncio.wait_for(queue.get(), _SIGN_OF_LIFE)
                except TimeoutError:
                    text = ": still here\n\n"
                if text is None:
                    break
                yield text
        finally:
            self._listeners.discard(queue)

    async def end(self) -> None:
        """Send the last changes, if that is quick, and end all connections."""
        self._ended = True
        if self._listeners:
            with suppress(TimeoutError):
                await asyncio.wait_for(self.refresh(), _LAST_LOOK)
        for queue in self._listeners:
            if queue.full():
                queue.get_nowait()
            queue.put_nowait(None)

    def close(self) -> None:
        """Close all databases."""
        for feed in self.feeds:
            feed.close()

    def _tell(self, event: Event) -> None:
        text = _as_event(event)
        for queue in self._listeners:
            if queue.full():  # a browser that missed a change sees a gap in the sequence, and requests all cells
                queue.get_nowait()
            queue.put_nowait(text)


async def _in_thread(read: Callable[[], T]) -> T:
    """Read a database; the server does not wait for it at its end."""
    return await to_thread.run_sync(read, abandon_on_cancel=True)


def _as_event(event: Event) -> str:
    name, content = event
    return f"event: {name}\ndata: {json.dumps(content, allow_nan=False)}\n\n"
