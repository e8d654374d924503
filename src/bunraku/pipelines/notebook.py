"""Progress in a notebook: bars below the cell that makes something, where nobody asked for another way."""

from __future__ import annotations

import html
import sys
import time
from collections.abc import Callable
from typing import Any

__all__ = ["cell_progress"]

LEAST = 0.1
"""Seconds between two pictures of a bar."""


def cell_progress() -> Callable[[str, float], None] | None:
    """Bars of the notebook's cell that runs, one for each stage; None outside of notebooks."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    if shell is None or type(shell).__name__ != "ZMQInteractiveShell":  # that of a kernel, not of a terminal
        return None
    from importlib import import_module

    return _Bars(import_module("IPython.display"))


class _Bars:
    """Stages and how far they are.

    Args:
        shown: The module that shows things in a cell.
    """

    def __init__(self, shown: Any):
        self.shown, self.stages, self.handle, self.last = shown, {}, None, 0.0  # type: ignore[var-annotated]

    def __call__(self, stage: str, done: float) -> None:
        """Show that a share of a stage, 0 to 1, is done."""
        self.stages[stage] = min(max(float(done), 0.0), 1.0)
        now = time.monotonic()
        if done < 1 and now - self.last < LEAST:
            return
        self.last = now
        picture = self.shown.HTML("".join(
            f'<div><progress value="{share:.3f}"></progress> {html.escape(name)}</div>'
            for name, share in self.stages.items()
        ))  # fmt: skip
        if self.handle is None:
            self.handle = self.shown.display(picture, display_id=True)
        else:
            self.handle.update(picture)
