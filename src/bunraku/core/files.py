"""Reading files within bounds, paths that stay in their folder, and writing that leaves nothing half-done."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import BinaryIO
from urllib.parse import unquote

from bunraku.errors import FormatError

MAX_BYTES = 2 << 30
"""Largest file that is read [bytes]."""

STALE = 3600.0
"""Seconds after which a temporary file counts as abandoned."""
_TEMPORARY = re.compile(r"\..+\.(?P<machine>[0-9a-f]{6})-(?P<process>\d{1,10})-[a-z0-9_]{8}\.tmp", re.DOTALL)

MAX_TEXT_BYTES = 400 << 20
"""Largest mesh or motion that is read as text [bytes]: words take some ten times their file's memory."""

_open: ContextVar[tuple[ExitStack, dict[Path, BinaryIO]] | None] = ContextVar("open", default=None)
"""Files that stay open within `open_once`."""


@contextmanager
def open_once() -> Iterator[None]:
    """Within the block each file is opened once, so that the bytes that name a format are those that are read."""
    with ExitStack() as stack:
        before = _open.set((stack, {}))
        try:
            yield
        finally:
            _open.reset(before)


@contextmanager
def open_input(path: Path) -> Iterator[BinaryIO]:
    """A file to be read from its beginning; within `open_once` the one that is open already."""
    already_open = _open.get()
    if already_open is None:
        with path.open("rb") as file:
            yield file
        return
    stack, files = already_open
    if path not in files:
        files[path] = stack.enter_context(path.open("rb"))
    files[path].seek(0)
    yield files[path]


def check_input(path: Path) -> int:
    """Size of a file that can be read [bytes]. FormatError if the file is missing, a folder, not a plain file, empty,
    or larger than `MAX_BYTES`.
    """
    try:
        status = path.stat()
    except FileNotFoundError:
        raise FormatError(path, "there is no such file; check the path") from None
    except (OSError, ValueError) as error:
        raise FormatError(path, f"it cannot be opened ({_reason(error)}); check the path and its permissions") from None
    if stat.S_ISDIR(status.st_mode):
        raise FormatError(path, "this is a folder; name a file inside it")
    if not stat.S_ISREG(status.st_mode):
        raise FormatError(path, "this is not a plain file; copy it to a file on disk first")
    if status.st_size == 0:
        raise FormatError(path, "the file is empty; export it again")
    if status.st_size > MAX_BYTES:
        size = f"{status.st_size / 2**30:.1f} GiB"
        raise FormatError(
            path, f"the file has {size} but at most {MAX_BYTES >> 30} GiB are read; simplify the mesh first"
        )
    return status.st_size


def check_text(path: Path, data: bytes) -> None:
    """Raise FormatError for a text mesh of more than `MAX_TEXT_BYTES`."""
    if len(data) > MAX_TEXT_BYTES:
        most = f"at most {MAX_TEXT_BYTES >> 20}"
        raise FormatError(
            path, f"{len(data) >> 20} MiB of text are too many, {most} are read; save it as GLB or binary PLY"
        )


def read_bounded(path: Path) -> bytes:
    """All bytes of a file of at most `MAX_BYTES`.

    Raises:
        FormatError: As `check_input`, or the file cannot be read.
    """
    size = check_input(path)
    try:
        with path.open("rb") as file:
            return file.read(size)  # a larger number would be set aside in memory first
    except OSError as error:
        raise FormatError(path, f"the file cannot be read ({_reason(error)}); check its permissions") from None


def path_inside(folder: Path, uri: str) -> Path | None:
    """The file that a relative URI names in a folder or below it, or None where it points elsewhere: URLs, absolute
    paths, `..`, and links that lead out of the folder.
    """
    name = unquote(uri).replace("\\", "/")
    if not name or "\0" in name or ".." in name.split("/") or re.match(r"/|[A-Za-z][A-Za-z0-9+.\-]*:", name):
        return None
    try:
        target = (folder / name).resolve()
        return target if target.is_relative_to(folder.resolve()) else None
    except (OSError, RuntimeError):
        return None


def check_output_folder(path: Path) -> None:
    """Make sure that the folder of an output exists, creating its last level where only that is missing. FormatError if
    the folder cannot be created, or the path is a folder itself.
    """
    if "\0" in str(path):
        raise FormatError(path, "the path holds a zero byte; choose another name")
    if os.path.isdir(path):  # unlike Path.is_dir, no name makes it raise
        raise FormatError(path, "this is a folder; name a file inside it")
    if os.path.exists(path) and not os.path.isfile(path):
        raise FormatError(path, "this exists and is not a plain file; choose another name")
    folder = path.parent
    if os.path.isdir(folder):
        return
    if not os.path.isdir(folder.parent):
        raise FormatError(path, f"the folder {folder} does not exist; create it first")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise FormatError(path, f"{folder} cannot be created ({_reason(error)}); choose another folder") from None


@contextmanager
def writing(path: Path, what: str = "file") -> Iterator[None]:
    """Turn the system's refusal of what a block writes to a path into one sentence, a FormatError."""
    try:
        yield
    except OSError as error:
        problem = f"the {what} cannot be written ({_reason(error)})"
        raise FormatError(path, f"{problem}; choose another folder or free some space") from None


def share_file(path: Path, most: int = 0o666) -> None:
    """Give a temporary file, which only its owner can read, the rights that new files have; 0o777 for a folder."""
    mask = os.umask(0)
    os.umask(mask)
    os.chmod(path, most & ~mask)


@contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """A binary file beside the target that replaces it when the block ends, and vanishes when the block fails.
    FormatError if the folder is missing or cannot be written, or the disk is full.
    """
    check_output_folder(path)
    temporary = ""
    with writing(path):
        try:
            descriptor, temporary = tempfile.mkstemp(prefix=temporary_prefix(path.name), suffix=".tmp", dir=path.parent)
            with os.fdopen(descriptor, "wb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())  # a name never stands for what is not on the disk yet
            share_file(Path(temporary))
            os.replace(temporary, path)
        finally:
            if temporary:
                with suppress(OSError):
                    os.unlink(temporary)


def remove_leftovers(folder: Path) -> int:
    """Remove what killed processes left half-done with `atomic_write` in a folder, and return how many files.

    These are files of processes of this machine that are gone, and any that have not changed for an hour.
    """
    removed = 0
    with suppress(OSError):  # no folder, nothing left
        for entry in os.scandir(folder):
            match = _TEMPORARY.fullmatch(entry.name)
            if match is None or not entry.is_file(follow_symlinks=False):
                continue
            with suppress(OSError):
                gone = match["machine"] == _machine() and not is_alive(int(match["process"]))
                if gone or time.time() - entry.stat().st_mtime > STALE:
                    os.unlink(entry.path)
                    removed += 1
    return removed


def temporary_prefix(name: str) -> str:
    """How the name of a temporary file of this process begins, for `remove_leftovers`; the name ends with .tmp."""
    return f".{name[:100]}.{_machine()}-{os.getpid()}-"


def _machine() -> str:
    return hashlib.sha256(platform.node().encode()).hexdigest()[:6]


def is_alive(process: int) -> bool:
    """Whether a process of this machine runs. One that has ended, but whose parent has not collected it, does not."""
    if os.name == "nt":  # where os.kill ends the process
        import ctypes

        kernel = ctypes.windll.kernel32  # type: ignore[attr-defined,unused-ignore]
        handle = kernel.OpenProcess(0x1000, False, process)
        return bool(handle and kernel.CloseHandle(handle))
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # another user's
        return True
    with suppress(OSError):  # elsewhere than on Linux the system alone knows
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    return True


def _reason(error: Exception) -> str:
    return (getattr(error, "strerror", None) or str(error)).lower()


PACKAGE_WEIGHTS = Path(__file__).resolve().parents[1] / "weights"
"""The folder of the checkpoints that come with Bunraku."""


def weights_file(name: str) -> Path:
    """Path of a file of weights, such as "diffusion.safetensors": in the package, or in the first folder that has it of
    those that the environment variable BUNRAKU_WEIGHTS names, separated as in PATH; an empty entry is the package's own
    folder.
    """
    named = os.environ.get("BUNRAKU_WEIGHTS", "")
    folders = [Path(folder) if folder else PACKAGE_WEIGHTS for folder in named.split(os.pathsep)]
    return next((path for folder in folders if (path := folder / name).is_file()), folders[0] / name)
