"""Clips of one character from several files in one file, side by side or end to start."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bunraku.core.rig_animation import RigAnimation
from bunraku.core.rig_join import end_to_start as joined
from bunraku.errors import FormatError, OptionError
from bunraku.formats.files import check_output_folder
from bunraku.formats.gltf.merge import SAME, merge_documents
from bunraku.formats.gltf.read import Source
from bunraku.formats.gltf.write_rig import save_rig_clips
from bunraku.io.play import bones_of, clip_names, load_animation
from bunraku.io.registry import load_character

__all__ = ["merge"]


def merge(paths: Sequence[str | Path], path: str | Path, *, end_to_start: bool = False, fps: float = 30.0) -> Path:
    """Write the clips of several files of one character into one GLB: the first file as it is, with the clips of the
    others behind its own. Names that are taken get a number.

    Args:
        paths: GLB, glTF or VRM files, at least one. Those after the first may lack meshes.
        path: The file to write, .glb.
        end_to_start: Write all clips in a row as one, in the order of the files, each going on where the one before
            ends; the clips of the first file follow it.
        fps: Frames a second of that one [1/s].

    Returns:
        The file that was written.

    Raises:
        FormatError: A file is broken, holds no clip, or is of another character.
        OptionError: No file is named, or `fps` is out of range.
    """
    path = Path(path)
    if not paths:
        raise OptionError("there is nothing to merge; name at least one file")
    if path.suffix.lower() != ".glb":
        raise FormatError(path, "clips are merged into a GLB; end the name in .glb")
    check_output_folder(path)
    if not end_to_start:
        return merge_documents([Path(some) for some in paths], path)
    clips = [clip for some in paths for clip in _clips(Path(some), fps)]
    first = clips[0]
    return save_rig_clips({path.stem: joined([_on(clip, first, Path(paths[0])) for clip in clips])}, path, fps=fps)


def _clips(path: Path, fps: float) -> list[RigAnimation]:
    """All clips of a file, on its bones."""
    source = load_character(path).source
    count = len(clip_names(source.document)) if isinstance(source, Source) else 0
    if not count:
        raise FormatError(path, "it holds no clip to merge; make one with `bunraku animate`")
    played = [load_animation(path, number, fps) for number in range(count)]
    return [RigAnimation.of_world(played[0].character, *bones_of(one), fps) for one in played]


def _on(clip: RigAnimation, first: RigAnimation, path: Path) -> RigAnimation:
    """A clip with its bones in the order of another's.

    Raises:
        FormatError: It has others.
    """
    own, theirs = first.character.rig, clip.character.rig
    assert own is not None and theirs is not None
    places = {name: bone for bone, name in enumerate(theirs.names)}
    if not set(own.names) <= set(places):
        lacking = next(name for name in own.names if name not in places)
        raise FormatError(path, f"the files are of several characters: one has no bone '{lacking}'; use `transfer`")
    order = [places[name] for name in own.names]
    size = max(float(np.ptp(own.positions, axis=0).max()), 1e-9)
    if np.abs(own.positions - theirs.positions[order]).max() > SAME * size:
        raise FormatError(path, "the files are of several characters: their bones rest elsewhere; use `transfer`")
    return RigAnimation(first.character, clip.rotations[:, order], clip.translations[:, order], clip.fps)
