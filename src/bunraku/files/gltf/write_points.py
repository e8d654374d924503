"""Write GLB where vertices move on their own: the skin for most of it, and bones or morph targets for the rest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bunraku.core.animation import Animation
from bunraku.core.body.layout import handle_names
from bunraku.core.character import Handles
from bunraku.core.geometry.rotations import adjugates
from bunraku.core.motion import HandleMotion, checked_fps
from bunraku.core.skinning import RigidBones, decomposed
from bunraku.errors import OptionError
from bunraku.files.gltf.document import GltfBuilder
from bunraku.files.gltf.write import (
    add_motion,
    build_document,
    document_of,
    finish_document,
    joint_attributes,
    keeps_positions,
)

if TYPE_CHECKING:
    from bunraku.core.animation import PointAnimation
    from bunraku.core.character import Character


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes and their amounts over time."""

    shapes: np.ndarray  # displacements [m], shape (T, M, 3), float32
    frames: np.ndarray  # frames that have keys, ascending, shape (F,); between them weights are linear
    weights: np.ndarray  # weights from 0 to 1, shape (F, T), float32

    @property
    def size(self) -> int:
        """About how many bytes they take in a file."""
        return self.shapes.nbytes + self.weights.nbytes

    def offsets(self, count: int) -> np.ndarray:
        """Displacements in each of `count` frames [m], shape (N, M, 3)."""
        weights = np.stack([np.interp(np.arange(count), self.frames, column) for column in self.weights.T], axis=1)
        mixed = weights.astype(np.float32) @ self.shapes.reshape(len(self.shapes), -1)
        return np.asarray(mixed.reshape(count, -1, 3))


def key_shapes(offsets: np.ndarray, tolerance: float) -> Shapes:
    """The shapes of some frames of displacements [m] (N, M, 3), blended in straight lines from each to the next: never
    more than two at once. No point in any frame is off by more than the tolerance [m].
    """
    last = len(offsets) - 1
    keys = [0]
    while keys[-1] < last:
        near, step = keys[-1] + 1, 1
        while near < last and _straight(offsets, keys[-1], min(keys[-1] + 2 * step, last), tolerance):
            step *= 2
            near = min(keys[-1] + step, last)
        far = min(keys[-1] + 2 * step, last)
        while far - near > 1:  # near can be reached, far cannot
            middle = (near + far) // 2
            near, far = (middle, far) if _straight(offsets, keys[-1], middle, tolerance) else (near, middle)
        keys.append(near)
    moving = [key for key in keys if np.abs(offsets[key]).max(initial=0) > 0.1 * tolerance]
    weights = np.zeros((len(keys), len(moving)), np.float32)
    for column, key in enumerate(moving):
        weights[keys.index(key), column] = 1
    return Shapes(np.ascontiguousarray(offsets[moving], np.float32), np.array(keys), weights)


def _straight(offsets: np.ndarray, first: int, last: int, tolerance: float) -> bool:
    """Whether the frames between two are near enough to the straight line between these."""
    if last - first < 2:
        return True
    share = (np.arange(first + 1, last) - first) / (last - first)
    line = offsets[first] + share[:, None, None].astype(np.float32) * (offsets[last] - offsets[first])
    return bool(((offsets[first + 1 : last] - line) ** 2).sum(axis=-1).max() <= tolerance**2)


def mixed_shapes(offsets: np.ndarray, tolerance: float) -> Shapes:
    """The fewest shapes whose sums give all frames, by singular values: fewer than `key_shapes`, and all present in
    every frame. Their signs and sizes make weights run from 0 to 1; one more shape, always fully present, compensates
    for that. Arguments are those of `key_shapes`.
    """
    count = len(offsets)
    flat = offsets.reshape(count, -1).astype(np.float64)
    middle = flat.mean(axis=0)
    away = flat - middle
    values, vectors = np.linalg.eigh(away @ away.T)  # N x N: clips have fewer frames than coordinates
    vectors = vectors[:, ::-1][:, values[::-1] > 1e-12 * max(float(values[-1]), 1e-30)]
    basis = vectors.T @ away  # rows orthogonal, largest first
    low, high = 0, vectors.shape[1]

    def near(rank: int) -> bool:
        left = (away - vectors[:, :rank] @ basis[:rank]).reshape(count, -1, 3)
        return bool((left**2).sum(axis=-1).max(initial=0) <= (0.98 * tolerance) ** 2)  # room for float32

    while low < high:
        rank = (low + high) // 2
        low, high = (low, rank) if near(rank) else (rank + 1, high)
    mix = vectors[:, :low]
    least, span = mix.min(axis=0), np.ptp(mix, axis=0)
    shapes = np.concatenate([(middle + least @ basis[:low])[None], span[:, None] * basis[:low]])
    weights = np.concatenate([np.ones((count, 1)), (mix - least) / np.maximum(span, 1e-30)], axis=1)
    shapes = shapes.reshape(len(shapes), -1, 3).astype(np.float32)
    return Shapes(shapes, np.arange(count), np.clip(weights, 0, 1).astype(np.float32))


TOLERANCE = 5e-4  # of the character's height
FLATTEST = 0.1  # skin that squeezes a vertex's surroundings more than to this share is not taken back further
CHUNK = 32  # frames at once
FEWEST_BONES, MOST_BONES = 4, 256
PROBE, PROBED = 32, 4
"""This many bones are first fitted to each fourth vertex: if they miss by far, few more will not do."""
BONE_BYTES = 28  # of a bone in a frame: a translation and a quaternion
ZERO = {"componentType": 5126, "type": "VEC3"}


def write_point_animation(
    animation: PointAnimation,
    path: Path,
    *,
    fps: float | None = None,
    name: str | None = None,
    tolerance: float | None = None,
    shapes: str = "auto",
) -> Path:
    """Write an animation whose vertices also move on their own as GLB; further options are those of
    `write_animation`. FormatError if the file cannot be written; OptionError if an option makes no sense, or no bones
    of this number come as near as the tolerance.

    Args:
        tolerance: Largest error of a vertex [m]; 0.05 % of the height by default.
        shapes: "bones" fits bones to the movement; "mixed" takes the fewest morph targets that all frames are mixed of;
            "keys" those of some frames, of which at most two show at any time, for players that cannot mix many. Those
            files are larger, by far where cloth moves fast. "auto" takes bones or mixed targets, whichever are smaller.
    """
    moved = animation.at(checked_fps(fps, animation.motion.fps))
    fitted = fitted_points(moved, tolerance, shapes)
    handles, motion = fitted.animation.handles, fitted.animation.motion
    builder, joints = build_document(animation.character, handles, path)
    for joint, label in zip(joints, fitted.names, strict=True):
        builder.tree["nodes"][joint]["name"] = label
    add_motion(builder, joints, handles.positions, motion, str(name) if name else path.stem)
    if fitted.shapes is not None:
        _add_targets(builder, moved, fitted.moving, fitted.shapes)
    return finish_document(builder, path)


@dataclass(frozen=True, eq=False)
class FittedPoints:
    """What plays vertices that move on their own."""

    animation: Animation  # the skinned part, with the bones of those vertices where they have some
    names: tuple[str, ...]  # of its handles and bones
    moving: np.ndarray  # vertices that move on their own, shape (M,)
    shapes: Shapes | None  # their shapes, where they have no bones


def fitted_points(moved: PointAnimation, tolerance: float | None = None, shapes: str = "auto") -> FittedPoints:
    """Bones or shapes for vertices that move on their own, for files. The animation is at the rate of the file; further
    arguments are those of `write_point_animation`. OptionError if an option makes no sense, or no bones of this number
    come as near as the tolerance.
    """
    if shapes not in ("auto", "bones", "keys", "mixed"):
        raise OptionError(f"shapes are 'auto', 'bones', 'keys' or 'mixed', not {shapes!r}")
    limit = TOLERANCE * moved.character.height if tolerance is None else float(tolerance)
    if not 0 < limit < np.inf:
        raise OptionError(f"the tolerance must be a length over 0, not {tolerance!r}")
    moving = np.flatnonzero((np.linalg.norm(moved.offsets, axis=-1) > 0.5 * limit).any(axis=0))
    where = moved.offsets[:, moving]
    if len(moving):
        where = where + moved.animation.vertices(chosen=moving)
    found = None
    if len(moving) and shapes != "bones":
        local = before_skin(moved, moving, where)
        found = (key_shapes if shapes == "keys" else mixed_shapes)(local, 0.95 * limit)
    baked, count = moved.animation, len(moved.animation.handles.positions)
    if len(moving) and shapes in ("auto", "bones"):
        fitted = _with_bones(moved, moving, where, 0.95 * limit, None if found is None else found.size)
        if fitted is None and shapes == "bones":
            raise OptionError(
                f"{MOST_BONES} bones do not come within {limit:.4g} m; give a larger tolerance or shapes='mixed'"
            )
        baked, found = (fitted, None) if fitted is not None else (baked, found)
    more = range(1, len(baked.handles.positions) - count + 1)
    names = (*handle_names(moved.animation.handles.played), *(f"apparel_{number}" for number in more))
    return FittedPoints(baked, names, moving, found if found is not None and len(found.shapes) else None)


def _with_bones(
    moved: PointAnimation, moving: np.ndarray, where: np.ndarray, tolerance: float, most: int | None
) -> Animation | None:
    """The animation with the fewest additional bones (4, 8, 16 and so on) that take some vertices to their positions
    (N, M, 3); None where that takes too many, or more bytes than `most`, or is likely to: twice as many bones leave
    about half of the error.
    """
    animation = moved.animation
    handles, motion = animation.handles, animation.motion
    rest, root = moved.character.vertices[moving].astype(np.float64), handles.positions[0].astype(np.float64)
    # bones hang on the root handle: y = R_g' (x - h_0 - t_g) + h_0 (Eq. 3)
    posed = (where - root - motion.root_translation[:, None]) @ motion.root_rotation + root
    bones = FEWEST_BONES
    if len(rest) > PROBE * PROBED and (most is None or PROBE * _bytes_of_bone(len(motion)) < most):
        missed = decomposed(rest[::PROBED], posed[:, ::PROBED], PROBE).error / tolerance
        if missed > MOST_BONES / PROBE and most is not None:
            return None
        bones = FEWEST_BONES if missed <= 1 else 2 * PROBE
    while bones <= MOST_BONES and bones <= len(rest):
        if most is not None and bones * _bytes_of_bone(len(motion)) >= most:
            return None
        shapes = decomposed(rest, posed, bones)
        if shapes.error <= tolerance:
            return _joined(animation, moving, shapes)
        bones *= 2
    return None


def _bytes_of_bone(frames: int) -> int:
    return BONE_BYTES * frames + 64


def _joined(animation: Animation, moving: np.ndarray, found: RigidBones) -> Animation:
    """An animation with the bones of some vertices after its handles."""
    handles, motion = animation.handles, animation.motion
    count, bones = len(handles.positions), found.weights.shape[1]
    weights = np.zeros((len(handles.weights), count + bones), np.float32)
    weights[:, :count] = handles.weights
    weights[moving] = 0
    weights[moving, count:] = found.weights
    rest = animation.character.vertices[moving].astype(np.float64)
    positions = found.weights.T @ rest / np.maximum(found.weights.sum(axis=0), 1e-9)[:, None]
    # R p + t = R (p - h) + h + s, so s = R h + t - h
    shifts = np.einsum("nbac,bc->nba", found.rotations, positions) + found.translations - positions
    joined = HandleMotion(
        translations=np.concatenate([motion.translations, shifts], axis=1),
        rotations=np.concatenate([motion.rotations, found.rotations], axis=1),
        root_translation=motion.root_translation, root_rotation=motion.root_rotation, fps=motion.fps,
    )  # fmt: skip
    return Animation(animation.character, Handles(np.concatenate([handles.positions, positions]), weights), joined)


@dataclass(frozen=True, eq=False)
class GroupShapes:
    """What shapes do to the vertices that some primitives of a mesh share."""

    primitives: tuple[int, ...]  # which of the mesh's primitives, counted as in its source
    count: int  # how many vertices they have
    rows: np.ndarray  # those that move, ascending, shape (R,)
    shapes: np.ndarray  # their displacement by each shape, in the mesh's own frame, shape (T, R, 3)


def shapes_of_meshes(character: Character, moving: np.ndarray, shapes: np.ndarray) -> list[list[GroupShapes]]:
    """Displacements [m] (T, M, 3) of the vertices that move (M,), for the meshes of the character's document that have
    vertices, in its order; an empty list where nothing moves.
    """
    source = document_of(character)
    numbering = np.full(len(character.vertices), -1)
    numbering[moving] = np.arange(len(moving))
    out: list[list[GroupShapes]] = []
    for part, index in source.placed():
        out.append([])
        if (numbering[index] < 0).all():
            continue
        kept = keeps_positions(part, character.vertices[index], character) and part.transform is not None
        back = np.linalg.inv(part.transform[:3, :3]) if kept and part.transform is not None else np.eye(3)
        for group, vertices in part.split(numbering[index]):
            rows = np.flatnonzero(vertices >= 0)
            values = np.ascontiguousarray((shapes @ back.T)[:, vertices[rows]], "<f4")
            out[-1].append(GroupShapes(group.primitives, len(vertices), rows, values))
    return out


def before_skin(moved: PointAnimation, moving: np.ndarray, where: np.ndarray | None = None) -> np.ndarray:
    """Displacements of some vertices (M,) in the rest pose that the four weights of the file take to their positions
    [m], shape (N, M, 3); `where` gives the positions if they are known.
    """
    handles, rest = moved.animation.handles, moved.character.vertices[moving].astype(np.float64)
    if where is None:
        where = moved.animation.vertices(chosen=moving) + moved.offsets[:, moving]
    joints, shares = joint_attributes(handles.weights[moving])
    held = np.zeros((len(moving), handles.weights.shape[1]))
    for column in range(joints.shape[1]):
        held[np.arange(len(moving)), joints[:, column]] += shares[:, column]
    transforms = moved.motion.transforms(handles.positions)
    out = np.empty((len(moved.motion), len(moving), 3), np.float32)
    for start in range(0, len(moved.motion), CHUNK):
        cut = slice(start, start + CHUNK)
        stay = transforms[cut].astype(np.float64)
        blend = (held @ stay.reshape(len(stay), -1, 12)).reshape(len(stay), len(moving), 3, 4)
        left = where[cut] - np.einsum("nmab,mb->nma", blend[..., :3], rest) - blend[..., 3]
        out[cut] = np.einsum("nmab,nmb->nma", _inverses(blend[..., :3]), left)
    return out


def _inverses(matrices: np.ndarray) -> np.ndarray:
    """Inverses that stretch nothing beyond 1 / `FLATTEST`."""
    adjugate = adjugates(matrices)
    det = np.einsum("...a,...a->...", matrices[..., 0, :], adjugate[..., :, 0])
    bad = np.abs(det) <= FLATTEST
    out = adjugate / np.where(bad, 1.0, det)[..., None, None]
    if bad.any():
        u, s, vt = np.linalg.svd(matrices[bad])
        out[bad] = (np.swapaxes(vt, -1, -2) / np.maximum(s, FLATTEST)[:, None, :]) @ np.swapaxes(u, -1, -2)
    return out


def _add_targets(builder: GltfBuilder, moved: PointAnimation, moving: np.ndarray, found: Shapes) -> None:
    """Add the shapes to the meshes that have such vertices, and their weights to the clip."""
    times = builder.array((found.frames / moved.motion.fps).astype(np.float32)[:, None], bounds=True)
    nodes = builder.tree["scenes"][0]["nodes"][1:]
    clip = builder.tree["animations"][-1]
    for node, groups in zip(nodes, shapes_of_meshes(moved.character, moving, found.shapes), strict=True):
        if not groups:
            continue
        mesh = builder.tree["meshes"][builder.tree["nodes"][node]["mesh"]]
        targets: dict[int, list[dict[str, int]]] = {}
        for group in groups:
            targets |= dict.fromkeys(group.primitives, _targets(builder, group))
        older = max((len(primitive.get("targets", [])) for primitive in mesh["primitives"]), default=0)
        present = [primitive for primitive in mesh["primitives"] if primitive]
        for member, primitive in zip(sorted(targets), present, strict=True):
            primitive["targets"] = [*primitive.get("targets", []), *targets[member]]
        names = mesh.get("extras", {}).get("targetNames") if isinstance(mesh.get("extras"), dict) else None
        if isinstance(names, list) and len(names) == older:  # programs pass over lists of another length
            mesh["extras"]["targetNames"] = [*names, *(f"move_{shape}" for shape in range(len(found.shapes)))]
        # at rest none of them is there, so what is read back without its clip is the character as it was
        mesh["weights"] = [*mesh.get("weights", [0.0] * older), *([0.0] * len(found.shapes))]
        weights = np.tile(np.array(mesh["weights"], np.float32), (len(found.frames), 1))
        weights[:, older:] = found.weights
        builder.channel(clip, node, "weights", times, builder.array(weights.reshape(-1, 1)))


def _targets(builder: GltfBuilder, group: GroupShapes) -> list[dict[str, int]]:
    """Morph targets of a group of vertices."""
    rows, total = group.rows, group.count
    if not len(rows):
        accessor = builder.zeros({**ZERO, "count": total, "min": [0.0] * 3, "max": [0.0] * 3})
        return [{"POSITION": accessor} for _ in group.shapes]
    code, kind = (5121, np.uint8) if total <= 256 else (5123, "<u2") if total <= 65536 else (5125, "<u4")
    where = {"bufferView": builder.view(rows.astype(kind).tobytes()), "componentType": code}
    out = []
    for values in group.shapes:
        low, high = values.min(axis=0), values.max(axis=0)
        if len(rows) < total:
            low, high = np.minimum(low, 0), np.maximum(high, 0)
        entry: dict[str, Any] = {**ZERO, "count": total, "min": low.tolist(), "max": high.tolist()}
        stored = {"bufferView": builder.view(values.tobytes())}
        entry["sparse"] = {"count": len(rows), "indices": where, "values": stored}
        out.append({"POSITION": builder.zeros(entry)})
    return out
