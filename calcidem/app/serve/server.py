"""The server of the live page: its port, its address with the token, its end."""

import asyncio
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Thread

import uvicorn

from calcidem.app.serve.access import Guard
from calcidem.app.serve.address import PageAddress
from calcidem.app.serve.application import LiveApplication
from calcidem.app.serve.feed import CampaignFeed
from calcidem.app.serve.hub import Hub
from calcidem.app.serve.movies import MovieMaker

_GRACE = 1
"""Seconds that open requests have for their end."""


class _Server(uvicorn.Server):
    """Leaves signals to whoever starts it: uvicorn would send them to itself again in the end."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Handle none."""
        yield


@dataclass(frozen=True, slots=True)
class LivePage:
    """Campaigns to show, and where.

    Attributes
    ----------
    campaigns
        Database and name of each; the name is None where a database has but one.
    address
        Socket on which to listen, and what opens the page.
    """

    campaigns: Sequence[tuple[str, str | None]]
    address: PageAddress

    def serve(self, ready: Callable[[], None] = lambda: None, *, wait: bool = False) -> None:
        """Serve the page until SIGINT or SIGTERM.

        Parameters
        ----------
        ready
            Called as soon as signals end the server in order.
        wait
            Whether databases and campaigns may be missing yet.

        Raises
        ------
        StoreError
            If a database can't be read, and there is no waiting for it.
        """
        feeds = [CampaignFeed(number, *campaign) for number, campaign in enumerate(self.campaigns)]
        for feed in feeds if not wait else ():
            feed.refuse_unreadable()
        asyncio.run(self._serve(Hub(feeds), ready))

    async def _serve(self, hub: Hub, ready: Callable[[], None]) -> None:
        movies = MovieMaker()
        application = Guard(LiveApplication(hub, movies).routes(), self.address)
        server = _Server(
            uvicorn.Config(
                application,
                log_level="warning",
                access_log=False,  # it would have the token
                lifespan="off",
                ws="none",
                server_header=False,
                timeout_graceful_shutdown=_GRACE,
            )
        )

        def end() -> None:
            server.should_exit = True
            hub.end()

        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, end)
        watching = asyncio.create_task(hub.watch())
        try:
            ready()
            await server.serve([self.address.listener])
        finally:
            watching.cancel()
            movies.end()
            # Closed in order a database leaves no other file beside it; a locked one is not waited for.
            closing = Thread(target=hub.close, daemon=True)
            closing.start()
            closing.join(_GRACE)
