"""A quick start of the command line: of what numpy and scipy load, the parts that hardly a command uses wait until
something touches them.

A module that is named here is found and entered in `sys.modules` as ever, and its code runs when an attribute of it is
first asked for. What Python code sees is the same, only later.
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False
if TYPE_CHECKING:  # the command line imports this before anything else
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType
    from typing import Any, NoReturn

__all__ = ["LATER", "PARTS", "QUICK", "end", "hurry"]

QUICK = ("animate", "edit", "inspect", "render", "rig", "samples", "transfer")
"""Commands of some seconds."""
LATER = frozenset({
    "numpy.ctypeslib", "numpy.f2py", "numpy.fft", "numpy.ma", "numpy.polynomial", "numpy.testing",
    "scipy.sparse.csgraph", "scipy.spatial", "scipy.spatial.transform",
})  # fmt: skip
PARTS = {
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


def hurry(words: Sequence[str]) -> None:
    """Make the end of every command quick, and the start of some: let modules wait.

    Args:
        words: The command line behind the program's name.
    """
    import atexit

    atexit.register(_leave)  # the first, which runs as the last
    if not words or words[0] not in QUICK:
        return
    import gc
    import os

    # Products of a few thousand numbers are too short to share, threads that wait for them take half of the processor
    # from who works, and one thread adds in one order on every machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(OBJECTS)
    sys.meta_path.insert(0, _finder())


def end(status: int) -> NoReturn:
    """Leave with an exit status, without taking modules apart, which takes 0.2 s and more the longer a command ran."""
    global _status
    _status = status
    sys.exit(status)


def _leave() -> None:
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
        place = PARTS.get(f"{package}.{name}")
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
            if name not in LATER:
                return None
            spec = PathFinder.find_spec(name, path, target)
            if spec is not None and spec.loader is not None:
                spec.loader = Later(spec.loader)  # type: ignore[assignment]
            return spec

    return Finder
