"""Server of the live page: changes for all open pages, addresses and their answers, access and end.

Every client with the token of the printed address may see the page. No address changes anything. Without an open page
no database is read.
"""

import asyncio
import ipaddress
import json
import os
import secrets
import signal
import socket
import sys
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from threading import Thread
from urllib.parse import parse_qs

import uvicorn
from anyio import to_thread
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.convertors import IntegerConvertor, register_url_convertor
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from calcidem.app.report.cell_data import page_templates
from calcidem.app.serve import PageAddress
from calcidem.app.serve.feed import CampaignFeed, Event
from calcidem.storage.errors import StoreError, UnknownCellError, hide_passwords
from calcidem.storage.records import canonical_content, checked_seed
from calcidem.sweep.ranks import die_with_parent


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
            # At its end the server does not wait for a thread that reads a database.
            for event in await to_thread.run_sync(feed.refresh, abandon_on_cancel=True):
                self._tell(event)

    async def listen(self) -> AsyncIterator[str]:
        """Yield the state of each campaign, and then all changes, as server-sent events."""
        queue: asyncio.Queue[str | None] = asyncio.Queue(200)  # a slow browser starts again
        self._listeners.add(queue)
        self._wake.set()
        try:
            for feed in self.feeds:
                yield _as_event(("status", await to_thread.run_sync(feed.status, abandon_on_cancel=True)))
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


def _as_event(event: Event) -> str:
    name, content = event
    return f"event: {name}\ndata: {json.dumps(content, allow_nan=False)}\n\n"


@dataclass(frozen=True, slots=True)
class _LiveApplication:
    """Answers of the page's addresses, without a check of access."""

    hub: Hub
    """Source of the answers."""

    def routes(self) -> Starlette:
        """Return the application of a server; page, style and script are made from those of the report."""
        environment = page_templates("calcidem.app.serve", "calcidem.app.report")
        page = environment.get_template("live.html").render(campaigns=len(self.hub.feeds), remarks=())
        fixed = {
            "/": ("text/html", page),
            "/page.css": ("text/css", environment.get_template("live_page.css").render()),
            "/page.js": ("text/javascript", environment.get_template("live_page.js").render()),
        }
        of_campaign = "/campaigns/{campaign:number}"
        return Starlette(
            routes=[
                *(
                    Route(address, lambda _request, kind=kind, text=text: Response(text, media_type=kind))
                    for address, (kind, text) in fixed.items()
                ),
                Route("/events", self._events),
                Route(f"{of_campaign}/records", self._records),
                Route(f"{of_campaign}/cell", self._cell),
                Route(f"{of_campaign}/packings/{{index:number}}", self._packing),
            ]
        )

    async def _events(self, _request: Request) -> Response:
        return StreamingResponse(self.hub.listen(), media_type="text/event-stream")

    async def _records(self, request: Request) -> Response:
        packed = await run_in_threadpool(self._feed(request).records)
        return Response(packed, media_type="application/octet-stream")

    async def _cell(self, request: Request) -> Response:
        feed = self._feed(request)
        try:
            seed = checked_seed(int(request.query_params["seed"]))
            content = canonical_content(float(request.query_params["content"]))
        except (KeyError, ValueError, TypeError) as error:
            raise HTTPException(400) from error
        try:
            return JSONResponse(await run_in_threadpool(feed.cell, seed, content))
        except UnknownCellError:
            return JSONResponse({"cells": [], "sections": []})
        except StoreError as error:
            return JSONResponse({"cells": [], "sections": [], "problem": hide_passwords(str(error))})

    async def _packing(self, request: Request) -> Response:
        try:
            found = await run_in_threadpool(self._feed(request).packing, request.path_params["index"])
        except StoreError as error:
            raise HTTPException(503, hide_passwords(str(error))) from error
        if found is None:
            raise HTTPException(404)
        return JSONResponse(found)

    def _feed(self, request: Request) -> CampaignFeed:
        number: int = request.path_params["campaign"]
        if number >= len(self.hub.feeds):
            raise HTTPException(404)
        return self.hub.feeds[number]


_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; style-src-attr 'unsafe-inline'; "
        "img-src data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Headers of every answer: only the page's own script, no address sent to others, no storage in the browser."""


class _Guard:
    """Admits clients with the token: in the address of the first request, then in a cookie."""

    def __init__(self, application: ASGIApp, address: PageAddress) -> None:
        self._application = application
        self._token = address.token.encode()
        self._cookie = f"calcidem_{address.port}"  # browsers send the cookies of a host to all its ports
        self._names = {"localhost", address.host.lower(), socket.gethostname().lower(), socket.getfqdn().lower()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or pass it on."""
        if scope["type"] != "http":
            return

        async def send_safely(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(_HEADERS)
            await send(message)

        answer = self._answer(scope) or self._application
        await answer(scope, receive, send_safely)

    def _answer(self, scope: Scope) -> Response | None:
        """Return the answer to a refused request."""
        headers = Headers(scope=scope)
        if not self._is_own_name(headers.get("host", "")):
            # For the browser a foreign name that resolves to this machine would be the same origin.
            return PlainTextResponse("Open this page under the name that calcidem has printed.\n", 403)
        offered = parse_qs(scope["query_string"].decode("ascii", "replace")).get("token", [""])[0]
        if scope["path"] == "/" and self._is_token(offered):
            answer = RedirectResponse("/", 303)  # so that neither history nor address bar has the token
            answer.set_cookie(self._cookie, self._token.decode(), httponly=True, samesite="lax", path="/")
            return answer
        # Cookies of other pages of the host may have any text, and this name.
        cookies = (part.strip().partition("=") for part in headers.get("cookie", "").split(";"))
        admitted = any(self._is_token(value) for name, _, value in cookies if name == self._cookie)
        if not admitted:
            told = "Open this page with the whole address that calcidem has printed; it ends with ?token=... .\n"
            return PlainTextResponse(told, 403)
        return None

    def _is_token(self, text: str) -> bool:
        return secrets.compare_digest(text.encode("utf-8", "replace"), self._token)

    def _is_own_name(self, host: str) -> bool:
        """Whether a Host header has one of our names, or a numeric address, which cannot resolve elsewhere."""
        name = host.rpartition(":")[0] if not host.endswith("]") and ":" in host else host
        name = name.strip("[]").lower()
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name in self._names
        return True


class _Connection(H11Protocol):
    """Connection that lasts only while it answers, so that nobody who merely opens connections keeps others out."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Make room: of more than 50 connections the oldest one that answers nothing is closed."""
        others = [one for one in self.connections if isinstance(one, _Connection) and not one.transport.is_closing()]
        super().connection_made(transport)
        self.began = self.loop.time()
        if len(others) >= 50:
            waiting = [one for one in others if one.is_waiting]
            min(waiting, key=lambda one: one.began, default=self).transport.close()
        self._look_later()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        self._timer.cancel()
        super().connection_lost(exc)

    @property
    def is_waiting(self) -> bool:
        """Whether no whole request has arrived since the last answer."""
        return self.cycle is None or self.cycle.response_complete

    def _look_later(self) -> None:
        self._timer = self.loop.call_later(10.0, self._look, self.cycle)  # s, ample for the headers of a request

    def _look(self, before: object) -> None:
        """Close the connection if there was no request since the last look."""
        if self.is_waiting and self.cycle is before:
            self.transport.close()
        else:
            self._look_later()


class _Number(IntegerConvertor):
    """Number in an address, of so few digits that it is one."""

    regex = "[0-9]{1,9}"


register_url_convertor("number", _Number())


@dataclass(frozen=True, slots=True)
class LivePage:
    """Campaigns to show, and address."""

    campaigns: Sequence[tuple[str, str | None]]
    """Database and name of each; the name is None if a database has only one."""
    address: PageAddress
    """Listening socket and token."""

    def serve(self, ready: Callable[[], None] = lambda: None, *, wait: bool = False) -> None:
        """Serve the page until SIGINT, SIGTERM or a SIGHUP that is not ignored.

        ``ready`` is called as soon as signals end the server regularly. With ``wait`` databases and campaigns may not
        exist yet; otherwise `StoreError` if a database cannot be read.
        """
        feeds = [CampaignFeed(number, *campaign, wait=wait) for number, campaign in enumerate(self.campaigns)]
        for feed in feeds if not wait else ():
            feed.refuse_unreadable()
        asyncio.run(self._serve(Hub(feeds), ready))

    async def _serve(self, hub: Hub, ready: Callable[[], None]) -> None:
        application = _Guard(_LiveApplication(hub).routes(), self.address)
        server = uvicorn.Server(
            uvicorn.Config(
                application,
                log_level="error",
                access_log=False,  # the log would contain the token
                lifespan="off",
                ws="none",
                server_header=False,
                timeout_graceful_shutdown=1,  # s,
                http=_Connection,
                backlog=32,  # three times as many can be accepted before the oldest are closed
            )
        )
        server.capture_signals = nullcontext  # type: ignore[assignment,method-assign]  # which it would raise again

        async def end_in_order() -> None:
            try:
                await hub.end()
            finally:
                server.should_exit = True

        try:
            async with asyncio.TaskGroup() as tasks:  # an error of any of them ends the server
                watching = tasks.create_task(hub.watch())
                hangup = [signal.SIGHUP] * (signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN)  # as nohup does
                for number in (signal.SIGINT, signal.SIGTERM, *hangup):
                    asyncio.get_running_loop().add_signal_handler(
                        number, lambda: tasks.create_task(end_in_order()) and None
                    )
                ready()
                await server.serve([self.address.listener])
                watching.cancel()
        except* Exception as errors:  # noqa: BLE001
            raise errors.exceptions[0] from None
        finally:
            # A regularly closed database leaves no other files; the server does not wait for a locked one.
            closing = Thread(target=hub.close, daemon=True)
            closing.start()
            closing.join(1.0)  # s


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
