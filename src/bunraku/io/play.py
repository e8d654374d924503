"""Play a clip of a glTF or FBX file on the file's own skin."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import posed_points
from bunraku.errors import FormatError, OptionError
from bunraku.formats.gltf.container.document import Document
from bunraku.formats.gltf.curves import MAX_SECONDS, clip_curves, node_worlds
from bunraku.formats.gltf.read import Source
from bunraku.geometry.rotations import nearest_rotation
from bunraku.io.registry import load_with_clips

__all__ = ["bones_of", "clip_names", "load_animation"]

MAX_TRANSFORMS = 4_000_000


def load_animation(path: str | Path, clip: int | str = 0, fps: float = 30.0) -> Animation:
    """Read a character and a clip of its file, as an animation whose handles are the file's joints.

    Each joint becomes a handle that holds the vertices of its skin; handle 0 stands still and holds none. A joint's
    transform is taken relative to the bind pose, in which the character rests, so skinned meshes are exact; where a
    file has no bind pose that makes sense, it is relative to the default pose and the result is close. Scales and
    shears of joints are kept.

    Args:
        path: A GLB, glTF, VRM or FBX file with a skin and a clip.
        clip: Number or name of the clip, with or without its armature's name before a bar.
        fps: Frames a second of the result [1/s].

    Raises:
        FormatError: The file cannot be read, or has no skin or no clip.
        OptionError: The file has no clip of this name or number, or `fps` is not from 1 to 240.
    """
    path = Path(path)
    if not 1 <= fps <= 240:
        raise OptionError(f"frames a second must be from 1 to 240, not {fps:g}")
    character = load_with_clips(path, fps)
    source = character.source
    if not isinstance(source, Source) or not source.document.items("animations"):
        raise FormatError(path, "it holds no animation; make one with `bunraku animate`")
    if character.rig is None:
        raise FormatError(path, "its animation moves no skin, which is all that is played; export it with its skin")
    document = source.document
    channels = document.items("animations")[_find(document, clip)]
    curves = clip_curves(document, channels)
    end = max((float(times[-1]) for times, _, _ in curves.values()), default=0.0)
    if end > MAX_SECONDS:
        raise FormatError(path, f"its clip lasts {end:.0f} s but at most {MAX_SECONDS:.0f} s are played; cut it")
    moments = np.arange(int(np.floor(end * fps + 1e-3)) + 1) / fps
    if len(moments) * len(character.rig.names) > MAX_TRANSFORMS:
        raise FormatError(
            path,
            f"its clip of {end:.0f} s moves {len(character.rig.names)} joints, too many to play; ask for fewer frames "
            "a second",
        )
    world = node_worlds(document, source.tree, curves, moments, source.skins.nodes)
    return _animation(character, world, fps)


def clip_names(document: Document) -> list[str]:
    """Names of the clips of a document; numbered where the file gives none."""
    return [str(clip.get("name") or f"animation {number}") for number, clip in enumerate(document.items("animations"))]


def _find(document: Document, clip: int | str) -> int:
    names = clip_names(document)
    short = [name.rsplit("|", 1)[-1] for name in names]  # exporters write "Armature|Walk"
    for known in (names, short):
        if clip in known:
            return known.index(str(clip))
    number = int(clip) if str(clip).isdecimal() else -1
    if not 0 <= number < len(names):
        raise OptionError(f"{document.path} has no clip {clip!r}; it has {', '.join(names[:20])}")
    return number


def _animation(character: Character, world: np.ndarray, fps: float) -> Animation:
    rig = character.rig
    assert rig is not None
    change = world @ np.linalg.pinv(rig.transforms)
    frames, joints = change.shape[:2]
    positions = np.concatenate([np.zeros((1, 3)), rig.positions])
    rotations = np.tile(np.eye(3), (frames, joints + 1, 1, 1))
    rotations[:, 1:] = change[..., :3, :3]
    translations = np.zeros((frames, joints + 1, 3))
    translations[:, 1:] = (
        change[..., :3, 3] - rig.positions + np.einsum("njab,jb->nja", change[..., :3, :3], rig.positions)
    )
    weights = np.concatenate([np.zeros((len(character.vertices), 1), np.float32), rig.dense_weights()], axis=1)
    weights[:, 0] = 1 - weights[:, 1:].sum(axis=1)
    still = np.broadcast_to(np.eye(3), (frames, 3, 3))
    return Animation(
        character, Handles(positions, weights), HandleMotion(translations, rotations, np.zeros((frames, 3)), still, fps)
    )


def bones_of(animation: Animation) -> tuple[np.ndarray, np.ndarray]:
    """World rotations (N, J, 3, 3) and heads [m] (N, J, 3) of the bones of a clip whose handles they are."""
    assert animation.character.rig is not None
    affine = animation.motion.transforms(animation.handles.positions)[:, 1:].astype(np.float64)
    return nearest_rotation(affine[..., :3]), posed_points(affine, animation.character.rig.positions)
