"""What game engines and other programs want of a file, a row for each: format, axes, unit, frame rate, names of joints,
where the travel is, one file or many.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from bunraku.core.animated import AnimatedCharacter
from bunraku.errors import OptionError
from bunraku.io.root_motion import on_root_bone, on_the_spot
from bunraku.io.save_clips import save_clips

__all__ = ["PRESETS", "Preset", "preset_named", "preset_rows", "save_for"]


@dataclass(frozen=True)
class Preset:
    """What a program wants.

    Args:
        name: Its name on the command line.
        title: Its name.
        suffix: The format.
        fps: Frames a second [1/s].
        skeleton: Whose names the joints of a person get that has no skeleton of its own.
        root: Where the travel over the ground is: "travel" on the first joint that moves, "bone" on a bone above it
            where there is one, "none" taken out.
        one_file: Whether all clips of a character go into one file.
        up: The axis that is up in the file.
        unit: The unit of its lengths.
        note: What to do there, one sentence.
    """

    name: str
    title: str
    suffix: Literal[".fbx", ".glb"]
    fps: float
    skeleton: Literal["mixamo", "vrm", "unreal"]
    root: Literal["travel", "bone", "none"]
    one_file: bool
    up: str
    unit: str
    note: str

    def files(self, path: str | Path, names: Iterable[str]) -> dict[Path, list[str]]:
        """The files of some clips, and the names of those in each.

        Args:
            path: The file that was named; its suffix becomes that of the format.
            names: Of the clips.
        """
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
    """The preset of a program.

    Raises:
        OptionError: There is none of this name.
    """
    found = next((one for one in PRESETS if one.name == name), None)
    if found is None:
        raise OptionError(f"there is no preset '{name}'; there are {', '.join(one.name for one in PRESETS)}")
    return found


def preset_rows() -> list[dict[str, object]]:
    """All presets as plain values."""
    return [asdict(one) for one in PRESETS]


def save_for(
    preset: str | Preset, animations: Mapping[str, AnimatedCharacter], path: str | Path, *, fps: float | None = None
) -> list[Path]:
    """Write animations of one character as a program wants them.

    Args:
        preset: The program: "unity", "unreal", "godot", "blender", "three" or "vrchat".
        animations: The animation of each clip by its name, all of one character.
        path: The file; its suffix is that of the preset. Where each clip has a file of its own, its name follows.
        fps: Frames a second in place of the preset's [1/s].

    Returns:
        What was written.

    Raises:
        FormatError: A file cannot be written.
        OptionError: There is no such preset, no clip, or the animations are of several characters.
    """
    row = preset if isinstance(preset, Preset) else preset_named(preset)
    placed = {"travel": lambda one: one, "bone": on_root_bone, "none": on_the_spot}[row.root]
    clips = {name: placed(one) for name, one in animations.items()}
    rate = row.fps if fps is None else fps
    out = []
    for file, names in row.files(path, clips).items():
        some = {name: clips[name] for name in names}
        if row.suffix == ".fbx":
            out.append(save_clips(some, file, fps=rate, up=row.up, unit=row.unit))
        else:
            out.append(save_clips(some, file, fps=rate))
    return out
