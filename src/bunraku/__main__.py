"""`python -m bunraku`, and what the command `bunraku` calls. Parts of numpy and scipy are loaded when they are first
used, and Ctrl-C ends the process with one line from its first moment.
"""

from __future__ import annotations

import signal
import sys
from typing import TYPE_CHECKING, NoReturn

from bunraku.core.interrupt import exit_interrupted, interrupt, watch_interrupts

if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType
    from typing import Any

QUICK = ("animate", "edit", "inspect", "render", "rig", "samples", "transfer")
"""Commands that take seconds, so that the time of loading counts."""
LAZY_MODULES = frozenset({
    "numpy.ctypeslib", "numpy.f2py", "numpy.fft", "numpy.ma", "numpy.polynomial", "numpy.testing",
    "scipy.sparse.csgraph", "scipy.spatial", "scipy.spatial.transform",
})  # fmt: skip
LAZY_PARTS = {
    "scipy.sparse.csgraph.connected_components": "scipy.sparse.csgraph._traversal",
    "scipy.sparse.csgraph.dijkstra": "scipy.sparse.csgraph._shortest_path",
    "scipy.spatial.cKDTree": "scipy.spatial._ckdtree",
}
"""Names of lazy packages, and the modules inside that define them: such a name is loaded without the package, which
would load all of `scipy.linalg` and `scipy.special`. Where a version of scipy has it elsewhere, the package is loaded.
"""
OBJECTS = 50_000
"""New objects after which Python collects garbage. Imports make a million objects, and none of them is garbage."""
_status: int | None = None


def lazy_imports(words: Sequence[str]) -> None:
    """Make every command end quickly, and those of `QUICK` start quickly: their modules are loaded when they are used.

    Args:
        words: The command line after the program's name.
    """
    import atexit

    atexit.register(_exit_now)  # the first, which runs as the last
    if not words or words[0] not in QUICK:
        return
    import gc
    import os

    # Products of a few thousand numbers are too short to share among threads, whose waiting takes half of the
    # processor from the thread that works; and one thread adds in the same order on every machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(OBJECTS)
    sys.meta_path.insert(0, _finder())


def exit_fast(status: int) -> NoReturn:
    """Leave with an exit status, without Python's own clean-up, which takes 0.2 s or more."""
    global _status
    _status = status
    sys.exit(status)


def _exit_now() -> None:
    import os
    from contextlib import suppress

    if _status is not None:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError, AttributeError):  # there is no stream, or its reader is gone
                stream.flush()
        os._exit(_status)


def _finder() -> Any:
    """The finder of lazy modules; its classes are made here, since few processes need them."""
    from importlib import import_module
    from importlib.machinery import PathFinder
    from threading import RLock
    from types import ModuleType

    lock = RLock()
    running: set[str] = set()
    apart: list[str] = []  # packages of which a part is being loaded without them

    class Lazy(ModuleType):
        def __getattr__(self, name: str) -> Any:
            if name.startswith("__") and name != "__all__":
                raise AttributeError(f"module '{self.__name__}' has no attribute '{name}'")
            value = part(self.__name__, name)
            if value is None:
                run(self)
                return ModuleType.__getattribute__(self, name)
            return value

        def __dir__(self) -> list[str]:
            run(self)
            return list(ModuleType.__dir__(self))

    def run(module: ModuleType) -> None:
        """Run a lazy module, once; other threads wait until it has run."""
        spec = module.__spec__
        with lock:
            if type(module) is not Lazy or spec is None or module.__name__ in running:
                return
            running.add(module.__name__)
            try:
                module.__loader__ = spec.loader = spec.loader.real  # type: ignore[union-attr]
                spec.loader.exec_module(module)  # type: ignore[union-attr]
                module.__class__ = ModuleType  # type: ignore[assignment]
            finally:
                running.discard(module.__name__)

    def part(package: str, name: str) -> Any:
        """A name of a lazy package from the module that defines it; None where the package itself is needed."""
        module = LAZY_PARTS.get(f"{package}.{name}")
        if module is None:
            return None
        with lock:
            apart.append(package)
            try:
                return getattr(import_module(module), name, None)
            except ImportError:
                return None
            finally:
                apart.remove(package)

    class Loader:
        def __init__(self, real: Any):
            self.real = real

        def create_module(self, spec: ModuleSpec) -> ModuleType:
            return Lazy(spec.name)

        def exec_module(self, module: ModuleType) -> None:
            """The module runs when it is used."""

    class Finder:
        @staticmethod
        def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> Any:
            parent = sys.modules.get(name.rpartition(".")[0])
            if type(parent) is Lazy and parent.__name__ not in apart:  # a package runs before its parts
                run(parent)
            if name not in LAZY_MODULES:
                return None
            spec = PathFinder.find_spec(name, path, target)
            if spec is not None and spec.loader is not None:
                spec.loader = Loader(spec.loader)  # type: ignore[assignment]
            return spec

    return Finder


def run() -> NoReturn:
    """Run the command line and leave with its exit status."""
    watched = watch_interrupts()
    lazy_imports(sys.argv[1:])
    from bunraku.cli import main

    try:
        if watched:
            signal.signal(signal.SIGINT, interrupt)
        status = main()
        if watched:  # all is done, and only the clean-up is left
            signal.signal(signal.SIGINT, signal.SIG_IGN)
    except KeyboardInterrupt:  # in the moment before `main` handles it, or after
        exit_interrupted(signal.SIGINT, None)
    exit_fast(status)


if __name__ == "__main__":
    run()
