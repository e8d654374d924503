"""Who may talk to the studio: only pages that it served itself, which know the token of its address.

Any page that a browser shows can send requests to this machine. So the token is needed for all that is more than the
page's own files; the `Host` must be this machine (a foreign name that resolves here is refused), the `Origin` the
studio's own; and the page may load and talk to nothing else.
"""

from __future__ import annotations

import hmac
import secrets
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

__all__ = ["Guard", "Keys"]

LOCAL = ("127.0.0.1", "localhost", "::1", "[::1]")
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; media-src 'self' blob:; "
    "connect-src 'self' blob:; font-src 'self'; worker-src 'self' blob:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
OPEN_API = ("/api/login",)


@dataclass(frozen=True)
class Keys:
    """What lets a page in.

    Args:
        token: In the address that is opened.
        password: What others type where the studio is open to other machines; "" keeps it to this one.
        hosts: Names by which the studio may be called; empty allows any, behind a password only.
    """

    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))
    password: str = ""
    hosts: tuple[str, ...] = LOCAL

    def fits(self, given: str) -> bool:
        """Whether this is the token."""
        return hmac.compare_digest(given.encode(), self.token.encode())


class Guard:
    """The gate in front of all routes.

    Args:
        app: What is behind it.
        keys: Who is let in.
    """

    def __init__(self, app: ASGIApp, keys: Keys):
        self.app, self.keys = app, keys

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        if scope["type"] != "http":
            return

        async def answer(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["content-security-policy"] = POLICY
                headers["x-content-type-options"] = "nosniff"
                headers["referrer-policy"] = "no-referrer"
                headers["cross-origin-opener-policy"] = "same-origin"
                headers["cross-origin-resource-policy"] = "same-origin"
                headers.setdefault("cache-control", "no-store")
            await send(message)

        refusal = self._refusal(scope)
        if refusal:
            status, sentence = refusal
            await JSONResponse({"error": sentence, "kind": "Refused"}, status)(scope, receive, answer)
        else:
            await self.app(scope, receive, answer)

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        origin = headers.get("origin")
        try:
            name = urlsplit(f"//{host}").hostname or ""
            source = None if origin is None else urlsplit(origin).netloc
        except ValueError:  # such as "[::1"
            return 400, "the request names no host that can be read; open the address that the studio printed"
        if self.keys.hosts and name not in self.keys.hosts:
            return 403, "the studio answers to this machine's own name only; open the address that it printed"
        if source is not None and source != host:
            return 403, "another page asked for this; the studio answers only to its own page"
        if headers.get("sec-fetch-site") in ("cross-site", "same-site") and scope["path"].startswith("/api"):
            return 403, "another page asked for this; the studio answers only to its own page"
        if not scope["path"].startswith("/api") or scope["path"] in OPEN_API:
            return None
        kind, _, given = headers.get("authorization", "").partition(" ")
        if kind.lower() != "bearer" or not self.keys.fits(given.strip()):
            return (
                401,
                "the address lacks its token, or it is that of an earlier run; open the address that was printed",
            )
        return None
