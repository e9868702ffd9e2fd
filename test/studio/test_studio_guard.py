"""Who may talk to the workbench: requests as browsers and strangers send them."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from vsense_ros.studio.guard import Guard

TOKEN, PORT = "secret", 8123


async def _inner(scope: Any, receive: Any, send: Any) -> None:
    if scope["type"] == "http":
        while (await receive()).get("more_body"):
            pass
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"ok"})


def ask(
    headers: dict[str, str] | None = None,
    *,
    query: str = "",
    cookie: str = "",
    kind: str = "http",
    body: tuple[bytes, ...] = (b"",),
) -> dict[str, Any]:
    """The first message that a guarded application answers with."""
    sent: list[dict[str, Any]] = []
    given = {"host": f"127.0.0.1:{PORT}", **(headers or {})}
    if cookie:
        given["cookie"] = f"vsense_studio_{PORT}={cookie}"
    scope = {
        "type": kind,
        "method": "GET",
        "path": "/",
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode()) for name, value in given.items()],
    }
    parts = [{"type": "http.request", "body": part, "more_body": i < len(body) - 1} for i, part in enumerate(body)]

    async def receive() -> Any:
        return parts.pop(0)

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(Guard(_inner, token=TOKEN, port=PORT, most_megabytes=1)(scope, receive, send))
    return sent[0]


def test_the_token_of_the_address_becomes_a_cookie_that_scripts_and_other_sites_cannot_use() -> None:
    answer = ask(query=f"token={TOKEN}")
    assert answer["status"] == 303
    cookie = dict(answer["headers"])[b"set-cookie"].decode()
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie


@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_without_the_token_nothing_is_served(kind: str) -> None:
    for answer in (ask(kind=kind), ask(kind=kind, cookie="wrong"), ask(kind=kind, query="token=wrong")):
        assert answer.get("status", answer.get("code")) in (403, 4403)


@pytest.mark.parametrize("kind", ["http", "websocket"])
@pytest.mark.parametrize(
    "headers",
    [
        {"host": "evil.example"},
        {"host": "127.0.0.1:1"},
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},  # of another port of this machine
    ],
)
def test_other_hosts_and_pages_of_other_sites_are_refused_even_with_the_token(
    kind: str, headers: dict[str, str]
) -> None:
    answer = ask(headers, cookie=TOKEN, kind=kind)
    assert answer.get("status", answer.get("code")) in (403, 4403)


def test_its_own_page_is_served() -> None:
    origin = {"origin": f"http://127.0.0.1:{PORT}", "sec-fetch-site": "same-origin"}
    assert ask(origin, cookie=TOKEN)["status"] == 200


def test_an_upload_that_is_too_large_is_refused_by_its_header_and_by_what_arrives() -> None:
    megabyte = b"x" * (1 << 20)
    assert ask({"content-length": "1048577"}, cookie=TOKEN)["status"] == 413
    assert ask({"content-length": "10"}, cookie=TOKEN, body=(megabyte, b"x"))["status"] == 413
    assert ask(cookie=TOKEN, body=(megabyte,))["status"] == 200
