"""Access control of the page's server: requests need a secret token.

A page of another site must not reach it: not by a form or a script (`Origin`), not by a
name that it lets point here (`Host`), and not without the token of the address.
"""

from __future__ import annotations

import ipaddress
import re
import secrets
from collections.abc import Collection, Mapping
from typing import Literal

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

#: A request with a longer body is refused [byte].
LARGEST_BODY = 256_000
#: Names of this computer that need not be stated.
_LOOPBACK = ("localhost", "127.0.0.1", "::1")

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: "
    "blob:; font-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
HEADERS = {
    "content-security-policy": POLICY,
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "cache-control": "no-store",
}


#: Host and port of a header: an address in brackets, or a name without any of `@[]/`.
_HOST = re.compile(r"(\[(?P<six>[0-9a-fA-F:.]+)\]|(?P<name>[\w.-]+))(:\d{1,5})?")


def new_token() -> str:
    """Random token for the address of the page, which cannot be guessed."""
    return secrets.token_urlsafe(24)


def host_of(header: str) -> str:
    """Host name in a `Host` header, without port; empty if the header is invalid."""
    match = _HOST.fullmatch(header)
    return (match["six"] or match["name"]).lower() if match else ""


def _is_number(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


class Guard:
    """Middleware that refuses requests without token, from other sites, or too big."""

    def __init__(
        self,
        app: ASGIApp,
        *,
        token: str,
        hosts: Collection[str] = (),
        beyond: bool = False,
    ) -> None:
        self._app, self._token = app, token
        self._hosts = {*_LOOPBACK, *(host.lower() for host in hosts)}
        self._beyond = beyond

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, refuse it, or pass it on."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        status = self._refused(scope["type"], headers, scope["path"])
        if status:
            await _refuse(scope, receive, send, *status)
            return
        path = scope["path"][len(self._token) + 1 :] or "/"
        inner = {**scope, "path": path, "raw_path": path.encode()}
        await self._app(inner, _limited(receive), _with_headers(send))

    def _refused(
        self, kind: Literal["http", "websocket"], headers: Mapping[str, str], path: str
    ) -> tuple[int, str] | None:
        host = headers.get("host", "")
        name = host_of(host)
        if name not in self._hosts and not (self._beyond and _is_number(name)):
            return 421, "this server does not go by that name"
        origin = headers.get("origin")
        if origin is None:
            # Browsers name the origin of every websocket, and of what changes things.
            if kind == "websocket":
                return 403, "a websocket needs its Origin"
            if headers.get("sec-fetch-site", "same-origin") == "cross-site":
                return 403, "this comes from another site"
        elif origin.lower() != f"http://{host.lower()}":
            return 403, "this comes from another site"
        first = path.removeprefix("/").partition("/")[0]
        if not secrets.compare_digest(first.encode(), self._token.encode()):
            return 404, "there is nothing here; use the whole address with its token"
        length = headers.get("content-length", "0")
        if not length.isdigit() or int(length) > LARGEST_BODY:
            return 413, f"a request has at most {LARGEST_BODY} bytes"
        return None


def _limited(receive: Receive) -> Receive:
    """ASGI receive function that disconnects if the body of a request is too large."""
    remaining = LARGEST_BODY

    async def limited() -> Message:
        nonlocal remaining
        message = await receive()
        remaining -= len(message.get("body", b""))
        if remaining < 0:
            return {"type": "http.disconnect"}
        return message

    return limited


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            present = {name.lower() for name, _ in message["headers"]}
            message["headers"] = [
                *message["headers"],
                *(
                    (name.encode(), value.encode())
                    for name, value in HEADERS.items()
                    if name.encode() not in present
                ),
            ]
        await send(message)

    return sending


async def _refuse(
    scope: Scope, receive: Receive, send: Send, status: int, reason: str
) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": reason})
        return
    response = PlainTextResponse(reason, status_code=status, headers=dict(HEADERS))
    await response(scope, receive, send)
