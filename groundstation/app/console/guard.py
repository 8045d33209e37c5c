"""Who may speak to the console's server: asked of every request and every WebSocket, before anything else is.

A page needs a key: the viewer's or the operator's. It comes once, in the address, and is a cookie afterwards that no
script reads and no other site sends. The name by which the server was called and the page that a request comes from
have to be the console's own: a page of another site, and one whose name was bent to this machine, get nowhere.
"""

from __future__ import annotations

import hmac
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from dataclasses import dataclass
from enum import Enum
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

Scope = MutableMapping[str, object]
Message = MutableMapping[str, object]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]


class Role(Enum):
    """What somebody at a page may do."""

    VIEWER = "viewer"
    OPERATOR = "operator"


@dataclass(frozen=True)
class Keys:
    """What is let in.

    Attributes:
        viewer, operator: the secrets.
        hosts: ``name:port`` by which the server may be called.
        cookie: name of the cookie, another one for each port.
        paths: whoever came there with a key is sent on to the same; from everywhere else to the first page.
    """

    viewer: str
    operator: str
    hosts: frozenset[str]
    cookie: str
    paths: frozenset[str] = frozenset()

    def role(self, secret: str) -> Role | None:
        """Whose secret it is."""
        given = secret.encode("utf-8", "surrogateescape")
        for own, role in ((self.operator, Role.OPERATOR), (self.viewer, Role.VIEWER)):
            if hmac.compare_digest(own.encode(), given):
                return role
        return None

    def role_of_cookies(self, header: str) -> Role | None:
        """Who somebody is by the cookies that came along."""
        try:
            morsel = SimpleCookie(header).get(self.cookie)
        except CookieError:
            return None
        return None if morsel is None else self.role(morsel.value)

    def judge(self, host: str, origin: str | None) -> str:
        """Why a request is refused for where it comes from, "" when it is not.

        Args:
            host: the server's name as the browser has it.
            origin: the page that asks, None where the browser names none.
        """
        if host not in self.hosts:
            return f"the console is not called {host}; it is {', '.join(sorted(self.hosts))}"
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return f"a page of {origin} may not speak to this console"
        return ""


class Guard:
    """Stands before the server's application.

    Args:
        app: what is guarded.
        keys: what is let in.
    """

    def __init__(self, app: App, keys: Keys) -> None:
        self.app, self._keys = app, keys

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Lets a request through, turns a key into a cookie, or refuses."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        host, origin, cookies = (_header(scope, name) for name in (b"host", b"origin", b"cookie"))
        why = self._keys.judge(host or "", origin)
        role = self._keys.role_of_cookies(cookies or "")
        query = scope.get("query_string")
        token = parse_qs(query.decode("latin-1")).get("token", [""])[0] if isinstance(query, bytes) else ""
        if not why and scope["type"] == "http" and token and self._keys.role(token):
            cookie = f"{self._keys.cookie}={token}; Path=/; HttpOnly; SameSite=Strict"
            path = scope.get("path")
            onward = path if isinstance(path, str) and path in self._keys.paths else "/"
            await _answer(send, 303, "", [(b"location", onward.encode()), (b"set-cookie", cookie.encode())])
            return
        if not why and role is None:
            why = "open the address that gs console has printed: it holds the key, ?token=..."
        if not why:
            await self.app(scope, receive, send)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008, "reason": why[:120]})
        else:
            await _answer(send, 403, f"gs console: {why}\n", [])


def _header(scope: Scope, wanted: bytes) -> str | None:
    """A header that is there once; one that is there twice is as good as a wrong one."""
    headers = scope.get("headers")
    found = [value for name, value in headers if name == wanted] if isinstance(headers, Iterable) else []
    return None if not found else " ".join(value.decode("latin-1") for value in found)


async def _answer(send: Send, status: int, text: str, headers: list[tuple[bytes, bytes]]) -> None:
    start = [(b"content-type", b"text/plain; charset=utf-8"), (b"cache-control", b"no-store"), *headers]
    await send({"type": "http.response.start", "status": status, "headers": start})
    await send({"type": "http.response.body", "body": text.encode()})
