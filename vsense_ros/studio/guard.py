"""Who may talk to the workbench: this machine, with the token of this start, from its own page."""

from __future__ import annotations

import hmac
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

COOKIE = "vsense_studio"
_MEGABYTE = 1 << 20
_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-frame-options", b"DENY"),
    (b"cross-origin-resource-policy", b"same-origin"),
)


class TooLargeError(Exception):
    """A request has more bytes than is allowed."""


class Guard:
    """ASGI middleware that refuses requests of other hosts, other origins, without the token, or that are too large.

    The token comes once, as `?token=…` of the address that the command prints; it is then kept as a cookie that scripts
    cannot read and other sites cannot send.
    """

    def __init__(self, app: Application, *, token: str, port: int, most_megabytes: int) -> None:
        self.app, self.token = app, token
        self.hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost")}
        self.most_bytes = most_megabytes * _MEGABYTE
        self.cookie = f"{COOKIE}_{port}"  # cookies are shared by all ports of a host

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        if refusal := self._refusal(headers):
            await _refuse(scope, send, 403, refusal)
            return
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        if not self._is_token(self._cookie(headers)):
            if scope["type"] == "http" and scope["method"] == "GET" and self._is_token(given):
                await self._let_in(scope, send)
                return
            await _refuse(
                scope, send, 403, "Open the address that `vsense studio` printed: it has the token of this start."
            )
            return
        if given and scope["type"] == "http" and scope["path"] == "/":
            await self._let_in(scope, send)
            return
        if scope["type"] == "websocket":
            await self.app(scope, receive, send)
        else:
            await self._bounded(scope, headers, receive, send)

    def _refusal(self, headers: dict[str, str]) -> str:
        host = headers.get("host", "")
        if host not in self.hosts:
            return "This page answers to 127.0.0.1 and localhost alone."
        origin = headers.get("origin")
        if origin is not None and origin.removeprefix("http://") != host:
            return "A page of another site may not talk to the workbench."
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return "A page of another site may not talk to the workbench."
        return ""

    def _cookie(self, headers: dict[str, str]) -> str:
        try:
            cookies = SimpleCookie(headers.get("cookie", ""))
        except CookieError:
            return ""
        return cookies[self.cookie].value if self.cookie in cookies else ""

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self.token.encode())

    async def _let_in(self, scope: Scope, send: Send) -> None:
        cookie = f"{self.cookie}={self.token}; HttpOnly; SameSite=Strict; Path=/"
        headers = [(b"location", scope["path"].encode() or b"/"), (b"set-cookie", cookie.encode()), *_HEADERS]
        await send({"type": "http.response.start", "status": 303, "headers": headers})
        await send({"type": "http.response.body", "body": b""})

    async def _bounded(self, scope: Scope, headers: dict[str, str], receive: Receive, send: Send) -> None:
        """Pass a request on, and end it where its body grows too large, whatever its header promised."""
        sentence = (
            f"This is larger than the {self.most_bytes // _MEGABYTE} MB that may be uploaded; open it from its folder."
        )
        stated = headers.get("content-length", "0")
        if stated.isdigit() and int(stated) > self.most_bytes:
            await _refuse(scope, send, 413, sentence)
            return
        heard, started = 0, False

        async def bounded_receive() -> Message:
            nonlocal heard
            message = await receive()
            heard += len(message.get("body", b""))
            if heard > self.most_bytes:
                raise TooLargeError
            return message

        async def guarded_send(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                message["headers"] = [*message.get("headers", []), *_HEADERS]
            await send(message)

        try:
            await self.app(scope, bounded_receive, guarded_send)
        except TooLargeError:
            if not started:
                await _refuse(scope, send, 413, sentence)


async def _refuse(scope: Scope, send: Send, status: int, sentence: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 4403, "reason": sentence[:120]})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8"), *_HEADERS]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": sentence.encode()})
