"""The studio as a web application: its routes, its gate, its page."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from bunraku import __version__
from bunraku.errors import BunrakuError
from bunraku.studio.forms.changes import ChangeForm
from bunraku.studio.forms.exports import ClipsForm
from bunraku.studio.forms.takes import TakeForm, TakeRecordForm
from bunraku.studio.jobs import QueueFull
from bunraku.studio.responses import is_full, sentence_of
from bunraku.studio.routes import characters, files, general, library, takes
from bunraku.studio.server.openapi import document_of
from bunraku.studio.server.safety import Guard, Keys
from bunraku.studio.state import State
from bunraku.studio.store import NotThere, Store
from bunraku.studio.uploads import TooLarge

__all__ = ["STATIC", "studio_app"]

READS: dict[tuple[str, str], type] = {
    ("/characters/{name}/takes", "POST"): TakeForm,
    ("/characters/{name}/exports", "POST"): ClipsForm,
    ("/takes/{name}", "PATCH"): TakeRecordForm,
    ("/takes/{name}/change", "POST"): ChangeForm,
}
"""What the body of a route is read as."""
STATIC = Path(__file__).parents[1] / "static"
VIEW = Path(__file__).parents[2] / "render" / "view" / "view.js"
"""The script of `.html` files, from which the page takes three.js."""


def studio_app(folder: Path, keys: Keys | None = None, warm: bool = True) -> Starlette:
    """The application.

    Args:
        folder: Where it keeps its things.
        keys: Who is let in.
        warm: Start the worker with the application, and the sample where there is nothing yet.

    Raises:
        FormatError: The folder cannot be used.
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

    api = [*general.ROUTES, *characters.ROUTES, *takes.ROUTES, *library.ROUTES, *files.ROUTES]
    api.append(("/openapi.json", ("GET",), described))
    app = Starlette(
        routes=[
            Mount(
                "/api", routes=[Route(path, _told(handler), methods=list(methods)) for path, methods, handler in api]
            ),
            Route("/", _page),
            Route("/view.js", _view),
            Mount("/", app=StaticFiles(directory=STATIC)),
        ],
        middleware=[Middleware(Guard, keys=keys)],
        lifespan=lifespan,
        exception_handlers={HTTPException: _no_such_page},
    )
    app.state.studio, app.state.keys = state, keys
    app.state.openapi = document_of(api, __version__, READS)
    return app


async def described(request: Request) -> Any:
    """These routes as an OpenAPI document."""
    return request.app.state.openapi


async def _page(request: Request) -> Response:
    return FileResponse(STATIC / "index.html")


async def _view(request: Request) -> Response:
    return FileResponse(VIEW)


async def _no_such_page(request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 500
    return JSONResponse({"error": "there is nothing at this address", "kind": "NotThere"}, status)


def _told(handler: Callable[[Request], Any]) -> Callable[[Request], Any]:
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
        status = 429 if isinstance(error, QueueFull) else 409 if isinstance(error, files.Newer) else 400
    else:
        logging.getLogger(__name__).error("a request failed", exc_info=error)
        status = 500
    return JSONResponse({"error": sentence_of(error), "kind": type(error).__name__}, status)
