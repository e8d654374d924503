"""Clips as game engines and other programs expect them: format, axes, unit, frame rate, root motion, clips per file."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bunraku.core.animation import AnimatedCharacter, Animation, RigAnimation
from bunraku.core.files import check_output_folder, read_bounded
from bunraku.core.geometry.curves import STRIDE, gaussian
from bunraku.core.geometry.rotations import heading, matrix_y
from bunraku.core.request import checked
from bunraku.core.travel import in_place
from bunraku.errors import FormatError, OptionError
from bunraku.files.gltf.clips import merge_documents
from bunraku.files.gltf.open import open_document
from bunraku.files.gltf.write import write_clips
from bunraku.files.gltf.write_rig import save_rig_clips, with_still


def on_the_spot(animation: AnimatedCharacter) -> AnimatedCharacter:
    """The animation without its travel over the ground; what sways faster than half a second stays. Animations whose
    vertices move on their own are returned as they are.
    """
    if isinstance(animation, Animation):
        return replace(animation, motion=in_place(animation.motion), reference=None)
    if not isinstance(animation, RigAnimation):
        return animation
    turns, positions = animation.world()
    travel = _travel(positions[:, _carrier(animation)], animation.fps)
    return RigAnimation.of_world(animation.character, turns, positions - travel[:, None], animation.fps)


def root_bone(animation: AnimatedCharacter) -> int | None:
    """The bone above all others that holds no vertex, as Unreal's `root`; None where there is none."""
    rig = animation.character.rig if isinstance(animation, RigAnimation) else None
    if rig is None:
        return None
    roots = np.flatnonzero(rig.parents < 0)
    holds = np.zeros(len(rig.names), bool)
    holds[rig.indices[rig.weights > 0]] = True
    return int(roots[0]) if len(roots) == 1 and not holds[roots[0]] and len(rig.names) > 1 else None


def on_root_bone(animation: AnimatedCharacter) -> AnimatedCharacter:
    """The animation with its travel over the ground and its rotation about +Y on the bone above all others, so that no
    vertex moves otherwise. Without such a bone it is returned as it is: the travel is that of the first joint.
    """
    bone = root_bone(animation)
    if bone is None or not isinstance(animation, RigAnimation):
        return animation
    turns, positions = animation.world()
    carrier = _carrier(animation)
    turned = heading(turns[:, carrier], animation.fps)
    travel = _travel(positions[:, carrier], animation.fps)
    turns, positions = turns.copy(), positions.copy()
    assert animation.character.rig is not None
    turns[:, bone] = matrix_y(turned - turned[0])
    positions[:, bone] = animation.character.rig.positions[bone] + travel
    return RigAnimation.of_world(animation.character, turns, positions, animation.fps)


def _carrier(animation: RigAnimation) -> int:
    """The bone whose path is the character's: the first below the roots that holds vertices, or has several below."""
    rig = animation.character.rig
    assert rig is not None
    bone = int(np.flatnonzero(rig.parents < 0)[0])
    holds = np.zeros(len(rig.names), bool)
    holds[rig.indices[rig.weights > 0]] = True
    while not holds[bone]:
        below = np.flatnonzero(rig.parents == bone)
        if len(below) != 1:
            break
        bone = int(below[0])
    return bone


def _travel(path: np.ndarray, fps: float) -> np.ndarray:
    """The travel of a path over the ground from its start, without its sway [m], shape (N, 3)."""
    if len(path) < 3:
        return np.zeros_like(path)
    margin = round(4 * STRIDE * fps)
    longer = np.pad(path, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = gaussian(longer, STRIDE * fps)[margin : margin + len(path)]
    out = smooth - smooth[0]
    out[:, 1] = 0
    return np.asarray(out)


@checked
def save_clips(
    animations: Mapping[str, AnimatedCharacter],
    path: str | Path,
    *,
    fps: float | None = None,
    add: bool = False,
    **options: str,
) -> Path:
    """Write animations of one character as the clips of one GLB or FBX. Where the bones of the file's own skeleton
    move, its clips follow the new ones in a GLB.

    Args:
        animations: The animation of each clip by its name, all of one character and moved by the same handles or bones.
        path: The file, .glb or .fbx.
        fps: Frames a second of the clips [1/s]; those of each animation by default.
        add: Keep what an existing GLB has, and add to its clips; a name that is taken gets a number.
        **options: Of FBX: `up` and `unit`, see `save`.

    Raises:
        FormatError: The file cannot be written, or the existing one is of another character.
        OptionError: There is no clip, the animations are of several characters or of apparel that moves on its own, or
            `fps` is out of range.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".glb", ".fbx"):
        raise FormatError(
            path, "several clips go into one GLB or FBX; end the name in .glb or .fbx, or write each to its own file"
        )
    if suffix == ".glb" and options:
        raise OptionError(f"clips of a GLB have no option {', '.join(sorted(options))}; glTF is +Y up and in metres")
    if not animations:
        raise OptionError("there is no clip to write; give at least one animation")
    if any(not str(name).strip() for name in animations):
        raise OptionError("a clip has no name; give each one")
    if add and os.path.exists(path):
        if suffix == ".fbx":
            raise OptionError("clips are added to a GLB, not to an FBX; write all clips at once")
        return _added(animations, path, fps)
    bones = {name: animation for name, animation in animations.items() if isinstance(animation, RigAnimation)}
    handles = {name: animation for name, animation in animations.items() if isinstance(animation, Animation)}
    first = next(iter(animations.values()))
    alike = all(animation.character is first.character for animation in animations.values())
    if handles and alike:
        of_each = [animation.handles for animation in handles.values()]
        alike = all(np.array_equal(each.positions, of_each[0].positions) for each in of_each)
        alike = alike and all(np.array_equal(each.weights, of_each[0].weights) for each in of_each)
    if len(animations) not in (len(bones), len(handles)) or not alike:
        raise OptionError(
            "the clips of one file are of one character, moved by the same handles or bones, without apparel that "
            "moves on its own; write the others to files of their own"
        )
    moved = {name: with_still(one) for name, one in handles.items()}
    shown = next((one.character for one in moved.values() if isinstance(one, RigAnimation)), None)
    if shown is not None:  # one more joint, for what stands beside the body
        bones = {name: replace(one, character=shown) for name, one in moved.items() if isinstance(one, RigAnimation)}
    check_output_folder(path)
    if suffix == ".fbx":
        from bunraku.files.fbx.export import write_clips as write_fbx_clips

        return write_fbx_clips(bones or handles, path, fps=fps, **options)
    return save_rig_clips(bones, path, fps=fps) if bones else write_clips(handles, path, fps=fps)


def _added(animations: Mapping[str, AnimatedCharacter], path: Path, fps: float | None) -> Path:
    tree = open_document(path, read_bounded(path)).tree
    if not tree.get("animations") and not tree.get("skins"):  # nothing that the new clips could go with
        return save_clips(animations, path, fps=fps)
    with tempfile.TemporaryDirectory(prefix=f".{path.stem[:60]}.", suffix=".tmp", dir=path.parent) as folder:
        new = save_clips(animations, Path(folder, path.name), fps=fps)
        return merge_documents([path, new], path, only=set(animations))


@dataclass(frozen=True)
class Preset:
    """What a program expects."""

    # name, title: its name on the command line and in messages
    name: str
    title: str
    suffix: Literal[".fbx", ".glb"]
    fps: float  # frames a second [1/s]
    skeleton: Literal["mixamo", "vrm", "unreal"]  # the names for the joints of a person without a skeleton
    # where the travel over the ground is: "travel" on the first joint that moves, "bone" on a bone above it where there
    # is one, "none" taken out
    root: Literal["travel", "bone", "none"]
    one_file: bool  # whether all clips of a character go into one file
    # up, unit: the up axis and the unit of lengths in the file
    up: str
    unit: str
    note: str  # what to do in the program, one sentence

    def files(self, path: str | Path, names: Iterable[str]) -> dict[Path, list[str]]:
        """The files for some clips, named after a path with the preset's suffix, and the names of the clips in each."""
        path, listed = Path(path), list(names)
        if self.one_file or len(listed) < 2:
            return {path.with_suffix(self.suffix): listed}
        out: dict[Path, list[str]] = {}
        for name in listed:
            plain = re.sub(r"[^\w.-]+", "-", name)
            file = path.with_name(f"{path.stem}-{plain}{self.suffix}")
            out[file if file not in out else path.with_name(f"{path.stem}-{plain}-{len(out)}{self.suffix}")] = [name]
        return out


PRESETS: tuple[Preset, ...] = (
    Preset("unity", "Unity", ".fbx", 30.0, "mixamo", "travel", True, "+y", "cm",
           "Drop the file into Assets; under Rig choose Humanoid for a person, Generic for anything else."),
    Preset("unreal", "Unreal Engine", ".fbx", 30.0, "unreal", "bone", False, "+y", "cm",
           "Import the first file as a skeletal mesh, the others onto its skeleton; switch on root motion in each."),
    Preset("godot", "Godot", ".glb", 30.0, "vrm", "travel", True, "+y", "m",
           "Copy the file into the project; a BoneMap of SkeletonProfileHumanoid lets skeletons share clips."),
    Preset("blender", "Blender", ".glb", 24.0, "mixamo", "travel", True, "+y", "m",
           "File, Import, glTF; each clip is an action."),
    Preset("three", "three.js", ".glb", 30.0, "mixamo", "travel", True, "+y", "m",
           "Load the file with GLTFLoader and play `gltf.animations` with an AnimationMixer."),
    Preset("vrchat", "VRChat", ".fbx", 60.0, "mixamo", "none", True, "+y", "cm",
           "Drop the file into the avatar's Unity project; under Rig choose Humanoid, and put the clips into a layer."),
)  # fmt: skip


def preset_named(name: str) -> Preset:
    """The preset of a program. OptionError if there is none of this name."""
    preset = next((row for row in PRESETS if row.name == name), None)
    if preset is None:
        raise OptionError(f"there is no preset '{name}'; there are {', '.join(row.name for row in PRESETS)}")
    return preset


def preset_rows() -> list[dict[str, object]]:
    """All presets as plain values."""
    return [asdict(preset) for preset in PRESETS]


@checked
def save_for(
    preset: str | Preset, animations: Mapping[str, AnimatedCharacter], path: str | Path, *, fps: float | None = None
) -> list[Path]:
    """Write animations of one character as a program expects them, and return the files.

    Args:
        preset: The program: "unity", "unreal", "godot", "blender", "three" or "vrchat".
        animations: The animation of each clip by its name, all of one character.
        path: The file; its suffix becomes that of the preset. Where each clip has a file of its own, the clip's name
            follows.
        fps: Frames a second in place of the preset's [1/s].

    Raises:
        FormatError: A file cannot be written.
        OptionError: There is no such preset, no clip, or the animations are of several characters.
    """
    row = preset if isinstance(preset, Preset) else preset_named(preset)
    placed = {"travel": lambda one: one, "bone": on_root_bone, "none": on_the_spot}[row.root]
    clips = {name: placed(one) for name, one in animations.items()}
    rate = row.fps if fps is None else fps
    options: dict[str, Any] = {"up": row.up, "unit": row.unit} if row.suffix == ".fbx" else {}
    files = row.files(path, clips).items()
    return [save_clips({name: clips[name] for name in names}, file, fps=rate, **options) for file, names in files]
