"""Motions of any skeleton as motions of SMPL's 22 joints, relative to the reference body's T-pose.

Rest poses are reconciled by one constant rotation a joint: `W_smpl = W C`, where W is the joint's world rotation in the
file and C turns the reference's T-pose into the file's rest pose. Where that is a body's pose (T, A, arms down, any
heading), C is read off the rest pose itself. Where all bones lie along one axis, as in conversions of AMC, the rest
pose says nothing: C then takes each bone's own axis to the reference's direction, and rolls it so that over the clip
elbows and knees bend the way they can, and other parts are twisted against their parents as little as can be. A clip
that begins in a T-pose, as captures do, needs neither, whatever the rest pose is. Bones keep their own lengths, so
joints stay where they were.
"""

from __future__ import annotations

import numpy as np

from bunraku.anatomy.names.skeleton_map import SkeletonMap, map_skeleton
from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.body.reference import LIMB_CHILD, leg_length, reference_body
from bunraku.core.geometry.rotations import (
    matrix_from_axis_angle,
    nearest_rotation,
    quaternion_from_matrix,
    rotation_between,
)
from bunraku.core.motion import SkeletalMotion, Skeleton, local_rotations

_J = {name: index for index, name in enumerate(JOINT_NAMES)}
_CHILD = LIMB_CHILD | {3: 6, 6: 9, 9: 12, 12: 15, 7: 10, 8: 11, 13: 16, 14: 17}  # where a part points
_UPRIGHT = np.cos(np.radians(35))  # a rest pose this near to upright is upright
_AHEAD = np.cos(np.radians(12))  # a body that faces +Z as nearly as this faces +Z
_BENDS = 0.15  # mean sine of the bend of an elbow or a knee from which on it says how the limb is rolled
T_POSE = 15.0  # a frame whose limbs are this near to a T-pose's is one [degrees]; chosen by eye
_TURNED_FOOT = np.cos(np.radians(50))  # a foot that points farther off than this rests in another pose


def to_smpl(motion: SkeletalMotion, skeleton_map: SkeletonMap | None = None) -> SkeletalMotion:
    """The motion of SMPL's 22 joints that moves like another skeleton. MotionError if no pelvis and legs are found.

    Args:
        motion: Of any skeleton, +Y up [m].
        skeleton_map: Which of its joints are which; `map_skeleton` finds out by default.

    Returns:
        The same frames: local rotations that are identities in the reference body's T-pose, and a skeleton in that pose
        with the source's bone lengths. Joints that the source lacks stay straight.
    """
    mapped = skeleton_map or map_skeleton(motion.skeleton)
    world, positions = motion.world()
    rest = motion.skeleton.positions.astype(float)
    by_rest = rest_is_a_pose(motion.skeleton, mapped)
    rotations = rotations_of_rest(mapped, rest) if by_rest else _rotations_of_motion(mapped, world, positions)
    start = rotations_of_rest(mapped, positions[0].astype(float))
    if _off_t_pose(start) < T_POSE and not (by_rest and _off_t_pose(rotations) < T_POSE):
        there = [joint for joint in range(JOINT_COUNT) if mapped.joints[joint] >= 0]
        turned = world[0, [mapped.joints[joint] for joint in there]].astype(float)
        rotations[there] = np.swapaxes(turned, -1, -2) @ start[there]
    out = np.empty((len(motion), JOINT_COUNT, 3, 3))
    for joint, parent in enumerate(JOINT_PARENTS):
        source = mapped.joints[joint]
        out[:, joint] = world[:, source] @ rotations[joint] if source >= 0 else out[:, parent]
    offsets = _offsets(mapped, out, positions)
    parents = np.array(JOINT_PARENTS)
    skeleton = Skeleton(JOINT_NAMES, parents, offsets)
    return SkeletalMotion(skeleton, local_rotations(out, parents), positions[:, mapped.joints[0]], motion.fps)


def _off_t_pose(rotations: np.ndarray) -> float:
    """The largest angle of a limb from where it is in a T-pose [degrees], by C of each joint, shape (22, 3, 3)."""
    turns = rotations[0].T @ rotations[list(LIMB_CHILD)]
    return float(np.degrees(np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1))).max())


def rest_is_a_pose(skeleton: Skeleton, skeleton_map: SkeletonMap) -> bool:
    """Whether a body can take the rest pose: legs down from the trunk, and not all bones along an axis."""
    positions = skeleton.positions.astype(float)
    up, across = _up(skeleton_map, positions), _across(skeleton_map, positions, ("hip",))
    knees, hips = ([skeleton_map.of(f"{side}_{part}") for side in ("left", "right")] for part in ("knee", "hip"))
    legs = np.mean(positions[knees] - positions[hips], axis=0)
    scale = max(float(np.linalg.norm(up)) * float(np.linalg.norm(legs)), 1e-12)
    wide = np.linalg.norm(across) > 1e-6 and abs(across @ up) < 0.7 * np.linalg.norm(across) * np.linalg.norm(up)
    return bool(up @ legs < -0.3 * scale and wide)


def _up(found: SkeletonMap, positions: np.ndarray) -> np.ndarray:
    """From between the hips to the neck, or to the highest part of the trunk that there is."""
    tops = [found.of(name) for name in ("neck", "head", "spine3", "spine2", "spine1")]
    top = next((joint for joint in tops if joint >= 0), found.joints[0])
    return np.asarray(positions[top] - (positions[found.of("left_hip")] + positions[found.of("right_hip")]) / 2)


def _across(found: SkeletonMap, positions: np.ndarray, parts: tuple[str, ...] = ("hip", "shoulder")) -> np.ndarray:
    """From right to left."""
    pairs = [(found.of(f"left_{part}"), found.of(f"right_{part}")) for part in parts]
    return np.asarray(sum((positions[a] - positions[b] for a, b in pairs if min(a, b) >= 0), np.zeros(3)))


def _axes(across: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Columns: left, up, forward."""
    forward = np.cross(across, up)
    axes = [across, np.cross(forward, across), forward]
    return np.stack([axis / max(float(np.linalg.norm(axis)), 1e-12) for axis in axes], -1)


def rotations_of_rest(found: SkeletonMap, positions: np.ndarray) -> np.ndarray:
    """C of each joint from the rest pose, shape (22, 3, 3).

    Args:
        found: Which joints are which.
        positions: Positions of all joints in the rest pose [m], shape (J, 3).
    """
    known = reference_body()
    offsets = known.skeleton.offsets.astype(float)
    up, across = _up(found, positions), _across(found, positions)
    if up[1] > _UPRIGHT * np.linalg.norm(up):
        body = _axes(across * [1, 0, 1], np.array([0.0, 1, 0]))  # the slope of the spine is the body's build
        if body[0, 0] > _AHEAD:
            body = np.eye(3)  # one hip a little before the other is build too
    else:
        identity = SkeletonMap(tuple(range(JOINT_COUNT)), ("",) * JOINT_COUNT)
        body = _axes(across, up) @ _axes(_across(identity, known.joints), _up(identity, known.joints)).T
    out = np.tile(body, (JOINT_COUNT, 1, 1))
    for joint, child in LIMB_CHILD.items():
        above = out[JOINT_PARENTS[joint]]
        out[joint] = above
        if found.joints[joint] >= 0 and found.joints[child] >= 0:
            bone = positions[found.joints[child]] - positions[found.joints[joint]]
            out[joint] = rotation_between(above @ offsets[child], bone) @ above
    for side in ("left", "right"):
        out[_J[f"{side}_wrist"]] = out[_J[f"{side}_elbow"]]
        ankle, foot = _J[f"{side}_ankle"], _J[f"{side}_foot"]
        if min(found.joints[ankle], found.joints[foot]) >= 0:
            bone = positions[found.joints[foot]] - positions[found.joints[ankle]]
            out[[ankle, foot]] = _foot(bone, body, offsets[foot])
    return out


def _foot(bone: np.ndarray, body: np.ndarray, want: np.ndarray) -> np.ndarray:
    """C of a foot: turned sideways as it is at rest, flat as it stands; whole where it does not stand."""
    plain = body @ want
    if bone @ plain < _TURNED_FOOT * np.linalg.norm(bone) * np.linalg.norm(plain):
        return rotation_between(plain, bone) @ body
    up = body[:, 1]
    return rotation_between(plain - up * (up @ plain), bone - up * (up @ bone)) @ body


def _rotations_of_motion(found: SkeletonMap, world: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """C of each joint from the whole clip, shape (22, 3, 3)."""
    body = reference_body()
    identity = SkeletonMap(tuple(range(JOINT_COUNT)), ("",) * JOINT_COUNT)
    step = max(len(world) // 2000, 1)
    world, positions = world[::step].astype(float), positions[::step].astype(float)
    out = np.tile(np.eye(3), (JOINT_COUNT, 1, 1))
    turned_to = np.empty((len(world), JOINT_COUNT, 3, 3))  # calibrated world rotations
    for joint, parent in enumerate(JOINT_PARENTS):
        source = found.joints[joint]
        if source < 0:
            turned_to[:, joint] = turned_to[:, parent]
            continue

        def local(points: np.ndarray, source: int = source) -> np.ndarray:
            return np.asarray(np.einsum("nji,nj->ni", world[:, source], points).mean(axis=0))

        child = _CHILD.get(joint, -1)
        if joint in (0, _J["spine3"]):
            parts = ("hip",) if joint == 0 else ("collar", "shoulder")
            tops = (_J["neck"], _J["head"], 9, 6, 3)
            top = next((some for some in tops if found.joints[some] >= 0 and some > joint), -1)
            across = local(np.stack([_across(found, points, parts) for points in positions]))
            hips = (positions[:, found.of("left_hip")] + positions[:, found.of("right_hip")]) / 2
            base = positions[:, source] if joint else hips
            low = body.joints[joint] if joint else (body.joints[1] + body.joints[2]) / 2
            up = local(positions[:, found.joints[top]] - base) if top >= 0 else np.zeros(3)
            if np.linalg.norm(np.cross(across, up)) > 1e-9:
                theirs = _axes(_across(identity, body.joints, parts), body.joints[top] - low)
                out[joint] = _axes(across, up) @ theirs.T
        elif child >= 0 and found.joints[child] >= 0:
            want = body.skeleton.offsets[child].astype(float)
            bone = local(positions[:, found.joints[child]] - positions[:, source])
            plain = rotation_between(want, bone)
            turned = world[:, source] @ plain
            out[joint] = plain @ _untwisted(np.swapaxes(turned_to[:, parent], -1, -2) @ turned, want)
            lower = LIMB_CHILD.get(child, -1)
            if joint in LIMB_CHILD and lower >= 0 and found.joints[lower] >= 0:
                next_bone = positions[:, found.joints[lower]] - positions[:, found.joints[child]]
                bent = np.einsum("nji,nj->ni", turned, next_bone)
                hinge = _hinged(bent, want, 1 if joint in (_J["left_shoulder"], _J["right_shoulder"]) else -1)
                out[joint] = out[joint] if hinge is None else plain @ hinge
        else:  # straight on its parent, in the mean
            out[joint] = nearest_rotation((np.swapaxes(world[:, source], -1, -2) @ turned_to[:, parent]).mean(axis=0))
        turned_to[:, joint] = world[:, source] @ out[joint]
    return out


def _untwisted(relative: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The roll about an axis that makes the mean twist of rotations (N, 3, 3) about it zero, shape (3, 3)."""
    axis = axis / max(float(np.linalg.norm(axis)), 1e-12)
    quaternion = quaternion_from_matrix(relative)
    about, w = quaternion[:, :3] @ axis, quaternion[:, 3]
    twist = np.arctan2((2 * w * about).sum(), (w * w - about * about).sum())
    return np.asarray(matrix_from_axis_angle(-twist * axis))


def _hinged(bent: np.ndarray, axis: np.ndarray, direction: int) -> np.ndarray | None:
    """The roll of a limb that points along an axis (3,) and makes the next one, which points along `bent` (N, 3), bend
    forward (1) or backward (-1) in the mean, shape (3, 3); None where it hardly bends.
    """
    axis = axis / max(float(np.linalg.norm(axis)), 1e-12)
    square = np.array([0.0, 0, direction]) - axis * (axis[2] * direction)
    bent = bent / np.maximum(np.linalg.norm(bent, axis=-1, keepdims=True), 1e-12)
    pair = (bent @ square).mean(), (bent @ np.cross(axis, square)).mean()
    return np.asarray(matrix_from_axis_angle(np.arctan2(pair[1], pair[0]) * axis)) if np.hypot(*pair) > _BENDS else None


def _offsets(found: SkeletonMap, world: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Rest offsets with the source's lengths, shape (22, 3); bones to joints that the source lacks share the way by the
    reference's.
    """
    body = reference_body()
    lengths = np.linalg.norm(body.skeleton.offsets, axis=-1)
    out = np.zeros((JOINT_COUNT, 3))
    placed = [joint == 0 for joint in range(JOINT_COUNT)]
    for joint in range(1, JOINT_COUNT):
        if found.joints[joint] < 0:
            continue
        line = [joint]
        while found.joints[JOINT_PARENTS[line[-1]]] < 0:
            line.append(JOINT_PARENTS[line[-1]])
        above = JOINT_PARENTS[line[-1]]
        direction = positions[:, found.joints[joint]] - positions[:, found.joints[above]]
        direction = np.einsum("nji,nj->ni", world[:, above], direction).mean(axis=0)
        todo = [some for some in line if not placed[some]]
        direction = direction - sum((out[some] for some in line if placed[some]), np.zeros(3))
        for some in todo:
            out[some] = direction * lengths[some] / max(float(lengths[todo].sum()), 1e-9)
            placed[some] = True
    plain = Skeleton(JOINT_NAMES, np.array(JOINT_PARENTS), out)
    legs = all(placed[some] for some in (4, 5, 7, 8))
    scale = leg_length(plain.positions) / leg_length(body.joints) if legs else 1.0
    for joint in range(1, JOINT_COUNT):
        if not placed[joint]:
            out[joint] = body.skeleton.offsets[joint] * scale
    return out
