"""Play a clip of a glTF or FBX file on the file's own skin."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bunraku.animation import Animation
from bunraku.character import Character, Handles
from bunraku.errors import FormatError, OptionError
from bunraku.formats.gltf_document import Document
from bunraku.formats.gltf_nodes import NodeTree
from bunraku.formats.gltf_read import Source
from bunraku.formats.registry import load_with_clips
from bunraku.geometry.rotations import matrix_from_quaternion, quaternion_slerp
from bunraku.motion import HandleMotion

__all__ = ["clip_names", "load_animation"]

MAX_SECONDS = 600.0
MAX_TRANSFORMS = 4_000_000
_DEFAULTS = {"translation": [0.0, 0, 0], "rotation": [0.0, 0, 0, 1], "scale": [1.0, 1, 1]}


def load_animation(path: str | Path, clip: int | str = 0, fps: float = 30.0) -> Animation:
    """Read a character and a clip of its file, as an animation whose handles are the file's joints.

    Each joint becomes a handle that holds the vertices of its skin; handle 0 stands still and holds none. A joint's transform
    is taken relative to the bind pose, in which the character rests, so skinned meshes are exact; where a file has no bind pose
    that makes sense, it is relative to the default pose and the result is close. Scales and shears of joints are kept.

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
    curves = _curves(document, channels)
    end = max((float(times[-1]) for times, _, _ in curves.values()), default=0.0)
    if end > MAX_SECONDS:
        raise FormatError(path, f"its clip lasts {end:.0f} s but at most {MAX_SECONDS:.0f} s are played; cut it")
    moments = np.arange(int(np.floor(end * fps + 1e-3)) + 1) / fps
    if len(moments) * len(character.rig.names) > MAX_TRANSFORMS:
        raise FormatError(path, f"its clip of {end:.0f} s moves {len(character.rig.names)} joints, too many to play; ask for fewer frames a second")
    world = _world(document, source.tree, curves, moments, source.skins.nodes)
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


def _curves(document: Document, animation: dict[str, Any]) -> dict[tuple[int, str], tuple[np.ndarray, np.ndarray, str]]:
    """Times (M,), values (M, C) or (M, 3, C), and interpolation of each animated (node, property)."""
    samplers = document.objects(animation, "samplers")
    curves = {}
    for channel in document.objects(animation, "channels"):
        target = channel.get("target")
        if not isinstance(target, dict) or target.get("path") not in _DEFAULTS or "node" not in target:
            continue  # morph targets and what extensions add
        node, kind = document.integer(target, "node", high=max(len(document.items("nodes")) - 1, 0)), target["path"]
        index = document.integer(channel, "sampler")
        if index >= len(samplers):
            document.fail("an animation channel names a sampler that does not exist; the file is broken, export it again")
        how = samplers[index].get("interpolation", "LINEAR")
        times = document.accessor(samplers[index].get("input"), ("SCALAR",))[:, 0].astype(float)
        values = document.accessor(samplers[index].get("output"), ("VEC4",) if kind == "rotation" else ("VEC3",)).astype(float)
        keys = 3 if how == "CUBICSPLINE" else 1
        if (
            not len(times)
            or len(values) != keys * len(times)
            or (np.diff(times) <= 0).any()
            or not np.isfinite(values).all()
            or not np.isfinite(times).all()
        ):
            document.fail("an animation channel has keys that do not fit together; the file is broken, export it again")
        curves[node, kind] = (times, values.reshape(len(times), 3, -1) if keys == 3 else values, str(how))
    return curves


def _sample(times: np.ndarray, values: np.ndarray, how: str, kind: str, moments: np.ndarray) -> np.ndarray:
    """Values of a curve at moments [s], held before the first key and after the last, shape (N, C)."""
    before = np.clip(np.searchsorted(times, moments, side="right") - 1, 0, len(times) - 1)
    after = np.minimum(before + 1, len(times) - 1)
    step = times[after] - times[before]
    share = np.clip((moments - times[before]) / np.where(step > 0, step, 1), 0, 1)
    if how == "STEP":
        return values[before]
    if how == "CUBICSPLINE":
        s, d = share[:, None], step[:, None]
        start, end = values[before], values[after]  # each key: in-tangent, value, out-tangent
        out = (2 * s**3 - 3 * s**2 + 1) * start[:, 1] + d * (s**3 - 2 * s**2 + s) * start[:, 2]
        return out + (3 * s**2 - 2 * s**3) * end[:, 1] + d * (s**3 - s**2) * end[:, 0]
    if kind == "rotation":
        return quaternion_slerp(values[before], values[after], share)
    return values[before] + (values[after] - values[before]) * share[:, None]


def _world(document: Document, tree: NodeTree, curves: dict[tuple[int, str], Any], moments: np.ndarray, chosen: list[int]) -> np.ndarray:
    """World transforms of the chosen nodes at each moment, shape (N, J, 4, 4)."""
    nodes = document.items("nodes")
    moving = {node for node, _ in curves}
    known: dict[int, np.ndarray] = {}

    def world(node: int) -> np.ndarray:
        chain = []
        while node >= 0 and node not in known:
            chain.append(node)
            node = int(tree.parents[node])
        for link in reversed(chain):
            above = int(tree.parents[link])
            if link not in moving:  # its default place, carried along by what is above it
                rest = tree.local[link]
                known[link] = known[above] @ rest if above >= 0 else np.broadcast_to(rest, (len(moments), 4, 4))
            else:
                local = _local(document, nodes[link], link, curves, moments)
                known[link] = known[above] @ local if above >= 0 else _front(document) @ local
        return known[chain[0]] if chain else known[node]

    return np.stack([world(node) for node in chosen], axis=1)


def _front(document: Document) -> np.ndarray:
    """What turns a VRM 0.x avatar, which looks along -Z, as reading its character does."""
    extensions = document.tree.get("extensions")
    return np.diag([-1.0, 1, -1, 1]) if isinstance(extensions, dict) and "VRM" in extensions else np.eye(4)


def _local(document: Document, node: dict[str, Any], index: int, curves: dict[tuple[int, str], Any], moments: np.ndarray) -> np.ndarray:
    parts = {}
    for kind, default in _DEFAULTS.items():
        if (index, kind) in curves:
            times, values, how = curves[index, kind]
            parts[kind] = _sample(times, values, how, kind, moments)
        else:
            parts[kind] = np.broadcast_to(document.numbers(node, kind, default), (len(moments), len(default)))
    local = np.zeros((len(moments), 4, 4))
    local[:, :3, :3] = matrix_from_quaternion(parts["rotation"]) * parts["scale"][:, None, :]
    local[:, :3, 3], local[:, 3, 3] = parts["translation"], 1
    return local


def _animation(character: Character, world: np.ndarray, fps: float) -> Animation:
    rig = character.rig
    assert rig is not None
    change = world @ np.linalg.pinv(rig.transforms)
    frames, joints = change.shape[:2]
    positions = np.concatenate([np.zeros((1, 3)), rig.positions])
    rotations = np.tile(np.eye(3), (frames, joints + 1, 1, 1))
    rotations[:, 1:] = change[..., :3, :3]
    translations = np.zeros((frames, joints + 1, 3))
    translations[:, 1:] = change[..., :3, 3] - rig.positions + np.einsum("njab,jb->nja", change[..., :3, :3], rig.positions)
    weights = np.concatenate([np.zeros((len(character.vertices), 1), np.float32), rig.dense_weights()], axis=1)
    weights[:, 0] = 1 - weights[:, 1:].sum(axis=1)
    still = np.broadcast_to(np.eye(3), (frames, 3, 3))
    return Animation(character, Handles(positions, weights), HandleMotion(translations, rotations, np.zeros((frames, 3)), still, fps))
