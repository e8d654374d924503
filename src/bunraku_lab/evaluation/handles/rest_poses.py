"""The same humanoid in other rest poses, and how much the rest pose shows in its animation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.animation import Animation
from bunraku.core.body.layout import HANDLE_NAMES, JOINT_COUNT, JOINT_NAMES
from bunraku.core.body.reference import handle_positions, reference_body
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.rotations import matrix_from_axis_angle, rotation_between
from bunraku.core.geometry.surface import vertex_areas
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.core.skinning import skin
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.to_reference import handle_motion_of_body
from bunraku_lab.datasets.characters.training_character import TrainingCharacter, forward_kinematics
from bunraku_lab.evaluation.handles.subjects import Subject

__all__ = [
    "REST_POSES", "TRANSFER_POSES", "code_made_motions", "limb_directions", "posed_limbs", "rest_pose_transfer",
    "true_handles",
]  # fmt: skip

REST_POSES = ("T", "A", "arms down", "sitting")
_ARM_DROP = {
    "T": 0.0,
    "A": 45.0,
    "arms down": 80.0,
    "sitting": 45.0,
    "crouching": 60.0,
}  # below the horizontal [degrees]
_LEG_DIRECTIONS = {
    "sitting": ((0.0, 0, 1), (0.0, -1, 0)),
    "crouching": ((0.0, -0.3, 0.95), (0.0, -0.8, -0.6)),
}  # thighs and shins that do not stand
_CHAINS = (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))


def limb_directions(pose: str) -> dict[str, np.ndarray]:
    """Where the upper arms, forearms, thighs and shins of a pose point, by the handle of their bones, shape (3,) each.

    Args:
        pose: One of `REST_POSES` or "crouching". Arms are in the frontal plane: level (T), 45 degrees below (A and
            sitting), 60 (crouching) or 80 (arms down). Legs hang straight down, but the thighs of one who sits or
            crouches point forward.
    """
    drop = np.radians(_ARM_DROP[pose])
    out = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        out[f"{side}_shoulder"] = out[f"{side}_elbow"] = np.array([sign * np.cos(drop), -np.sin(drop), 0])
        out[f"{side}_hip"], out[f"{side}_knee"] = (
            np.array(leg) for leg in _LEG_DIRECTIONS.get(pose, ((0.0, -1, 0), (0.0, -1, 0)))
        )
    return out


def _first(truth: TrainingCharacter, handle: str, mass: np.ndarray, under: int = -1) -> int:
    """The joint at which a limb's part begins: the heaviest whose parent is of another part, or -1."""
    index = HANDLE_NAMES.index(handle)
    found = [
        j
        for j in np.flatnonzero(truth.handles == index)
        if truth.parents[j] < 0 or truth.handles[truth.parents[j]] != index
    ]
    if under >= 0:
        found = [j for j in found if under in _above(truth.parents, int(j))]
    return int(max(found, key=lambda j: (mass[j], -j))) if found else -1


def _above(parents: np.ndarray, joint: int) -> list[int]:
    out: list[int] = []
    joint = int(parents[joint])
    while joint >= 0 and joint not in out:
        out.append(joint)
        joint = int(parents[joint])
    return out


def posed_limbs(truth: TrainingCharacter, pose: str) -> np.ndarray:
    """Vertices of a humanoid whose limbs point where `limb_directions` says [m], shape (V, 3), float32.

    Each joint takes the smallest turn that does it; hands and feet follow. The legs keep their stance where the pose
    stands: only their lean forward and back is taken away.

    Args:
        truth: The rig on the character's vertices.
        pose: One of `REST_POSES` or "crouching".
    """
    directions = limb_directions(pose)
    mass = truth.weights.sum(axis=0)
    rotations = np.tile(np.eye(3), (len(truth.joints), 1, 1))
    for chain in _CHAINS:
        for side in ("left", "right"):
            begin = [_first(truth, f"{side}_{chain[0]}", mass)]
            for part in chain[1:]:
                begin.append(_first(truth, f"{side}_{part}", mass, begin[-1]) if begin[-1] >= 0 else -1)
            for joint, child, part in zip(begin, begin[1:], chain, strict=False):
                if joint < 0 or child < 0:
                    break
                bone = truth.joints[child] - truth.joints[joint]
                if np.linalg.norm(bone) < 1e-6 * truth.height:
                    break
                target = directions[f"{side}_{part}"]
                if chain[0] == "hip" and pose not in _LEG_DIRECTIONS:
                    target = np.array([bone[0], bone[1], 0.0]) if bone[1] < -abs(bone[0]) else target
                world = np.eye(3)
                for above in reversed(_above(truth.parents, joint)):
                    world = world @ rotations[above]
                rotations[joint] = world.T @ rotation_between(world @ bone, target) @ world
    transforms = forward_kinematics(truth.joints, truth.parents, rotations)
    return np.ascontiguousarray(skin(truth.vertices, truth.weights, transforms[None])[0])


TRANSFER_POSES = ("A", "arms down", "sitting", "crouching")
"""The rest poses that are compared with the T-pose."""
FRAMES = 24  # of each motion, evenly spaced
RATE = 20.0

_LEGS = [i for i, name in enumerate(HANDLE_NAMES) if name.endswith(("hip", "knee", "ankle", "foot"))]

Predict = Callable[[Character], Handles]


def true_handles(one: Subject, vertices: np.ndarray) -> Handles:
    """Handles by the names of a subject's bones, for its vertices in any pose [m], shape (V, 3)."""
    weights = one.truth.target.astype(np.float32).copy()
    weights[:, 0] += np.maximum(1 - weights.sum(axis=1), 0)
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
    return Handles(handle_positions(vertices, weights, vertex_areas(vertices, one.character.faces)), weights)


def rest_pose_transfer(
    subjects: Iterable[Subject], motions: Mapping[str, HandleMotion], predict: Predict | None = None,
    stages: Stages | None = None,
) -> dict[str, float]:  # fmt: skip
    """Mean distance between a character animated from a rest pose and from its T-pose, over its height, by pose and as
    "mean"; "in place" without each frame's position on the floor, and "ground" of the lowest vertex.

    Args:
        subjects: Rigged humanoids.
        motions: Motions of the reference body by name.
        predict: Handles of a character in a rest pose; None takes those of its bones' names, the same in every pose.
        stages: Which stages fit the motions; None takes all.
    """
    rows: dict[str, list[float]] = {}
    for one in subjects:
        wanted = _animated(one, "T", motions, predict, stages)
        for pose in TRANSFER_POSES:
            for got, want in zip(_animated(one, pose, motions, predict, stages), wanted, strict=True):
                away, drift = got - want, (got - want).mean(axis=1, keepdims=True) * [1, 0, 1]
                low = np.abs(got[..., 1].min(axis=1) - want[..., 1].min(axis=1)).mean()
                far, shape = (np.linalg.norm(part, axis=-1).mean() for part in (away, away - drift))
                for key, value in ((pose, far), ("mean", far), ("in place", shape), ("ground", low)):
                    rows.setdefault(key, []).append(float(value) / one.height)
    return {key: float(np.mean(values)) for key, values in rows.items()}


def _animated(
    one: Subject, pose: str, motions: Mapping[str, HandleMotion], predict: Predict | None, stages: Stages | None
) -> list[np.ndarray]:
    """Surface vertices of each motion, shape (N, V, 3): floor at 0, the first frame's mean over the origin."""
    vertices = posed_limbs(one.truth, pose)
    character = Character(one.name, vertices, one.character.faces)
    handles = predict(character) if predict is not None else true_handles(one, vertices)
    legs = one.surface & (one.truth.target[:, _LEGS].sum(axis=1) > 0.5)  # a weapon in a hand may hang lower
    floor = float(vertices[legs if legs.any() else one.surface, 1].min())
    anatomy, out = Anatomy.of(character, handles), []
    for motion in motions.values():
        frames = np.unique(np.linspace(0, len(motion) - 1, FRAMES).astype(int))
        fitted = fit_motion(motion, anatomy, stages)
        moved = Animation(character, handles, fitted).vertices(frames)[:, one.surface]
        out.append(moved - [moved[0, :, 0].mean(), floor, moved[0, :, 2].mean()])
    return out


def code_made_motions(seconds: float = 2.0) -> dict[str, HandleMotion]:
    """Motions of the reference body that need no data: a walk on the spot, a wave, a squat, a jumping jack."""
    t = np.arange(int(seconds * RATE)) / RATE
    beat = np.sin(2 * np.pi * t)
    up = 0.5 - 0.5 * np.cos(2 * np.pi * t)
    sides = {"left": 1.0, "right": -1.0}

    def motion(joints: Mapping[str, tuple[str, np.ndarray | float]]) -> HandleMotion:
        body = reference_body()
        rotations = np.zeros((len(t), JOINT_COUNT, 3))
        for name, (axis, degrees) in joints.items():
            rotations[:, JOINT_NAMES.index(name), "xyz".index(axis)] = np.radians(degrees)
        root = np.tile(body.joints[0], (len(t), 1))
        posed = SkeletalMotion(body.skeleton, matrix_from_axis_angle(rotations), root, RATE)
        root[:, 1] -= body.pose(posed)[..., 1].min(axis=1)  # the lower foot stands
        return handle_motion_of_body(SkeletalMotion(body.skeleton, posed.rotations, root, RATE))

    jack: dict[str, tuple[str, np.ndarray | float]] = {}
    hang: dict[str, tuple[str, np.ndarray | float]] = {
        f"{side}_shoulder": ("z", -70 * sign) for side, sign in sides.items()
    }
    walk, squat = dict(hang), dict(hang)
    for side, sign in sides.items():
        walk |= {
            f"{side}_hip": ("x", -25 * sign * beat),
            f"{side}_knee": ("x", 20 - 20 * sign * np.cos(2 * np.pi * t)),
            f"{side}_elbow": ("y", -25 * sign),
        }
        squat |= {
            f"{side}_hip": ("x", -80 * up),
            f"{side}_knee": ("x", 110 * up),
            f"{side}_ankle": ("x", -30 * up),
            f"{side}_elbow": ("y", -60 * sign * up),
        }
        jack |= {f"{side}_shoulder": ("z", sign * (-70 + 130 * up)), f"{side}_hip": ("z", sign * 20 * up)}
    wave = dict(hang) | {
        "right_shoulder": ("z", -30.0),
        "right_elbow": ("z", -60 - 25 * beat),
        "head": ("y", 15 * beat),
        "spine2": ("z", 5 * beat),
    }
    return {
        "walk": motion(walk), "wave": motion(wave), "squat": motion(squat | {"spine1": ("x", 25 * up)}),
        "jumping jack": motion(jack),
    }  # fmt: skip
