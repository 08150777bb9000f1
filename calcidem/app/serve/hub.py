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
            # Between two pieces of a large campaign browsers get 0.03 s for their requests. Later reading takes a tenth
            # of the time, once a second at most. While a run uses all cores it takes long but little CPU time: 4 s do.
            await asyncio.sleep(0.03 if busy else min(max(1.0, spent / 0.1), 4.0))

    async def refresh(self) -> None:
        """Read all databases once, and send the changes."""
        for feed in self.feeds:
            for event in await _in_thread(feed.refresh):
                self._tell(event)

    async def listen(self) -> AsyncIterator[str]:
        """Yield the state of each campaign, and then all changes, as server-sent events."""
        queue: asyncio.Queue[str | None] = asyncio.Queue(200)  # a slow browser starts again
        self._listeners.add(queue)
        self._wake.set()
        try:
            for feed in self.feeds:
                yield _as_event(("status", await _in_thread(feed.status)))
            while True:
                try:
                    text = await asyncio.wait_for(queue.get(), 15.0)  # s, for proxies
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
                await asyncio.wait_for(self.refresh(), 0.5)  # s
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
