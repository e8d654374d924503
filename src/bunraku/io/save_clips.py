"""Several clips of one character in one file, as game engines take them: idle, walk, run, attack."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bunraku.core.animated import AnimatedCharacter
from bunraku.core.animation import Animation
from bunraku.core.character import Handles
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import FormatError, OptionError
from bunraku.formats.files import check_output_folder, read_bounded
from bunraku.formats.gltf.container.open import open_document
from bunraku.formats.gltf.merge import merge_documents
from bunraku.formats.gltf.write import write_clips
from bunraku.formats.gltf.write_rig import save_rig_clips

__all__ = ["save_clips"]


def save_clips(
    animations: Mapping[str, AnimatedCharacter],
    path: str | Path,
    *,
    fps: float | None = None,
    add: bool = False,
    **options: str,
) -> Path:
    """Write animations of one character as the clips of one GLB or FBX.

    Where the bones of the file's own skeleton move, its clips follow the new ones in a GLB.

    Args:
        animations: The animation of each clip by its name; all of one character, moved by the same handles or bones.
        path: The file, .glb or .fbx.
        fps: Frames a second of the clips [1/s]; those of each animation by default.
        add: Keep what a GLB that is there has, and add to its clips; a name that is taken gets a number.
        **options: Of FBX: `up` and `unit`, see `bunraku.formats.fbx.export.write_clips`.

    Returns:
        The file that was written.

    Raises:
        FormatError: The file cannot be written, or what is there is another character.
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
    if add and path.exists():
        if suffix == ".fbx":
            raise OptionError("clips are added to a GLB, not to an FBX; write all clips at once")
        return _added(animations, path, fps)
    bones = {name: one for name, one in animations.items() if isinstance(one, RigAnimation)}
    handles = {name: one for name, one in animations.items() if isinstance(one, Animation)}
    first = next(iter(animations.values()))
    alike = all(one.character is first.character for one in animations.values())
    if handles and alike:
        own = handles[next(iter(handles))].handles
        alike = all(_same_handles(one.handles, own) for one in handles.values())
    if len(animations) not in (len(bones), len(handles)) or not alike:
        raise OptionError(
            "the clips of one file are of one character, moved by the same handles or bones, without apparel that "
            "moves on its own; write the others to files of their own"
        )
    check_output_folder(path)
    if suffix == ".fbx":
        from bunraku.formats.fbx.export import write_clips as write_fbx_clips

        return write_fbx_clips(bones or handles, path, fps=fps, **options)
    return save_rig_clips(bones, path, fps=fps) if bones else write_clips(handles, path, fps=fps)


def _same_handles(one: Handles, other: Handles) -> bool:
    return one is other or (
        np.array_equal(one.positions, other.positions) and np.array_equal(one.weights, other.weights)
    )


def _added(animations: Mapping[str, AnimatedCharacter], path: Path, fps: float | None) -> Path:
    tree = open_document(path, read_bounded(path)).tree
    if not tree.get("animations") and not tree.get("skins"):  # nothing that the new clips could go with
        return save_clips(animations, path, fps=fps)
    with tempfile.TemporaryDirectory(prefix=f".{path.stem[:60]}.", suffix=".tmp", dir=path.parent) as folder:
        new = save_clips(animations, Path(folder, path.name), fps=fps)
        return merge_documents([path, new], path, only=set(animations))
