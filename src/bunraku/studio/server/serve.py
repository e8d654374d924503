"""Start the studio: a socket of this machine, the server, and the browser."""

from __future__ import annotations

import os
import secrets
import socket
import sys
import threading
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from bunraku.errors import BunrakuError, MissingExtraError, OptionError

LOCK = ".held"
"""The file in the studio's folder that says which process has it."""

WEAKEST = 8
"""Fewest letters of a password."""
IDLE = 75
"""Seconds for which a line stays open whose client says nothing, or does not end what it says. A page on a slow machine
asks less often than every five seconds, which is uvicorn's own bound.
"""


@contextmanager
def held_folder(folder: Path, address: str) -> Iterator[None]:
    """While this lasts, no other studio keeps its things in the folder; OptionError that says which one does."""
    descriptor = _locked(folder, address)
    try:
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _locked(folder: Path, address: str) -> int | None:
    """The open file that holds the folder; None where it can only be read, and where the system has no such locks."""
    try:
        import fcntl  # not on Windows

        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o600)
    except (OSError, ImportError):
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        holder = os.read(descriptor, 200).decode("utf-8", "replace") or "another process"
        os.close(descriptor)
        raise OptionError(
            f"{folder}: a studio keeps its things here already ({holder}); use that one, or start this one with "
            "another --folder"
        ) from None
    with suppress(OSError):  # a full disk: the folder is held, and its holder is not named
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"process {os.getpid()} at {address}".encode())
    return descriptor


def serve(folder: Path, *, port: int = 8734, host: str = "127.0.0.1", password: str = "", browser: bool = True) -> None:
    """Serve the studio until Ctrl-C.

    Args:
        folder: Where it keeps its things.
        port: Where it listens; the next free one where that is taken; 0 for any.
        host: Address to listen at; all but this machine's own needs a password, which others type.
        browser: Open the page.

    Raises:
        MissingExtraError: Starlette or uvicorn is not installed.
        OptionError: Others are to be let in without a password.
        FormatError: The folder cannot be used.
    """
    try:
        import uvicorn  # noqa: F401
    except ImportError:
        raise MissingExtraError("uvicorn", "studio", "the studio") from None
    try:
        from bunraku.studio.server.app import LOCAL, STATIC, Keys, studio_app
    except ImportError as error:
        if (error.name or "").partition(".")[0] == "starlette":
            raise MissingExtraError("starlette", "studio", "the studio") from None
        raise
    local = host in LOCAL
    if not local and len(password) < WEAKEST:
        raise OptionError(
            f"--host {host} lets others in, so it needs a password of at least {WEAKEST} letters: set the variable "
            "BUNRAKU_STUDIO_PASSWORD"
        )
    if not (STATIC / "index.html").is_file():
        raise BunrakuError("the studio's page is not in this installation; install Bunraku again, or run `make studio`")
    keys = Keys(password=password, hosts=LOCAL if local else (), token=secrets.token_urlsafe(24))
    listener = _listen(host, port)
    address = f"http://{'localhost' if local else host}:{listener.getsockname()[1]}/"
    try:
        with held_folder(folder, address):
            _run(studio_app(folder, keys), listener, f"{address}#token={keys.token}", folder, browser)
    finally:
        listener.close()
        sys.stdout.flush()


def _run(app: Any, listener: socket.socket, address: str, folder: Path, browser: bool) -> None:
    """Serve the application, and print where it is."""
    import uvicorn

    from bunraku.studio.server.lines import Line

    print(f"studio: {address}")
    print(f"folder: {folder}")
    store = app.state.studio.store
    for line in (store.trouble, *store.set_aside):
        if line:
            print(f"note: {line}")
    print("press Ctrl-C to end it", flush=True)

    class Server(uvicorn.Server):
        """Opens the page when it is up."""

        async def startup(self, sockets: list[Any] | None = None) -> None:
            await super().startup(sockets)
            if browser:
                threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

    config = uvicorn.Config(
        app, log_level="warning", access_log=False, server_header=False, timeout_graceful_shutdown=2, lifespan="on",
        timeout_keep_alive=IDLE, http=Line,
    )  # fmt: skip
    try:
        Server(config).run(sockets=[listener])
    except KeyboardInterrupt:  # how it is meant to end
        print("ended")


def _listen(host: str, port: int) -> socket.socket:
    """A listening socket at a port, or at the next free one after it; OptionError where none of twenty is free, or the
    address is not this machine's.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    last: OSError | None = None
    for number in range(port, port + 20 if port else 1):
        listener = socket.socket(family, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, number))
            listener.listen(128)
            return listener
        except OSError as error:
            last = error
            listener.close()
    assert last is not None
    raise OptionError(
        f"--port {port}: nothing can listen there ({(last.strerror or str(last)).lower()}); choose another"
    )
