"""Who may see the page: whoever has the token that is in the printed address, and nobody through a foreign page."""

import ipaddress
import secrets
import socket
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from calcidem.app.serve.address import PageAddress

_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; style-src-attr 'unsafe-inline'; "
        "img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Of every answer: no script but the page's own, no address told to others, nothing kept by the browser."""

_REFUSAL = "Open this page with the whole address that calcidem has printed; it ends with ?token=... .\n"


class Guard:
    """Lets those in who know the token: in the address of the first request, then in a cookie.

    Parameters
    ----------
    application
        What it guards.
    address
        Of the server, with the token.
    """

    def __init__(self, application: ASGIApp, address: PageAddress) -> None:
        self._application = application
        self._token = address.token.encode()
        self._cookie = f"calcidem_{address.port}"  # the cookies of a host go to all of its ports
        self._names = {"localhost", address.host.lower(), socket.gethostname().lower(), socket.getfqdn().lower()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or let it through."""
        if scope["type"] != "http":
            return

        async def send_safely(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(_HEADERS)
            await send(message)

        answer = self._answer(scope) or self._application
        await answer(scope, receive, send_safely)

    def _answer(self, scope: Scope) -> Response | None:
        """Give the answer to a request that is not let through."""
        headers = Headers(scope=scope)
        if not self._is_own_name(headers.get("host", "")):
            # A foreign page whose name was made to point here is a page of that name for the browser.
            return PlainTextResponse("Open this page under the name that calcidem has printed.\n", 403)
        offered = parse_qs(scope["query_string"].decode("ascii", "replace")).get("token", [""])[0]
        if scope["path"] == "/" and self._is_token(offered):
            answer = RedirectResponse("/", 303)  # so that the token is neither in the history nor in the address bar
            answer.set_cookie(self._cookie, self._token.decode(), httponly=True, samesite="lax", path="/")
            return answer
        if not self._is_token(_cookie_of(headers, self._cookie)) or _is_foreign(scope, headers):
            return PlainTextResponse(_REFUSAL, 403)
        return None

    def _is_token(self, text: str) -> bool:
        return secrets.compare_digest(text.encode("utf-8", "replace"), self._token)

    def _is_own_name(self, host: str) -> bool:
        """Whether a Host header has one of our names, or an address: addresses can't be made to point elsewhere."""
        name = host.rpartition(":")[0] if not host.endswith("]") and ":" in host else host
        name = name.strip("[]").lower()
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name in self._names
        return True


def _cookie_of(headers: Mapping[str, str], name: str) -> str:
    try:
        found = SimpleCookie(headers.get("cookie", "")).get(name)
    except CookieError:
        return ""
    return "" if found is None else found.value


def _is_foreign(scope: Scope, headers: Mapping[str, str]) -> bool:
    """Whether a request that changes something comes from a page of another origin."""
    if scope["method"] in {"GET", "HEAD"}:
        return False
    origin = headers.get("origin", "")
    return headers.get("sec-fetch-site", "same-origin") != "same-origin" or (
        bool(origin) and origin.partition("://")[2] != headers.get("host")
    )
