"""The studio as a web application: its routes and their OpenAPI document, its page, and a gate for that page only."""

from __future__ import annotations

import contextlib
import hmac
import inspect
import logging
import re
import secrets
import types
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints
from urllib.parse import urlsplit

from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from bunraku import __version__
from bunraku.errors import BunrakuError
from bunraku.studio.jobs import QueueFull
from bunraku.studio.routes import characters, general, takes
from bunraku.studio.routes.reading import TooLarge
from bunraku.studio.state import State
from bunraku.studio.store import NotThere, Store
from bunraku.studio.worker import is_full, page_sentence

LOCAL = ("127.0.0.1", "localhost", "::1", "[::1]")
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; media-src 'self' blob:; "
    "connect-src 'self' blob:; font-src 'self'; worker-src 'self' blob:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
OPEN_API = ("/api/login",)


@dataclass(frozen=True)
class Keys:
    """What lets a page in."""

    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))  # in the address that is opened
    password: str = ""  # for other machines; "" keeps the studio to this one
    hosts: tuple[str, ...] = LOCAL  # names by which the studio may be called; empty allows any, behind a password only

    def fits(self, given: str) -> bool:
        """Whether this is the token."""
        return hmac.compare_digest(given.encode(), self.token.encode())


class Guard:
    """The gate in front of all routes of an application; its keys let a page in."""

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


Routes = Iterable[tuple[str, tuple[str, ...], Callable[..., Any]]]
_PLAIN = {str: "string", bool: "boolean", int: "integer", float: "number", type(None): "null"}
_ERROR = {
    "description": "What is wrong, one sentence.",
    "content": {"application/json": {"schema": {
        "type": "object", "properties": {"error": {"type": "string"}, "kind": {"type": "string"}},
    }}},
}  # fmt: skip


def schema_of(kind: Any) -> dict[str, Any]:
    """The JSON schema of a type: plain ones, lists, literals, dataclasses."""
    if kind in _PLAIN:
        return {"type": _PLAIN[kind]}
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Literal:
        return {"enum": list(inner)}
    if origin in (Union, types.UnionType):
        return {"anyOf": list(map(schema_of, inner))}
    if origin in (list, tuple):
        if origin is list or inner[-1] is Ellipsis:
            return {"type": "array", "items": schema_of(inner[0])}
        bounds = {"minItems": len(inner), "maxItems": len(inner)}
        return {"type": "array", "prefixItems": list(map(schema_of, inner)), **bounds}
    if origin in (dict, Mapping):
        return {"type": "object"}
    if is_dataclass(kind) and isinstance(kind, type):
        hints = get_type_hints(kind)
        properties = {field.name: schema_of(hints[field.name]) for field in fields(kind)}
        needed = [field.name for field in fields(kind) if field.default is MISSING and field.default_factory is MISSING]
        about = {"title": kind.__name__, "description": inspect.getdoc(kind) or ""}
        return {"type": "object", **about, "properties": properties, **({"required": needed} if needed else {})}
    return {}


def document_of(routes: Routes, version: str) -> dict[str, Any]:
    """The OpenAPI document of routes; handlers' docstrings say what these do, and their `form` what a body is read
    as.
    """
    paths: dict[str, dict[str, Any]] = {}
    for path, methods, handler in routes:
        summary = (inspect.getdoc(handler) or "").split("\n\n")[0].replace("\n", " ")
        for method in methods:
            entry: dict[str, Any] = {
                "operationId": f"{handler.__name__}_{method.lower()}", "summary": summary,
                "responses": {"200": {"description": "What was asked for."},
                              "202": {"description": "The job that was begun; `/jobs/{name}` tells of it."},
                              "4XX": _ERROR, "5XX": _ERROR},
            }  # fmt: skip
            names = re.findall(r"{(\w+)", path)
            if names:
                entry["parameters"] = [
                    {"name": name, "in": "path", "required": True, "schema": {"type": "string"}} for name in names
                ]
            form = getattr(handler, "form", None)
            if form is not None and method not in ("GET", "DELETE"):
                entry["requestBody"] = {"content": {"application/json": {"schema": schema_of(form)}}}
            paths.setdefault(re.sub(r"{(\w+):\w+}", r"{\1}", path), {})[method.lower()] = entry
    return {
        "openapi": "3.1.0",
        "info": {"title": "Bunraku studio", "version": version},
        "servers": [{"url": "/api"}],
        "security": [{"token": []}],
        "components": {"securitySchemes": {"token": {"type": "http", "scheme": "bearer"}}},
        "paths": paths,
    }


STATIC = Path(__file__).parents[1] / "static"
VIEW = Path(__file__).parents[2] / "render" / "view" / "view.js"
"""The script of `.html` files, from which the page takes three.js."""


def studio_app(folder: Path, keys: Keys | None = None, warm: bool = True) -> Starlette:
    """The application, which keeps everything in a folder, FormatError where that cannot be used. A new token lets a
    page in where `keys` is None. With `warm` the worker starts with it, and the sample where there is nothing yet.
    """
    keys = keys or Keys()
    state = State(Store(folder))

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        if warm:
            state.start()
        try:
            yield
        finally:
            state.stop()

    routes = [Route(path, _answered(handler), methods=list(methods)) for path, methods, handler in API]
    pages = [Route("/view.js", _view), Mount("/", app=StaticFiles(directory=STATIC, html=True))]
    app = Starlette(
        routes=[Mount("/api", routes=routes), *pages], middleware=[Middleware(Guard, keys=keys)], lifespan=lifespan,
        exception_handlers={HTTPException: _no_such_page},
    )  # fmt: skip
    app.state.studio, app.state.keys, app.state.tries = state, keys, {}
    return app


async def described(request: Request) -> Any:
    """These routes as an OpenAPI document."""
    return document_of(API, __version__)


API: Routes = (*general.ROUTES, *characters.ROUTES, *takes.ROUTES, ("/openapi.json", ("GET",), described))


async def _view(request: Request) -> Response:
    return FileResponse(VIEW)


async def _no_such_page(request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 500
    return JSONResponse({"error": "there is nothing at this address", "kind": "NotThere"}, status)


def _answered(handler: Callable[[Request], Any]) -> Callable[[Request], Any]:
    """A route whose errors are sentences."""

    async def route(request: Request) -> Response:
        try:
            answer = await handler(request)
        except Exception as error:
            return _answer(error)
        return answer if isinstance(answer, Response) else JSONResponse(answer)

    return route


def _answer(error: Exception) -> Response:
    if isinstance(error, NotThere):
        status = 404
    elif isinstance(error, TooLarge):
        status = 413
    elif is_full(error):
        status = 507
    elif isinstance(error, BunrakuError):
        status = 429 if isinstance(error, QueueFull) else 409 if isinstance(error, general.Newer) else 400
    else:
        logging.getLogger(__name__).error("a request failed", exc_info=error)
        status = 500
    return JSONResponse({"error": page_sentence(error), "kind": type(error).__name__}, status)
