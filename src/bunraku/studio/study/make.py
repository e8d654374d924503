"""Make a blind study: three or more methods' clips of the same characters and sentences, without a trace of who made
which.
"""

from __future__ import annotations

import json
import random
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.animation import Animation
from bunraku.core.character import Handles
from bunraku.core.motion import HandleMotion
from bunraku.errors import FormatError, OptionError
from bunraku.formats.files import atomic_write, check_text, read_bounded, writing
from bunraku.formats.gltf.bunraku_clip import add_motion
from bunraku.formats.gltf.write import build_document, finish_document
from bunraku.io.play import load_animation
from bunraku.studio.study.answers import FROZEN, VERSION

__all__ = ["Line", "make_study", "read_lines"]

FPS = 20.0
MOST_LINES = 200
JOINTS = 40
"""Joints of every clip at the least: how many a method uses does not show."""


@dataclass(frozen=True)
class Line:
    """One trial's sentence.

    Args:
        character: File name of its character, without folder.
        prompt: What it does.
    """

    character: str
    prompt: str


def read_lines(path: Path) -> list[Line]:
    """Read trials: one a line, `dragon.glb: walks forward`; empty lines and those that start with # are left out.

    Raises:
        FormatError: A line is none, or there are none or too many.
    """
    data = read_bounded(path)
    check_text(path, data)
    out = []
    for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        character, colon, prompt = (part.strip() for part in line.partition(":"))
        if not colon or not character or not prompt or "/" in character or "\\" in character:
            raise FormatError(path, f"line {number} is not 'CHARACTER: SENTENCE', such as 'dragon.glb: walks forward'")
        out.append(Line(character, prompt))
    if not 1 <= len(out) <= MOST_LINES:
        raise FormatError(path, f"a study has 1 to {MOST_LINES} lines, not {len(out)}")
    return out


def make_study(
    methods: Mapping[str, Path], lines: Sequence[Line], folder: Path, *, seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> Path:  # fmt: skip
    """Write a study: a trial for each line, one of them again, and one with a clip that does not move.

    Args:
        methods: Names of at least two methods with their folders: `1.glb` there is the first line's clip, and so on.
        lines: The sentences.
        folder: Where it is written; must not hold a study.
        seed: Which trials are checks.
        progress: Called with a stage's name and the share done.

    Raises:
        OptionError: Fewer than two methods, or the folder holds a study.
        FormatError: A clip is missing or broken.
    """
    if len(methods) < 2 or any(not name or name == FROZEN for name in methods):
        raise OptionError("a study compares at least two methods, each with a name and a folder of clips")
    if (folder / "study.json").exists():
        raise OptionError(f"{folder} holds a study already; name another folder")
    with writing(folder, "folder"):
        (folder / "clips").mkdir(parents=True, exist_ok=True)
    drawn = random.Random(seed)
    frozen_line, repeated = drawn.randrange(len(lines)), drawn.randrange(len(lines))
    trials: list[dict[str, Any]] = []
    key: dict[str, str] = {}
    for number, line in enumerate(lines):
        if progress:
            progress("clips", number / len(lines))
        files = {name: home / f"{number + 1}.glb" for name, home in methods.items()}
        clips = {name: load_animation(file, 0, FPS) for name, file in files.items()}
        frames = min(len(clip.motion) for clip in clips.values())
        cut = {name: replace(clip, motion=clip.motion.take(slice(frames))) for name, clip in clips.items()}
        joints = max(JOINTS, *(len(clip.handles.positions) for clip in cut.values()))
        names = {}
        for name, clip in cut.items():
            names[name] = secrets.token_hex(8)
            _write_blind(clip, joints, folder / "clips" / f"{names[name]}.glb")
            key[names[name]] = name
        trials.append(_trial(line, list(names.values())))
        if number == frozen_line:
            first = sorted(cut)[0]
            still = cut[first].motion.take(np.zeros(frames, int))
            name = secrets.token_hex(8)
            _write_blind(replace(cut[first], motion=still), joints, folder / "clips" / f"{name}.glb")
            key[name] = FROZEN
            others = [names[method] for method in sorted(names) if method != first]
            trials.append(_trial(line, [*others, name]))
    whole = [trial for trial in trials if not any(key[clip] == FROZEN for clip in trial["clips"])]
    again = _trial(lines[repeated], whole[repeated]["clips"])
    trials.append(again)
    for trial in trials:
        drawn.shuffle(trial["clips"])
    _write(folder / "key.json", {"version": VERSION, "clips": key, "repeats": {again["id"]: whole[repeated]["id"]}})
    _write(folder / "study.json", {"version": VERSION, "trials": trials})
    return folder


def _trial(line: Line, clips: list[str]) -> dict[str, Any]:
    return {
        "id": secrets.token_hex(6),
        "prompt": line.prompt,
        "character": Path(line.character).stem,
        "clips": list(clips),
    }


def _write(path: Path, content: dict[str, object]) -> None:
    with atomic_write(path) as file:
        file.write(json.dumps(content, indent=1, ensure_ascii=False).encode())


def _write_blind(animation: Animation, joints: int, path: Path) -> None:
    """Write a clip with as many joints as all others, under no name but numbers, and with nothing said about it."""
    count = len(animation.handles.positions)
    more = joints - count
    handles = Handles(
        np.pad(animation.handles.positions, ((0, more), (0, 0))), np.pad(animation.handles.weights, ((0, 0), (0, more)))
    )
    motion = animation.motion
    rotations = np.tile(np.eye(3, dtype=np.float32), (len(motion), joints, 1, 1))
    rotations[:, :count] = motion.rotations
    padded = HandleMotion(
        np.pad(motion.translations, ((0, 0), (0, more), (0, 0))), rotations, motion.root_translation,
        motion.root_rotation, motion.fps,
    )  # fmt: skip
    character = replace(animation.character, name="character", rig=None, avatar=None)
    builder, nodes = build_document(character, handles, path)
    add_motion(builder, nodes, handles.positions, padded, "clip")
    builder.tree = _without_names(builder.tree)
    builder.tree["asset"] = {"version": "2.0"}
    finish_document(builder, path)


def _without_names(value: Any) -> Any:
    """A glTF tree without what people wrote into it."""
    if isinstance(value, dict):
        return {key: _without_names(each) for key, each in value.items() if key not in ("name", "extras")}
    return [_without_names(each) for each in value] if isinstance(value, list) else value
