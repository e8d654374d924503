"""The tasks of the worker by name, with those that open characters and write files."""

from __future__ import annotations

import shutil
import tempfile
import zipfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bunraku.anatomy.corrected import corrected_handles
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.character import Character
from bunraku.core.request import Progress, from_json
from bunraku.errors import OptionError
from bunraku.studio.dressing import WORN, chain_facts, chains_of
from bunraku.studio.forms import LiveForm
from bunraku.studio.takes import (
    Animate,
    Bend,
    Dress,
    Edit,
    Mirror,
    Partly,
    Play,
    Preview,
    Task,
    Transfer,
    Trim,
    finish_takes,
)
from bunraku.studio.wire import Dressed, load_handles, packed_clip, save_handles
from bunraku.studio.workspace import (
    PREVIEWS,
    Settings,
    Workspace,
    apparel_facts,
    character_facts,
    opened_character,
)

CHAINED = "chains.glb"
"""The mesh of a character with chains of bones for its apparel, and their springs in the extras."""


@dataclass(frozen=True)
class Open:
    """Open a character."""

    character: str
    file: str
    settings: Settings = field(default_factory=Settings)
    again: bool = False
    """Whether what was guessed before still holds, since joints and pieces alone were corrected."""

    def __call__(self, workspace: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        from bunraku.files import save_character
        from bunraku.pipelines.animate import rig

        folder = workspace.folder_of("characters", self.character)
        report("read", 0.1)
        character, taken = opened_character(folder / self.file, self.settings)
        report("handles", 0.3)
        if self.settings.handles == "rig":
            handles = rig(character, handles="rig")
        else:
            guessed = folder / "guessed.npz"
            if not (self.again and guessed.is_file()):
                save_handles(rig(replace(character, corrections=None)), guessed)
            handles = corrected_handles(character, load_handles(guessed)).top(4)
        report("write", 0.8)
        save_character(character, folder / "mesh.glb", handles)
        for file_name in ("bones.glb", CHAINED):
            (folder / file_name).unlink(missing_ok=True)
        shutil.rmtree(folder / PREVIEWS, ignore_errors=True)
        save_handles(handles, folder / "handles.npz")
        workspace.character(self.character, character)  # what was just read is not read again
        facts = character_facts(workspace.body(self.character).anatomy)
        return {**taken, **facts, "clips": _clips_of(character), "chains": []}


@dataclass(frozen=True)
class FindApparel:
    """Find what takes longer of a character that is open: its apparel, and where hands and feet are."""

    character: str

    def __call__(self, workspace: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        body = workspace.body(self.character)
        report("look", 0.1)
        worn = workspace.folder_of("characters", self.character) / WORN
        painted = workspace.painted(self.character)
        return {**apparel_facts(body.character, body.anatomy, worn, painted), "painted": painted}


@dataclass(frozen=True)
class LayChains:
    """Chains of bones over the hair and clothes of a character that is open, with springs for the page."""

    character: str

    def __call__(self, workspace: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        from bunraku.apparel.chains.avatars import vrm_avatar
        from bunraku.files import save_character

        report("look", 0.1)
        body = workspace.body(self.character)
        chains, why = chains_of(body.anatomy)
        if chains is None:
            reason = why.removeprefix(f"{body.character.name}: ").partition(";")[0]
            return {"chains": [], "unchained": f"{reason}; paint what is hair and clothes"}
        report("springs", 0.4)
        path = workspace.folder_of("characters", self.character) / CHAINED
        save_character(chains.character, path, rig=True, avatar=vrm_avatar(chains))
        return {"chains": chain_facts(chains), "unchained": ""}


def _clips_of(character: Character) -> list[str]:
    """Names of the clips that the character's file brings."""
    from bunraku.files import Source, clip_names

    source = character.source
    return clip_names(source.document)[:50] if isinstance(source, Source) and character.rig is not None else []


@dataclass(frozen=True, kw_only=True)
class Live(LiveForm):
    """The next poses of a character that never stops, as a clip; `begins` a session, or goes on with one."""

    character: str
    begins: bool

    def __call__(self, workspace: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        live = workspace.live(self.session, self.character, self.begins)
        if live.direction != self.direction:
            live.go(self.direction)
        if self.sentence:
            live.say(self.sentence)
        live.look(self.look)
        live.reach(self.reach)
        first, made = live.window(round(self.seconds * live.fps), self.start)
        assert isinstance(made, Animation | RigAnimation)  # no skeleton was asked for
        return {"first": first, "clip": packed_clip(made)}


@dataclass(frozen=True)
class Played:
    """A take of what a character that never stops was seen to do."""

    takes: tuple[str, ...]
    character: str
    session: str
    stop: int | None

    def __call__(self, workspace: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        made = workspace.live(self.session, self.character, False).played(stop=self.stop)
        assert isinstance(made, Animation | RigAnimation)
        return finish_takes({self.takes[0]: made}, self.character, workspace, partly)


VIDEOS = {".mp4": (1280, 720), ".gif": (480, 360)}
"""Sizes of videos in pixels."""
BODIES = (".bvh", ".vrma", ".vmd", ".npz")
"""Formats of the motion of a body, in which apparel has no place."""


@dataclass(frozen=True)
class Export:
    """A take as a file of another program."""

    character: str
    export: str
    file: str
    take: str
    fps: float = 30.0

    def __call__(self, workspace: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        from bunraku.files import check_writer

        target = workspace.folder_of("exports", self.export) / self.file
        check_writer(target)
        report("write", 0.1)
        take = workspace.take(self.take, self.character)
        options: dict[str, Any] = {} if target.suffix in (".npz", ".vmd") else {"fps": self.fps}
        if target.suffix in VIDEOS:
            options["size"] = VIDEOS[target.suffix]
        if isinstance(take, Dressed):
            shown = take.points if take.bones is None else take.bones
            (take.body if target.suffix in BODIES else shown).save(target, **options)
        else:
            take.save(target, **options)
        return {"export": self.export, "bytes": target.stat().st_size}


@dataclass(frozen=True)
class ExportClips:
    """Several takes of a character as the clips of one file, or of a ZIP of as many as a program wants, or side by side
    in a video.
    """

    character: str
    export: str
    file: str
    takes: tuple[str, ...]
    names: tuple[str, ...]
    fps: float = 30.0
    preset: str = ""
    title: str = "clips"

    def __call__(self, workspace: Workspace, report: Progress, partly: Partly) -> dict[str, Any]:
        from bunraku.files import preset_named, save_clips, save_for

        target = workspace.folder_of("exports", self.export) / self.file
        if target.suffix in VIDEOS:
            return self._beside(workspace, target, report)
        clips: dict[str, Animation | RigAnimation] = {}
        character: Character | None = None
        for number, (take, name) in enumerate(zip(self.takes, self.names, strict=True)):
            report("read", number / len(self.takes))
            take_record = workspace.take(take, self.character)
            if isinstance(take_record, Dressed):
                raise OptionError(
                    "apparel that moves on its own does not fit among several clips; download such takes alone"
                )
            character = character or take_record.character
            clips[name] = replace(take_record, character=character)  # each was read with a copy of it
        if self.preset:
            clips = _named(clips, workspace, self.character, preset_named(self.preset).skeleton)
        if not self.preset:
            save_clips(clips, target, fps=self.fps)
        elif target.suffix == ".zip":
            with tempfile.TemporaryDirectory(dir=target.parent) as folder:
                named = Path(folder, f"{self.title}{preset_named(self.preset).suffix}")
                with zipfile.ZipFile(target, "w") as archive:
                    for file in save_for(self.preset, clips, named, fps=self.fps or None):
                        archive.write(file, file.name)
        else:
            save_for(self.preset, clips, target, fps=self.fps or None)
        return {"export": self.export, "bytes": target.stat().st_size}

    def _beside(self, workspace: Workspace, target: Path, report: Progress) -> dict[str, Any]:
        from bunraku.render.preview import save_beside

        takes = [workspace.take(take, self.character) for take in self.takes]
        shown = [
            take.points if isinstance(take, Dressed) else Animation(take.character, take.handles, take.motion)
            for take in takes
        ]
        save_beside(
            shown, target, size=VIDEOS[target.suffix], fps=self.fps,
            progress=lambda done, total: report("draw", done / total),
        )  # fmt: skip
        return {"export": self.export, "bytes": target.stat().st_size}


def _named(
    clips: dict[str, Animation | RigAnimation], workspace: Workspace, character: str, names: str
) -> dict[str, Animation | RigAnimation]:
    """Clips of a person by its handles, on a tree of joints with a program's names; others as they are."""
    from bunraku.retarget.engine_skeleton import carried, on_skeleton

    moved = {name: clip for name, clip in clips.items() if isinstance(clip, Animation)}
    body = workspace.body(character) if len(moved) == len(clips) else None
    if body is None or not body.takes_skeleton:
        return clips
    skeleton = on_skeleton(body.anatomy, names)
    return {name: carried(clip, body.anatomy, skeleton) for name, clip in moved.items()}


TASKS: dict[str, type[Task]] = {
    "open": Open, "find-out": FindApparel, "lay-chains": LayChains,
    "animate": Animate, "edit": Edit, "bend": Bend, "dress": Dress, "mirror": Mirror, "trim": Trim,
    "transfer": Transfer, "play": Play, "preview": Preview, "live": Live, "played": Played,
    "export": Export, "export-clips": ExportClips,
}  # fmt: skip


def run_task(workspace: Workspace, task: str, params: object, report: Progress, partly: Partly) -> dict[str, Any]:
    """Run a task of `TASKS` with its JSON form, reporting a stage's name and the share done, and results that are ready
    before the end (`partly`); OptionError where there is no such task, or it cannot be done.
    """
    if task not in TASKS:
        raise OptionError(f"there is no task '{task}'")
    return from_json(TASKS[task], params, f"the task {task}")(workspace, report, partly)
