"""The tasks of the worker by name.

A task is a dataclass with a JSON form, which the server checks before it queues it; it reads and writes the binary
files of the store's folders, and records are the server's.
"""

from __future__ import annotations

from typing import Any

from bunraku.core.request.json_form import from_json
from bunraku.errors import OptionError
from bunraku.studio.tasks.carrying import Bend, Dress, Mirror, Transfer, Trim
from bunraku.studio.tasks.making import Animate, Edit
from bunraku.studio.tasks.opening import FindOut, LayChains, Open
from bunraku.studio.tasks.playing import Play, Preview
from bunraku.studio.tasks.task import Partly, Report, Task
from bunraku.studio.tasks.writing import Export, ExportClips
from bunraku.studio.workspace.workspace import Workspace

__all__ = ["TASKS", "run_task"]

TASKS: dict[str, type[Task]] = {
    "open": Open,
    "find-out": FindOut,
    "lay-chains": LayChains,
    "animate": Animate,
    "edit": Edit,
    "bend": Bend,
    "dress": Dress,
    "mirror": Mirror,
    "trim": Trim,
    "transfer": Transfer,
    "play": Play,
    "preview": Preview,
    "export": Export,
    "export-clips": ExportClips,
}


def run_task(shop: Workspace, task: str, params: object, report: Report, partly: Partly) -> dict[str, Any]:
    """Run a task of `TASKS`.

    Args:
        shop: What it works with.
        task: Its name.
        params: Its JSON form.
        report: Called with a stage's name and the share done.
        partly: Called with what is there before the end.

    Raises:
        OptionError: There is no such task, or it cannot be done.
    """
    if task not in TASKS:
        raise OptionError(f"there is no task '{task}'")
    return from_json(TASKS[task], params, f"the task {task}")(shop, report, partly)
