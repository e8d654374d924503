"""Rest poses reconciled: limbs, also of rigid blocks, rotated from where they rest to where the reference body's do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.anatomy.handles.blocks import away_from, joint_parents
from bunraku.anatomy.handles.limbs import has_extra_legs
from bunraku.anatomy.joints import Joints, estimated_reference_joints, reference_joints, refined_joints
from bunraku.core.body.layout import HANDLE_NAMES
from bunraku.core.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle, rotation_between
from bunraku.core.geometry.surface import surface_points
from bunraku.core.skinning import skin

_LIMB_ENDS = {"shoulder": "elbow", "elbow": "wrist", "hip": "knee", "knee": "ankle"}
_FOLLOWERS = {f"{side}_{part}": f"{side}_elbow" for side in ("left", "right") for part in ("wrist", "fingers")}
_BUILT_BENT = ([30, 45, 70, 80], [1, 0, 0, 1])  # how far a bent leg is straightened, by its angle [degrees]
_KNEE = ([20, 40], [0, 1])  # how far the parts of a leg turn on their own, by the bend of the knee [degrees]
_ELBOW = ([30, 60], [0, 1])  # the same of an arm, by the bend of the elbow; short upper arms are found less exactly
_SITS, _CROUCHES = ([55, 65], [0, 1]), ([30, 40], [0, 1])
"""How far a thigh takes its shin with it, by its angle [degrees]; without arms and with them."""
WIDE = 30.0  # legs that point farther outwards are turned down [degrees]
# Chosen by eye on the archive's llamas and other animals whose front legs are arms here.
ALL_FOURS = 0.5  # arms that end lower than this share of the hips' height over the legs' ends stand, as front legs do
SHORTEST = 0.02  # limbs shorter than this share of the height have no direction that could be corrected


_Limb = tuple[np.ndarray, np.ndarray]  # where it points and where the reference body's does, shape (3,) each


def rest_rotations(
    handles: Handles, joints: Joints, reference: Handles, reference_joints: Joints, height: float
) -> np.ndarray:
    """Rotation of each handle that turns the character's rest direction of a limb into the reference body's, shape (K,
    3, 3).

    Arms, and the front legs of animals, are turned wholly: a forearm goes along with its upper arm and is then
    straightened, and hands follow their forearms; an arm whose elbow is hardly bent is turned as one. Legs of upright
    characters keep their stance, but do not sit or crouch (see `_leg_rotations`); hind legs of animals are left as they
    are. Everything else keeps the identity.
    """
    out = np.tile(np.eye(3), (len(handles.positions), 1, 1))
    stands = upright(handles)
    arms = [i for i, name in enumerate(HANDLE_NAMES) if name.endswith(("shoulder", "elbow"))]
    armed = bool(joints.present[arms].all())

    def direction(part: str, side: str) -> _Limb | None:
        """Of a limb; None where it is absent or too short."""
        handle, child = HANDLE_NAMES.index(f"{side}_{part}"), HANDLE_NAMES.index(f"{side}_{_LIMB_ENDS[part]}")
        if not joints.present[handle]:
            return None
        bodies = (joints, handles), (reference_joints, reference)
        own, want = [
            (joint.positions[child] if joints.present[child] else body.positions[handle]) - joint.positions[handle]
            for joint, body in bodies
        ]
        return None if np.linalg.norm(own) < SHORTEST * height else (own, want)

    for side in ("left", "right"):
        above, arm = np.eye(3), _arm(joints, reference_joints, side)
        for part in ("shoulder", "elbow"):
            limb = direction(part, side)
            if limb is not None and arm is not None:
                limb = _as_one(limb, *arm)
            if limb is not None:
                above = rotation_between(above @ limb[0], limb[1]) @ above
            elif part == "elbow" and joints.present[HANDLE_NAMES.index(f"{side}_{part}")]:
                above = np.eye(3)
            out[HANDLE_NAMES.index(f"{side}_{part}")] = above
        if stands:
            hip, knee, ankle = (HANDLE_NAMES.index(f"{side}_{part}") for part in ("hip", "knee", "ankle"))
            thigh, leg = direction("hip", side), None
            ours, theirs = joints.positions, reference_joints.positions
            if thigh is not None and joints.present[knee]:  # deep in the body, a hip is less sure than a thigh's middle
                thigh = ours[knee] - handles.positions[hip], theirs[knee] - reference.positions[hip]
            if joints.present[[hip, ankle]].all():
                leg = ours[ankle] - ours[hip], theirs[ankle] - theirs[hip]
            out[[hip, knee]] = _leg_rotations(thigh, direction("knee", side), leg, armed)
    for name, lead in _FOLLOWERS.items():
        out[HANDLE_NAMES.index(name)] = out[HANDLE_NAMES.index(lead)]
    return out


def _arm(joints: Joints, reference_joints: Joints, side: str) -> tuple[_Limb, float] | None:
    """An arm, from shoulder to wrist, and how much of it turns in two parts, 0 to 1; None where a joint is absent."""
    first, middle, last = (HANDLE_NAMES.index(f"{side}_{part}") for part in ("shoulder", "elbow", "wrist"))
    if not joints.present[[first, middle, last]].all():
        return None
    ours, want = (joints_of.positions[last] - joints_of.positions[first] for joints_of in (joints, reference_joints))
    upper, lower = joints.positions[middle] - joints.positions[first], joints.positions[last] - joints.positions[middle]
    sizes = np.linalg.norm(upper) * np.linalg.norm(lower)
    bend = np.degrees(np.arccos(np.clip(upper @ lower / max(sizes, 1e-12), -1, 1)))
    return (ours, want), float(np.interp(bend, *_ELBOW))


def _as_one(limb: _Limb, arm: _Limb, bent: float) -> _Limb:
    """A part of an arm, pointing where the whole arm points as far as that is not bent."""
    lengths = [np.linalg.norm(bone) for bone in limb]
    ours, want = (
        (bent * part / np.linalg.norm(part) + (1 - bent) * joint / np.linalg.norm(joint))
        for part, joint in zip(limb, arm, strict=True)
    )
    return ours * lengths[0], want * lengths[1]


def upright(handles: Handles) -> bool:
    """Whether the head is over the hips rather than before them: never of a body with further limbs, nor of one that
    carries the head high on a level trunk over four legs, as a llama does.
    """
    if has_extra_legs(handles):
        return False
    spine = handles.positions[HANDLE_NAMES.index("head")] - handles.positions[0]
    return bool(spine[1] > abs(spine[2])) and not _on_all_fours(handles)


def _on_all_fours(handles: Handles) -> bool:
    """Whether the arms lie before the legs rather than over them, and end about as low."""
    positions = {
        part: np.mean([handles.positions[HANDLE_NAMES.index(f"{side}_{part}")] for side in ("left", "right")], axis=0)
        for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    }
    trunk = positions["shoulder"] - positions["hip"]
    arms, legs = (min(positions[part][1] for part in limb) for limb in (("elbow", "wrist"), ("knee", "ankle")))
    return bool(trunk[2] > abs(trunk[1]) and arms - legs < ALL_FOURS * (handles.positions[0, 1] - legs))


def _leg_rotations(thigh: _Limb | None, shin: _Limb | None, leg: _Limb | None, armed: bool) -> np.ndarray:
    """Rotations of a thigh and a shin, shape (2, 3, 3), from where each and the whole leg point and where the reference
    body's do.

    Standing wide is style and stays: legs turn about the axis from left to right. A body with arms stands on straight
    thighs, so bent ones idle, sit or crouch and are straightened, with their shins. Without arms legs may be built
    bent, as those of birds are, so what is bent by more than an idle pose and less than sitting stays. A leg whose knee
    is hardly bent turns as one, because estimates of single joints are not exact enough to bend a knee by.
    """
    out = np.tile(np.eye(3), (2, 1, 1))
    for number, limb in enumerate((thigh, shin)):
        if limb is not None and np.degrees(np.arctan2(abs(limb[0][0]), np.hypot(limb[0][1], limb[0][2]))) > WIDE:
            out[number] = rotation_between(*limb)
            if number == 0:
                return np.stack([out[0], out[0] if shin is None else rotation_between(*shin)])
    forward = _forward(leg)
    upper, lower = (forward if limb is None else _forward(limb) for limb in (thigh, shin))
    bent = float(np.interp(np.degrees(abs(upper - lower)), *_KNEE)) if leg is not None else 1.0
    upper, lower = bent * upper + (1 - bent) * forward, bent * lower + (1 - bent) * forward
    first, second = (float(np.interp(np.degrees(abs(angle)), *_BUILT_BENT)) for angle in (upper, lower))
    sits = float(np.interp(np.degrees(abs(upper)), *(_CROUCHES if armed else _SITS)))
    first = 1.0 if armed else max(first, sits)
    if thigh is not None:
        out[0] = matrix_from_axis_angle(np.array([first * upper, 0, 0]))
    if shin is None:
        out[1] = out[0]
    elif np.allclose(out[1], np.eye(3)):
        out[1] = matrix_from_axis_angle(np.array([max(second, sits) * lower, 0, 0]))
    return out


def _forward(limb: _Limb | None) -> float:
    """How much farther forward a leg points than the reference body's [rad], from -pi to pi; 0 for none."""
    if limb is None:
        return 0.0
    ours, want = limb
    forward = np.arctan2(ours[2], -ours[1]) - np.arctan2(want[2], -want[1])
    return float((forward + np.pi) % (2 * np.pi) - np.pi)


PASSES = 2  # rotations need joints and joints need rotations; both converge at once

# Chosen with the rest poses of twelve humanoids in view, on which these repairs were measured.
SOLE = 0.08  # largest distance to the lowest point of what stands on the ground, over the foot's length
FLATTER = 1.2  # how much more of a foot must stand before the foot is turned


def rest_of_limbs(character: Character, handles: Handles, found: Joints) -> tuple[np.ndarray, Joints]:
    """How the rest pose of a body with one limb of each kind differs from the reference body's.

    Args:
        character: In its rest pose.
        handles: Its handles, which all play their own parts.
        found: Its joints as the weights imply them (`find_joints`).

    Returns:
        The rotation of each handle that makes up for it (see `rest_rotations`), shape (K, 3, 3), and the joints in the
        rest pose.
    """
    reference = reference_body().handles
    rotations = rest_rotations(handles, found, reference, estimated_reference_joints(), character.height)
    for _ in range(PASSES):
        joints = refined_joints(character, handles, found, rotations)
        rotations = rest_rotations(handles, joints, reference, reference_joints(), character.height)
    rotations = flat_feet(character, handles, rotations)
    return rotations, refined_joints(character, handles, found, rotations)


def stance_of(
    character: Character, handles: Handles, transforms: np.ndarray, translations: np.ndarray
) -> tuple[Character, Handles]:
    """The character in another pose, and its handles as they are there.

    Args:
        character: In its rest pose.
        handles: Its handles.
        transforms: From the rest pose into the other, shape (K, 3, 4).
        translations: How far each handle is moved [m], shape (K, 3).
    """
    vertices = skin(character.vertices, handles.weights, transforms[None])[0]
    posed = replace(character, vertices=vertices, rig=None, source=None, avatar=None)
    if handles.rigid:
        positions = (handles.positions + translations).astype(np.float32)
    else:
        positions = handle_positions(vertices, handles.weights, posed.areas)
    return posed, Handles(positions, handles.weights, roles=handles.roles, rigid=handles.rigid)


def flat_feet(character: Character, handles: Handles, rotations: np.ndarray) -> np.ndarray:
    """The rotations with feet that go along with their shins where that, and not their rest pose, makes them stand
    flat, shape (K, 3, 3): so they do where a body crouches on its toes, but not where it sits.
    """
    out = rotations.copy()
    areas = character.areas
    for side in ("left", "right"):
        foot = [HANDLE_NAMES.index(f"{side}_{part}") for part in ("ankle", "foot")]
        shin = rotations[HANDLE_NAMES.index(f"{side}_knee")]
        members = character.surface & (handles.weights[:, foot].sum(axis=1) > 0.5)
        if members.sum() < 4 or np.allclose(shin, np.eye(3)):
            continue
        points = character.vertices[members].astype(np.float64)
        if _standing_area(points @ shin.T, areas[members]) > FLATTER * _standing_area(points, areas[members]):
            out[foot] = shin
    return out


def _standing_area(points: np.ndarray, areas: np.ndarray) -> float:
    heights = points[:, 1] - points[:, 1].min()
    return float(areas[heights < SOLE * np.ptp(points, axis=0).max()].sum())


STANDS = 35.0  # legs that point no farther from straight down stand as they are [degrees]
POINTS = 2000  # spread over a limb to see where it points

WHOLE_LIMBS = tuple(
    tuple(HANDLE_NAMES.index(f"{side}_{part}") for part in limb)
    for side in ("left", "right")
    for limb in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))
)
"""The handles of each arm and leg, from the body to the wrist or ankle."""


def block_joints(handles: Handles) -> Joints:
    """Where the blocks of rigid handles meet: where the handles stand."""
    blocks = np.asarray(handles.weights.any(axis=0))
    present = blocks.copy()
    present[0] = True
    return Joints(handles.positions.astype(np.float64), joint_parents(blocks), present)


def pieces(limb: tuple[int, ...], joints: Joints) -> list[tuple[int, int]]:
    """The pieces of an arm or a leg: the handle of each and where it ends, the next one present, or wrist or ankle."""
    there = [handle for handle in limb if joints.present[handle]]
    if not there:
        return []
    ends = [*there[1:], limb[-1]]
    return [(handle, end) for handle, end in zip(there, ends, strict=True) if handle != limb[-1]]


def block_rest(character: Character, handles: Handles) -> tuple[np.ndarray, Joints]:
    """How the rest pose of rigid blocks differs from the reference body's.

    Arms, and the front legs of animals, are turned wholly, as those of bodies that bend are; the legs of an upright
    body where they do not stand.

    Args:
        character: In its rest pose.
        handles: Its rigid handles.

    Returns:
        The turn of each handle, shape (K, 3, 3), and the joints.
    """
    joints, reference = block_joints(handles), reference_joints().positions
    out = np.tile(np.eye(3), (len(handles.positions), 1, 1))
    held, stands = handles.weights.argmax(axis=1), upright(handles)
    for limb in WHOLE_LIMBS:
        leg = HANDLE_NAMES[limb[0]].endswith("hip")
        if leg and not stands:
            continue
        above = np.eye(3)
        for handle, end in pieces(limb, joints):
            if joints.present[end] and end != handle:
                direction = joints.positions[end] - joints.positions[handle]
            else:
                faces = character.faces[held[character.faces[:, 0]] == handle]
                direction = away_from(surface_points(character.vertices, faces, POINTS)[0], joints.positions[handle])
            if leg and np.degrees(np.arctan2(np.hypot(direction[0], direction[2]), -direction[1])) < STANDS:
                continue
            above = rotation_between(above @ direction, reference[end] - reference[handle]) @ above
            out[handle] = above
        if not leg and joints.present[limb[-1]]:
            out[limb[-1]] = above
    return out, joints
