"""The compiled loops of `kernels.c`: built once by the installed C compiler, and kept for the next process."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

VARIABLE = "BUNRAKU_KERNELS"
SOURCE = Path(__file__).with_name("kernels.c")
# Infinities mark empty texels, so of the fast-math rules only those that respect them.
FLAGS = (
    "-O3", "-std=gnu99", "-shared", "-fno-strict-aliasing", "-fno-math-errno", "-fno-trapping-math",
    "-freciprocal-math", "-fno-signed-zeros",
)  # fmt: skip


class Native(NamedTuple):
    """The compiled loops, or None where numpy draws instead, and the reason."""

    library: ctypes.CDLL | None
    reason: str


@cache
def native() -> Native:
    """The compiled loops, built by the first call; the environment variable BUNRAKU_KERNELS=numpy disables them."""
    if os.environ.get(VARIABLE, "").strip().lower() == "numpy":
        return Native(None, f"{VARIABLE} asks for numpy")
    text = SOURCE.read_bytes() + repr(FLAGS).encode()
    mark = hashlib.sha256(text + platform.machine().encode()).hexdigest()[:16]
    name = f"bunraku-kernels-{mark}{'.dll' if sys.platform == 'win32' else '.so'}"
    compiler = next((program for word in ("cc", "gcc", "clang") if (program := shutil.which(word))), None)
    for folder in _folders():
        path = folder / name
        try:
            if not path.is_file():
                if compiler is None:
                    continue
                folder.mkdir(parents=True, exist_ok=True, mode=0o700)
                compile_kernels(compiler, path)
            if not _ours(path):
                continue
            return Native(ctypes.CDLL(str(path)), str(path))
        except (OSError, subprocess.SubprocessError):
            continue
    if compiler is None:
        return Native(None, "there is no C compiler (cc, gcc or clang)")
    return Native(None, f"{compiler} could not build {SOURCE.name}")


def _folders() -> list[Path]:
    """Folders for the compiled loops: beside their source, or the user's cache."""
    cache_home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or ""
    home = Path(cache_home) if cache_home else Path(os.path.expanduser("~")) / ".cache"
    return [SOURCE.parent / "__pycache__", home / "bunraku"]


def _ours(path: Path) -> bool:
    """Whether only this user or root can have put this file here."""
    if sys.platform == "win32":
        return True
    return path.stat().st_uid in (0, os.getuid()) and not path.stat().st_mode & 0o022


def compile_kernels(compiler: str, path: Path) -> None:
    """Build the loops as a shared library, which appears whole or not at all.

    Raises:
        OSError: The compiler, one with the options of gcc, cannot be started, or the folder not written.
        subprocess.SubprocessError: It failed.
    """
    handle, name = tempfile.mkstemp(prefix=".kernels-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    try:
        position = () if sys.platform == "win32" else ("-fPIC",)
        command = [compiler, *FLAGS, *position, str(SOURCE), "-o", name, "-lm"]
        subprocess.run(command, check=True, capture_output=True, stdin=subprocess.DEVNULL, timeout=60)
        os.chmod(name, 0o755)
        os.replace(name, path)
    finally:
        with suppress(FileNotFoundError):
            os.unlink(name)
