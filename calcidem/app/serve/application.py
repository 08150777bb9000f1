"""Addresses of the page and what they answer."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from calcidem.app.serve.feed import CampaignFeed
from calcidem.app.serve.hub import Hub
from calcidem.app.serve.movies import MovieMaker, Wanted
from calcidem.storage.errors import StoreError, UnknownCellError
from calcidem.storage.passwords import hide_passwords
from calcidem.storage.records import canonical_content, checked_seed

_LAST_SEED = 2**63 - 1


@dataclass(frozen=True, slots=True)
class LiveApplication:
    """What the addresses of the page answer, to all; see `calcidem.app.serve.access`.

    Attributes
    ----------
    hub, movies
        Where the answers come from.
    """

    hub: Hub
    movies: MovieMaker

    def routes(self) -> Starlette:
        """Give the application of a server."""
        of_campaign = "/campaigns/{campaign:int}"
        return Starlette(
            routes=[
                *(Route(address, _static(kind, text)) for address, (kind, text) in _fixed(self.hub).items()),
                Route("/events", self._events),
                Route(f"{of_campaign}/records", self._records),
                Route(f"{of_campaign}/cell", self._cell),
                Route(f"{of_campaign}/packings/{{index:int}}", self._packing),
                Route(f"{of_campaign}/movie", self._movie, methods=["GET", "POST"]),
                Route("/movies/{name}", self._movie_file),
            ]
        )

    async def _events(self, _request: Request) -> Response:
        return StreamingResponse(self.hub.listen(), media_type="text/event-stream")

    async def _records(self, request: Request) -> Response:
        packed = await run_in_threadpool(self._feed(request).records)
        return Response(packed, media_type="application/octet-stream")

    async def _cell(self, request: Request) -> Response:
        feed, (_, seed, content) = self._feed(request), _wanted(request)
        try:
            return JSONResponse(await run_in_threadpool(feed.cell, seed, content))
        except UnknownCellError:
            return JSONResponse({"cells": [], "sections": []})
        except StoreError as error:
            return JSONResponse({"cells": [], "sections": [], "problem": hide_passwords(str(error))})

    async def _packing(self, request: Request) -> Response:
        found = await run_in_threadpool(self._feed(request).packing, request.path_params["index"])
        if found is None:
            raise HTTPException(404)
        return JSONResponse(found)

    async def _movie(self, request: Request) -> Response:
        feed, wanted = self._feed(request), _wanted(request)
        if request.method == "POST":
            return JSONResponse(self.movies.start(wanted, feed, await run_in_threadpool(feed.status)))
        return JSONResponse(self.movies.state(wanted))

    async def _movie_file(self, request: Request) -> Response:
        file = self.movies.file(request.path_params["name"])
        if file is None:
            raise HTTPException(404)
        return FileResponse(file, media_type="image/gif")

    def _feed(self, request: Request) -> CampaignFeed:
        number: int = request.path_params["campaign"]
        if number >= len(self.hub.feeds):
            raise HTTPException(404)
        return self.hub.feeds[number]


def _static(kind: str, text: str) -> Callable[[Request], Response]:
    """Give what answers always the same."""

    def answer(_request: Request) -> Response:
        return Response(text, media_type=kind)

    return answer


def _fixed(hub: Hub) -> dict[str, tuple[str, str]]:
    """Type and text of the page, its style and its script, by their addresses; they are made of the report's own."""
    environment = Environment(
        loader=ChoiceLoader([PackageLoader("calcidem.app.serve"), PackageLoader("calcidem.app.report")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("live.html").render(campaigns=len(hub.feeds), remarks=())
    return {
        "/": ("text/html", page),
        "/page.css": ("text/css", environment.get_template("live_page.css").render()),
        "/page.js": ("text/javascript", environment.get_template("live_page.js").render()),
    }


def _wanted(request: Request) -> Wanted:
    """Give the cell that a request is about."""
    try:
        seed = checked_seed(int(request.query_params["seed"]))
        content = canonical_content(float(request.query_params["content"]))
    except (KeyError, ValueError, TypeError) as error:
        raise HTTPException(400) from error
    if not math.isfinite(content) or seed > _LAST_SEED:
        raise HTTPException(400)
    return request.path_params["campaign"], seed, content
