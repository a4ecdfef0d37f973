"""Who may ask: this machine's own browser, with the token that was printed, for pages of this server.

The token of the printed address is exchanged for a strict cookie. Every request is checked for the host it
was meant for (DNS rebinding), for the page it comes from (other sites), for the cookie, and for its size.
"""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from dataclasses import dataclass
from urllib.parse import parse_qs

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from flysid.studio.loopback import HEADERS, POLICY, UNKNOWN, Key, refusal


@dataclass(frozen=True)
class RequestBounds:
    """Of one request's body: bytes, and seconds to wait for the next part of it."""

    body_bytes: int = 1 << 20
    upload_bytes: int = 2 << 30
    seconds: float = 30.0


class Quiet:
    """Time since the last request. A stream of events counts as it begins and ends."""

    def __init__(self) -> None:
        self._since = time.monotonic()
        self._answered = asyncio.Event()

    def restart(self) -> None:
        """A request has come."""
        self._since = time.monotonic()

    def answered(self) -> None:
        """An answer has been given."""
        self.restart()
        self._answered.set()

    async def until_answered(self, seconds: float) -> None:
        """Wait for the first answer, or so long."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self._answered.wait(), seconds)

    async def until_quiet(self, seconds: float) -> None:
        """Wait until nobody has asked for so long."""
        while (left_s := self._since + seconds - time.monotonic()) > 0.0:
            await asyncio.sleep(left_s)


class RequestGuard:
    """Answers itself what may not pass: 401 no cookie, 403 another site, 413 too large, 421 another host."""

    def __init__(self, app: ASGIApp, key: Key, bounds: RequestBounds, quiet: Quiet) -> None:
        self._app = app
        self._key = key
        self._bounds = bounds
        self._quiet = quiet

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            await send({"type": "websocket.close", "code": 1008})
            return
        self._quiet.restart()
        try:
            await self._answer(scope, receive, send)
        finally:
            self._quiet.answered()

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            await refusal(scope, receive, _with_headers(send))
            return
        offered = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        if offered and scope["path"] == "/" and self._key.fits(offered):
            entered = RedirectResponse("/", status_code=303)
            entered.set_cookie(self._key.cookie, self._key.token, httponly=True, samesite="strict")
            await entered(scope, receive, _with_headers(send))
            return
        if not self._key.is_known(headers.get("cookie", "")):
            await PlainTextResponse(UNKNOWN, 401)(scope, receive, _with_headers(send))
            return
        await self._app(scope, self._patient(receive), _with_headers(send))

    def _refusal(self, scope: Scope, headers: Headers) -> PlainTextResponse | None:
        refused = refusal(self._key, headers)
        if refused is not None:
            return PlainTextResponse(refused[1], refused[0])
        if scope["method"] not in ("GET", "HEAD"):
            return self._body_refusal(scope, headers)
        return None

    def _body_refusal(self, scope: Scope, headers: Headers) -> PlainTextResponse | None:
        length = headers.get("content-length", "")
        if not length.isdigit():
            return PlainTextResponse("the length of the body must be stated\n", 411)
        bounds = self._bounds
        most = bounds.upload_bytes if scope["path"].endswith("/uploads") else bounds.body_bytes
        if int(length) > most:
            return PlainTextResponse(f"at most {most:,} bytes\n", 413)
        return None

    def _patient(self, receive: Receive) -> Receive:
        """Waits for a part of the body as long as the bound says; then the client is taken for gone."""
        is_over = False

        async def bounded() -> Message:
            nonlocal is_over
            if is_over:
                return await receive()
            try:
                message = await asyncio.wait_for(receive(), self._bounds.seconds)
            except TimeoutError:
                return {"type": "http.disconnect"}
            is_over = not message.get("more_body", False)
            return message

        return bounded


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.setdefault("Content-Security-Policy", POLICY)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return sending
