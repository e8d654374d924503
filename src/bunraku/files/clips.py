"""Clips in files: those that Bunraku wrote, those on a file's own skin, and several files merged into one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bunraku.core.animation import Animation, RigAnimation, behind_still
from bunraku.core.animation import end_to_start as joined
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.files import check_output_folder, read_bounded
from bunraku.core.geometry.rotations import nearest_rotation
from bunraku.core.motion import HandleMotion, posed_points
from bunraku.errors import FormatError, MotionError, OptionError
from bunraku.files.gltf.carry import clip_names, clip_number
from bunraku.files.gltf.clips import SAME_BONES, merge_documents
from bunraku.files.gltf.nodes import MAX_SECONDS, clip_curves, node_worlds
from bunraku.files.gltf.read import Source
from bunraku.files.gltf.write import clip_handles, packed_motion
from bunraku.files.gltf.write_rig import save_rig_clips
from bunraku.files.motions.arrays import read_npz_motion, read_positions, read_reference
from bunraku.files.registry import load_character, load_with_clips

SAME = 1e-3
"""Handles this near are the same, over the character's largest extent: float32's rounding stays far below it."""


@dataclass(frozen=True)
class Clip:
    """A handle motion as a file has it."""

    path: Path
    motion: HandleMotion  # the motion, in the frame of the character that it was made for
    reference: HandleMotion | None  # the reference body's motion that it was fitted from, where the file holds it
    # rest positions of the character's handles [m], shape (K, 3), where the file holds them
    positions: np.ndarray | None

    def is_of(self, handles: Handles) -> bool:
        """Whether the motion was made for these handles."""
        if self.positions is None or self.positions.shape != handles.positions.shape:
            return False
        return bool(np.abs(self.positions - handles.positions).max() <= SAME * np.ptp(handles.positions, axis=0).max())

    def of_the_reference_body(self) -> HandleMotion:
        """The motion of the reference body. MotionError if the file holds that of another character only."""
        if self.reference is not None:
            return self.reference
        if self.positions is None or self.is_of(reference_body().handles):
            return self.motion
        raise MotionError(f"{self.path}: this motion was made for another body; name that character")

    def on(self, character: Character, handles: Handles) -> Animation | None:
        """The animation of the character that the motion was made for, or None if this is another one."""
        return Animation(character, handles, self.motion, self.reference) if self.is_of(handles) else None


def load_clip(path: str | Path) -> Clip:
    """Read a clip that Bunraku wrote, GLB or NPZ. FormatError if the file is missing or broken, or was not written by
    Bunraku; MotionError if what it holds breaks the rules of a motion.
    """
    path = Path(path)
    data = read_bounded(path)
    if data[:4] == b"glTF":
        data = packed_motion(path, data)
    elif data[:2] != b"PK":
        raise FormatError(
            path, "clips are read from the .glb and .npz files that Bunraku writes; make one with `bunraku animate`"
        )
    return Clip(path, read_npz_motion(path, data), read_reference(path, data), read_positions(path, data))


def load_clip_animation(path: str | Path) -> Animation:
    """Read a GLB of Bunraku: character, handles and motion. Errors are those of `load_clip` and `load_character`."""
    clip = load_clip(path)
    character = load_character(path)
    return Animation(character, clip_handles(clip.path, character), clip.motion, clip.reference)


MAX_TRANSFORMS = 4_000_000


def load_animation(path: str | Path, clip: int | str = 0, fps: float = 30.0) -> Animation:
    """Read a character and a clip of its file, GLB, glTF, VRM or FBX, as an animation at a rate [1/s] whose handles are
    the file's joints. The clip is a number or a name, with or without its armature's name before a bar.

    Handle 0 stands still and holds no vertex; then each joint holds the vertices of its skin, with scale and shear. A
    joint's transform is relative to the bind pose, so skinned meshes are exact; where the file has no bind pose that
    makes sense, it is relative to the default pose and the result is close. FormatError if the file cannot be read, or
    has no skin or no clip; OptionError if the file has no clip of this name or number, or `fps` is not from 1 to 240.
    """
    path = Path(path)
    if not 1 <= fps <= 240:
        raise OptionError(f"frames a second must be from 1 to 240, not {fps:g}")
    return own_animation(load_with_clips(path, fps), clip, fps)


def own_animation(character: Character, clip: int | str, fps: float) -> Animation:
    """A clip of the file of a character, as it stands here, as `load_animation` plays it; errors are the same."""
    source, path = character.source, Path(character.name)
    if isinstance(source, Source):
        path = source.document.path
    if not isinstance(source, Source) or not source.document.items("animations"):
        raise FormatError(path, "it holds no animation; make one with `bunraku animate`")
    if character.rig is None:
        raise FormatError(path, "its animation moves no skin, which is all that is played; export it with its skin")
    document = source.document
    channels = document.items("animations")[clip_number(document.path, clip_names(document), clip)]
    curves = clip_curves(document, channels)
    end = max((float(times[-1]) for times, _, _ in curves.values()), default=0.0)
    if end > MAX_SECONDS:
        raise FormatError(path, f"its clip lasts {end:.0f} s but at most {MAX_SECONDS:.0f} s are played; cut it")
    moments = np.arange(int(np.floor(end * fps + 1e-3)) + 1) / fps
    if len(moments) * len(character.rig.names) > MAX_TRANSFORMS:
        joints = len(character.rig.names)
        raise FormatError(
            path, f"its clip of {end:.0f} s moves {joints} joints, too many to play; lower the frame rate"
        )
    world = node_worlds(document, source.tree, curves, moments, source.skins.nodes)
    return _animation(character, world, fps)


def _animation(character: Character, world: np.ndarray, fps: float) -> Animation:
    rig = character.rig
    assert rig is not None
    change = world @ np.linalg.pinv(rig.transforms)
    positions = np.concatenate([np.zeros((1, 3)), rig.positions])
    weights = np.concatenate([np.zeros((len(character.vertices), 1), np.float32), rig.dense_weights()], axis=1)
    weights[:, 0] = 1 - weights[:, 1:].sum(axis=1)
    return Animation(character, Handles(positions, weights), behind_still(change[..., :3, :], rig.positions, fps))


MOST_CLIPS, MOMENTS, POINTS = 8, 6, 1000
"""Clips, moments, and lowest and other points of the surface that tell where a character stands; chosen by eye."""


def clips_rise(character: Character) -> float:
    """How much higher a character stands in its file's own clips than in its rest pose [m], where they stand nearer to
    y = 0, which is the ground of engines; 0 where they do not, or there are none.
    """
    source, rig = character.source, character.rig
    if rig is None or not isinstance(source, Source):
        return 0.0
    document, heights = source.document, character.vertices[:, 1]
    spread = np.linspace(0, len(heights) - 1, POINTS).astype(int)
    rows = np.unique(np.concatenate([np.argsort(heights, kind="stable")[:POINTS], spread]))
    rows = rows[character.surface[rows]]
    inverse, points = np.linalg.pinv(rig.transforms), character.vertices[rows].astype(np.float64)
    lows = []
    for channels in document.items("animations")[:MOST_CLIPS]:
        curves = clip_curves(document, channels)
        end = max((float(times[-1]) for times, _, _ in curves.values()), default=0.0)
        moments = np.linspace(0, min(end, MAX_SECONDS), MOMENTS)
        for world in node_worlds(document, source.tree, curves, moments, source.skins.nodes) @ inverse:
            moved = np.einsum("vmj,vj->vm", world[rig.indices[rows], 1, :3], points) + world[rig.indices[rows], 1, 3]
            lows.append(float((rig.weights[rows] * moved).sum(axis=1).min()))
    if not lows:
        return 0.0
    rest, stands = float(points[:, 1].min()), float(np.median(lows))
    return stands - rest if abs(stands) < abs(rest) else 0.0


def bones_of(animation: Animation) -> tuple[np.ndarray, np.ndarray]:
    """World rotations (N, J, 3, 3) and heads [m] (N, J, 3) of the bones of an animation of `load_animation`."""
    assert animation.character.rig is not None
    affine = animation.motion.transforms(animation.handles.positions)[:, 1:].astype(np.float64)
    return nearest_rotation(affine[..., :3]), posed_points(affine, animation.character.rig.positions)


def merge(paths: Sequence[str | Path], path: str | Path, *, end_to_start: bool = False, fps: float = 30.0) -> Path:
    """Write the clips of several files of one character into one GLB: the first file with the clips of the others after
    its own. Names that are taken get a number.

    Args:
        paths: GLB, glTF or VRM files, at least one. Those after the first may lack meshes.
        path: The file to write, .glb.
        end_to_start: Join all clips into one in the order of the files; the clips of the first file follow it.
        fps: Frames a second of the joined clip [1/s].

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
        return merge_documents([Path(file) for file in paths], path)
    clips = [clip for file in paths for clip in _clips(Path(file), fps)]
    first = clips[0]
    return save_rig_clips({path.stem: joined([_on(clip, first, Path(paths[0])) for clip in clips])}, path, fps=fps)


def _clips(path: Path, fps: float) -> list[RigAnimation]:
    """All clips of a file, on its bones."""
    source = load_character(path).source
    count = len(clip_names(source.document)) if isinstance(source, Source) else 0
    if not count:
        raise FormatError(path, "it holds no clip to merge; make one with `bunraku animate`")
    played = [load_animation(path, number, fps) for number in range(count)]
    return [RigAnimation.of_world(played[0].character, *bones_of(pose), fps) for pose in played]


def _on(clip: RigAnimation, first: RigAnimation, path: Path) -> RigAnimation:
    """A clip with its bones in the order of another's; FormatError where the bones are others."""
    ours, theirs = first.character.rig, clip.character.rig
    assert ours is not None and theirs is not None
    places = {name: bone for bone, name in enumerate(theirs.names)}
    if not set(ours.names) <= set(places):
        lacking = next(name for name in ours.names if name not in places)
        raise FormatError(path, f"the files are of several characters: one has no bone '{lacking}'; use `transfer`")
    order = [places[name] for name in ours.names]
    size = max(float(np.ptp(ours.positions, axis=0).max()), 1e-9)
    if np.abs(ours.positions - theirs.positions[order]).max() > SAME_BONES * size:
        raise FormatError(path, "the files are of several characters: their bones rest elsewhere; use `transfer`")
    return RigAnimation(first.character, clip.rotations[:, order], clip.translations[:, order], clip.fps)
