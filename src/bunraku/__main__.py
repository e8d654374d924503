"""`python -m bunraku`, and what the command `bunraku` calls: parts of numpy and scipy wait until they are used, and
Ctrl-C ends the process with one line from its first moment.
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

__all__ = ["LAZY_MODULES", "LAZY_PARTS", "QUICK", "exit_fast", "lazy_imports", "run"]


QUICK = ("animate", "edit", "inspect", "render", "rig", "samples", "transfer")
"""Commands of some seconds."""
LAZY_MODULES = frozenset({
    "numpy.ctypeslib", "numpy.f2py", "numpy.fft", "numpy.ma", "numpy.polynomial", "numpy.testing",
    "scipy.sparse.csgraph", "scipy.spatial", "scipy.spatial.transform",
})  # fmt: skip
LAZY_PARTS = {
    "scipy.sparse.csgraph.connected_components": "scipy.sparse.csgraph._traversal",
    "scipy.sparse.csgraph.dijkstra": "scipy.sparse.csgraph._shortest_path",
    "scipy.spatial.cKDTree": "scipy.spatial._ckdtree",
}
"""Names of packages that wait, and the modules in them that have these: such a name is had without the package, which
would load all of `scipy.linalg` and `scipy.special`. Where a version of scipy has it elsewhere, the package runs.
"""
OBJECTS = 50_000
"""New objects after which Python looks for garbage. The million that imports make would have it look a hundred times,
for nothing.
"""
_status: int | None = None


def lazy_imports(words: Sequence[str]) -> None:
    """Make the end of every command quick, and the start of some: let modules wait.

    Args:
        words: The command line behind the program's name.
    """
    import atexit

    atexit.register(_exit_now)  # the first, which runs as the last
    if not words or words[0] not in QUICK:
        return
    import gc
    import os

    # Products of a few thousand numbers are too short to share, threads that wait for them take half of the processor
    # from who works, and one thread adds in one order on every machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(OBJECTS)
    sys.meta_path.insert(0, _finder())


def exit_fast(status: int) -> NoReturn:
    """Leave with an exit status, without taking modules apart, which takes 0.2 s and more the longer a command ran."""
    global _status
    _status = status
    sys.exit(status)


def _exit_now() -> None:
    import os
    from contextlib import suppress

    if _status is not None:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError, AttributeError):  # there is none, or who reads it is gone
                stream.flush()
        os._exit(_status)


def _finder() -> Any:
    """What finds the modules that may wait; classes are made here, since few processes need them."""
    from importlib import import_module
    from importlib.machinery import PathFinder
    from threading import RLock
    from types import ModuleType

    lock = RLock()
    running: set[str] = set()
    apart: list[str] = []  # packages of which a part is loaded without them

    class Waiting(ModuleType):
        def __getattr__(self, name: str) -> Any:
            if name.startswith("__") and name != "__all__":
                raise AttributeError(f"module '{self.__name__}' has no attribute '{name}'")
            found = part(self.__name__, name)
            if found is None:
                run(self)
                return ModuleType.__getattribute__(self, name)
            return found

        def __dir__(self) -> list[str]:
            run(self)
            return list(ModuleType.__dir__(self))

    def run(module: ModuleType) -> None:
        """Run a module that waits, once; who asks from another thread waits for its end."""
        spec = module.__spec__
        with lock:
            if type(module) is not Waiting or spec is None or module.__name__ in running:
                return
            running.add(module.__name__)
            try:
                module.__loader__ = spec.loader = spec.loader.real  # type: ignore[union-attr]
                spec.loader.exec_module(module)  # type: ignore[union-attr]
                module.__class__ = ModuleType  # type: ignore[assignment]
            finally:
                running.discard(module.__name__)

    def part(package: str, name: str) -> Any:
        """What a part of a package that waits has by a name; None where the package is needed for it."""
        place = LAZY_PARTS.get(f"{package}.{name}")
        if place is None:
            return None
        with lock:
            apart.append(package)
            try:
                return getattr(import_module(place), name, None)
            except ImportError:
                return None
            finally:
                apart.remove(package)

    class Later:
        def __init__(self, real: Any):
            self.real = real

        def create_module(self, spec: ModuleSpec) -> ModuleType:
            return Waiting(spec.name)

        def exec_module(self, module: ModuleType) -> None:
            """Nothing yet."""

    class Finder:
        @staticmethod
        def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> Any:
            parent = sys.modules.get(name.rpartition(".")[0])
            if type(parent) is Waiting and parent.__name__ not in apart:  # a package runs before its parts
                run(parent)
            if name not in LAZY_MODULES:
                return None
            spec = PathFinder.find_spec(name, path, target)
            if spec is not None and spec.loader is not None:
                spec.loader = Later(spec.loader)  # type: ignore[assignment]
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
        if watched:  # all is done, and what is left is taking modules apart
            signal.signal(signal.SIGINT, signal.SIG_IGN)
    except KeyboardInterrupt:  # in the moment before `main` looks after it, or after
        exit_interrupted(signal.SIGINT, None)
    exit_fast(status)


if __name__ == "__main__":
    run()
