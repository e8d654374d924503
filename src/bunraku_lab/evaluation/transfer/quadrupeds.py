"""Motion of four-legged animals on other four-legged animals: where the limbs point, and what stands on the ground.

Rigged animals with clips are the truth on both sides. A clip becomes what motion capture of a dog comes as: a skeleton
with the names of people, whose rest pose is no pose, because all its bones lie along one axis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.character import Character
from bunraku.core.geometry.rotations import nearest_rotation, rotation_between
from bunraku.core.motion import SkeletalMotion, Skeleton, local_rotations
from bunraku.errors import BunrakuError
from bunraku.retarget.rig_parts import RigParts
from bunraku_lab.datasets.motions.creatures import known_plan
from bunraku_lab.evaluation.transfer.character import carried_heads, facing_character

FPS = 30.0
SECONDS = 6.0
_NAMES = {
    "pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck", "head": "Head",
    "collar": "Shoulder", "shoulder": "Arm", "elbow": "ForeArm", "wrist": "Hand", "hip": "UpLeg", "knee": "Leg",
    "ankle": "Foot", "foot": "ToeBase", "tail": "Tail", "tail_tip": "Tail1",
}  # fmt: skip
_LIMBS = [HANDLE_NAMES.index(f"{side}_{top}") for side in ("left", "right") for top in ("hip", "shoulder")]
_HIND = [HANDLE_NAMES.index(f"{side}_ankle") for side in ("left", "right")]
_BACK = [HANDLE_NAMES.index(name) for name in ("spine1", "spine2", "spine3")]


@dataclass(frozen=True, eq=False)
class CapturedAnimal:
    """A clip of an animal as motion capture brings it.

    Args:
        motion: Of its skeleton.
        limbs: Where its four limbs point, from the hip or the shoulder to the paw, shape (N, 4, 3): left hind, left
            front, right hind, right front.
    """

    motion: SkeletalMotion
    limbs: np.ndarray


def captured_animal(animation: Animation | RigAnimation, parts: RigParts, flat: bool = True) -> CapturedAnimal:
    """A clip of a rigged animal as a skeleton of the parts that its bones' names tell.

    Args:
        animation: Of its bones; it faces as `parts` do, +Z.
        parts: Of its character.
        flat: All bones of the rest pose lie along one axis; otherwise it is the rig's.
    """
    from bunraku.files import bones_of

    turns, positions = animation.world() if isinstance(animation, RigAnimation) else bones_of(animation)
    handles = [handle for handle in range(len(HANDLE_NAMES)) if parts.leads[handle] >= 0 and _name(handle)]
    handles.sort(key=lambda handle: _depth(handle, parts))
    index = {handle: number for number, handle in enumerate(handles)}
    parents = np.array([index.get(_above(handle, parts, index), -1) for handle in handles])
    assert parts.character.rig is not None
    rest = parts.character.rig.positions[parts.leads[handles]]
    world = nearest_rotation(turns[:, parts.leads[handles]])
    offsets = rest.copy()
    offsets[1:] -= rest[parents[1:]]
    if flat:
        frames = np.tile(np.eye(3), (len(handles), 1, 1))
        for joint in range(len(handles)):
            below = np.flatnonzero(parents == joint)
            bone = rest[below[0]] - rest[joint] if len(below) else frames[parents[joint]][:, 0]
            frames[joint] = rotation_between(np.array([1.0, 0, 0]), bone)
        world = world @ frames
        offsets[1:] = np.einsum("jba,jb->ja", frames[parents[1:]], offsets[1:])
    skeleton = Skeleton(tuple(_name(handle) for handle in handles), parents, offsets)
    root = positions[:, parts.leads[0]]
    motion = SkeletalMotion(skeleton, local_rotations(world, parents), root, animation.fps)
    heads = positions[:, np.maximum(parts.leads, 0)]
    return CapturedAnimal(motion, _limbs(parts, heads, animation.vertices()))


def _limbs(parts: RigParts, heads: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Where the four limbs of a rigged animal point, shape (N, 4, 3)."""
    legs = {leg.upper: leg for leg in parts.anatomy.legs}
    return np.stack([vertices[:, legs[top].sole].mean(axis=1) - heads[:, top] for top in _LIMBS], axis=1)


def _name(handle: int) -> str:
    side, _, part = HANDLE_NAMES[handle].partition("_")
    if side in ("left", "right"):
        return side.capitalize() + _NAMES[part] if part in _NAMES else ""
    return _NAMES.get(HANDLE_NAMES[handle], "")


def _depth(handle: int, parts: RigParts) -> int:
    depth = 0
    while handle > 0:
        handle, depth = int(parts.joints.parents[handle]), depth + 1
    return depth


def _above(handle: int, parts: RigParts, index: Mapping[int, int]) -> int:
    if handle == 0:
        return -1
    above = int(parts.joints.parents[handle])
    while above > 0 and above not in index:
        above = int(parts.joints.parents[above])
    return above


def _four_legged(character: Character, name: str) -> RigParts | None:
    """The rig of a character on four legs, by the archive's table of body plans or by the rig; None of others."""
    if (known_plan(name) or "quadruped") != "quadruped":
        return None
    try:
        parts = RigParts.of(character)
    except BunrakuError:
        return None
    return parts if sorted(leg.upper for leg in parts.anatomy.legs) == sorted(_LIMBS) else None


def measure_quadrupeds(
    characters: Mapping[str, Path], *, word: str = "walk", sources: int = 3,
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Captured skeletons of four-legged animals on the predicted handles of all others and of the sample dog.

    Args:
        characters: Files by their names; those that do not stand on four legs are passed over.
        word: Of the clips that are taken.
        sources: How many animals give their clips, spread over all that have one.

    Returns:
        `quadruped_limbs_degrees`, the mean angle between limbs of the source and of the result, None where no animal
        brings a clip; `quadruped_ground`, the mean share of the height by which the lowest point of a frame is off the
        ground; `quadruped_hind_above_back`, the share of frames in which a hind foot is above the back; and
        `quadrupeds` with a row for each pair.
    """
    from bunraku.files import clip_names, load_animation
    from bunraku.pipelines.animate import rig
    from bunraku.pipelines.animator import Animator
    from bunraku.pipelines.requests import TransferRequest
    from bunraku.pipelines.to_reference import creature_motion
    from bunraku.pipelines.transfer import fitted_transfer
    from bunraku_lab.synthetic.samples import make_sample

    targets: dict[str, tuple[Character, RigParts]] = {}
    clips: dict[str, CapturedAnimal] = {}
    for name, path in characters.items():
        try:
            character = facing_character(path, name)
            parts = _four_legged(character, name)
            if parts is None:
                continue
            targets[name] = character, parts
            titles = clip_names(character.source.document) if character.source is not None else []
            found = next((number for number, title in enumerate(titles) if word in title.lower()), None)
            if found is not None:
                clips[name] = captured_animal(load_animation(path, found, FPS), parts)
        except BunrakuError:
            continue
    nothing = ("quadruped_limbs_degrees", "quadruped_ground", "quadruped_hind_above_back")
    if not clips:
        return {**dict.fromkeys(nothing), "quadrupeds": []}
    dog = make_sample("dog", rigged=True)
    targets["sample dog"] = dog, RigParts.of(dog)
    chosen = [list(clips)[number] for number in np.unique(np.linspace(0, len(clips) - 1, sources).round().astype(int))]
    rows: list[dict[str, Any]] = []
    for number, (name, (character, parts)) in enumerate(targets.items()):
        handles = rig(character)
        for source in chosen:
            if source != name:
                row: dict[str, Any] = {"source": source, "target": name}
                try:
                    motion = creature_motion(clips[source].motion, fps=FPS)
                    if motion is None:
                        row["failed"] = "no four legs were seen to stand"
                    else:
                        result = fitted_transfer(
                            Animator.shipped(), character, motion, TransferRequest("handles", handles=handles)
                        )
                        assert isinstance(result, Animation)
                        row |= _measured(result, parts, clips[source])
                except BunrakuError as error:
                    row["failed"] = str(error)
                rows.append(row)
        if progress:
            progress("quadrupeds", (number + 1) / len(targets))
    done = [row for row in rows if "failed" not in row]
    means = [
        float(np.mean([row[key] for row in done])) if done else None for key in ("degrees", "ground", "above_back")
    ]
    return {**dict(zip(nothing, means, strict=True)), "quadrupeds": rows}


def _measured(result: Animation, parts: RigParts, source: CapturedAnimal) -> dict[str, float]:
    count = min(len(result.motion), len(source.limbs))
    frames = np.arange(0, min(count, round(SECONDS * result.fps)))
    heads = carried_heads(parts, result, frames)
    vertices = result.vertices(frames)
    own, want = _limbs(parts, heads, vertices), source.limbs[frames]
    scale = np.linalg.norm(own, axis=-1) * np.linalg.norm(want, axis=-1)
    angles = np.degrees(np.arccos(np.clip((own * want).sum(axis=-1) / np.maximum(scale, 1e-12), -1, 1)))
    seen = result.character.surface
    floor = float(result.character.vertices[seen, 1].min())
    lowest = vertices[:, seen, 1].min(axis=1) - floor
    present = [handle for handle in _BACK if parts.leads[handle] >= 0] or [0]
    back = heads[:, present, 1].mean(axis=1)
    return {
        "degrees": float(angles.mean()),
        "degrees_hind": float(angles[:, [0, 2]].mean()),
        "degrees_front": float(angles[:, [1, 3]].mean()),
        "ground": float(np.abs(lowest).mean() / result.character.height),
        "above_back": float((heads[:, _HIND, 1].max(axis=1) > back).mean()),
    }
