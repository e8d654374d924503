"""From the reference body to any character: the analytic adaptation of a handle motion.

The diffusion model speaks of the reference body: its proportions and its T-pose. Three named stages, each of which can be
switched off, turn its motion into one of another character.

- `rest_pose`: a limb that rests in another direction than the reference body's (arms down, A-pose, sitting, the front legs of a
  dog) is first turned into the reference's direction, so the motion means the same.
- `attach`: local translations are set so that each handle stays joined to its parent at the place where their weights meet. It
  takes the place of the learned adaptation delta (section 3.2 of TapMo) where bones are longer or shorter than the reference's.
- `ground`: the lowest point of the character is as high above the ground, in its own scale, as that of the reference body, and
  a reference body that drifts off the ground for longer than a jump lasts is set back on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d, uniform_filter1d

from bunraku.bodies.layout import HANDLE_NAMES, HANDLE_PARENTS
from bunraku.bodies.reference import reference_body
from bunraku.character import Character, Handles
from bunraku.geometry.areas import vertex_areas
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, rotation_between
from bunraku.geometry.skinning import skin
from bunraku.motion import HandleMotion

__all__ = ["Joints", "Stages", "find_joints", "fit_motion", "rest_rotations"]

PRESENT = 2e-3  # share of the surface under which a handle counts as absent and follows its parent
SAMPLE = 30000  # vertices looked at to find the lowest point


@dataclass(frozen=True)
class Stages:
    """Which stages run after sampling; all by default.

    Args:
        rest_pose: Turn limbs from the character's rest direction into the reference body's.
        attach: Keep handles joined to their parents.
        ground: Keep the character as high above the ground as the reference body.
    """

    rest_pose: bool = True
    attach: bool = True
    ground: bool = True


@dataclass(frozen=True)
class Joints:
    """Where handles meet their parents, in the rest pose.

    Args:
        positions: Joint between each handle and its parent [m], shape (K, 3); for the root the handle itself.
        parents: Nearest ancestor that is present, shape (K,); -1 for the root.
        present: Whether a handle has vertices of its own, shape (K,).
    """

    positions: np.ndarray
    parents: np.ndarray
    present: np.ndarray


def find_joints(character: Character, handles: Handles) -> Joints:
    """Joints between neighbouring handles, where both weights are large.

    The joint of k and p is the mean of the vertices weighted by area times s_k times s_p. Where the weights do not overlap
    (loose parts), it is half way between the two nearest groups of vertices.
    """
    areas = vertex_areas(character.vertices, character.faces)
    mass = handles.weights * areas[:, None]
    share = mass.sum(axis=0) / max(areas.sum(), 1e-30)
    present = share > PRESENT
    present[0] = True
    vertices = character.vertices.astype(np.float64)
    positions = handles.positions.astype(np.float64)
    parents = np.full(len(positions), -1)
    for handle in range(1, len(positions)):
        parent = HANDLE_PARENTS[handle]
        while parent > 0 and not present[parent]:
            parent = HANDLE_PARENTS[parent]
        parents[handle] = parent
        if not present[handle]:
            continue
        overlap = mass[:, handle] * handles.weights[:, parent]
        total = float(overlap.sum())
        if total > 1e-4 * float(mass[:, handle].sum()):
            positions[handle] = overlap @ vertices / total
        else:
            positions[handle] = 0.5 * (
                _nearest_group(vertices, mass[:, handle], handles.positions[parent])
                + _nearest_group(vertices, mass[:, parent], handles.positions[handle])
            )
    return Joints(positions, parents, present)


def _nearest_group(vertices: np.ndarray, mass: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Mean of the tenth of a handle's mass that is nearest to a point, shape (3,)."""
    own = np.flatnonzero(mass > 0.2 * mass.max()) if mass.max() > 0 else np.arange(0)
    if not len(own):
        return np.asarray(point, float)
    order = own[np.argsort(np.linalg.norm(vertices[own] - point, axis=1))]
    return vertices[order[: max(1, len(order) // 10)]].mean(axis=0)


# limb: child whose joint ends it, and the degrees of deviation below which its rest direction is taken for style and kept
_LIMB_ENDS = {"shoulder": ("elbow", 0.0), "elbow": ("wrist", 0.0), "hip": ("knee", 20.0), "knee": ("ankle", 20.0)}
_LIMBS = {f"{side}_{part}": (f"{side}_{end}", keep) for side in ("left", "right") for part, (end, keep) in _LIMB_ENDS.items()}
_FOLLOWERS = {f"{side}_{part}": f"{side}_elbow" for side in ("left", "right") for part in ("wrist", "fingers")}


def rest_rotations(handles: Handles, joints: Joints, reference: Handles, reference_joints: Joints, height: float) -> np.ndarray:
    """Rotation of each handle that turns the character's rest direction of a limb into the reference body's, shape (K, 3, 3).

    Arms are turned wholly; hands follow their forearms; legs keep small deviations (a wide stance is style) and are turned where
    they deviate by more than about 30 degrees (sitting, crouching). Everything else keeps the identity.
    """
    out = np.tile(np.eye(3), (len(handles.positions), 1, 1))
    for name, (child_name, keep) in _LIMBS.items():
        handle, child = HANDLE_NAMES.index(name), HANDLE_NAMES.index(child_name)
        if not joints.present[handle]:
            lead = int(joints.parents[handle])
            if name.endswith("elbow") and joints.present[lead]:
                out[handle] = out[lead]
            continue
        if joints.present[child]:
            own, want = joints.positions[child] - joints.positions[handle], reference_joints.positions[child] - reference_joints.positions[handle]
        else:
            own, want = handles.positions[handle] - joints.positions[handle], reference.positions[handle] - reference_joints.positions[handle]
        if np.linalg.norm(own) < 0.02 * height:
            continue
        turn = axis_angle_from_matrix(rotation_between(own, want))
        if keep:
            degrees = np.degrees(np.linalg.norm(turn))
            turn = turn * np.clip((degrees - keep) / 20.0, 0, 1)
        out[handle] = matrix_from_axis_angle(turn)
    for name, lead_name in _FOLLOWERS.items():
        out[HANDLE_NAMES.index(name)] = out[HANDLE_NAMES.index(lead_name)]
    return out


def _attached(rotations: np.ndarray, handles: Handles, joints: Joints) -> tuple[np.ndarray, np.ndarray]:
    """Local rotations and translations in which every joint holds; absent handles move with their parents."""
    rotations = rotations.copy()
    translations = np.zeros((*rotations.shape[:2], 3))
    h = handles.positions.astype(np.float64)
    for handle in range(1, rotations.shape[1]):
        parent = int(joints.parents[handle])
        if not joints.present[handle]:
            rotations[:, handle] = rotations[:, parent]
        joint = joints.positions[handle]
        place = np.einsum("nij,j->ni", rotations[:, parent], joint - h[parent]) + h[parent] + translations[:, parent]
        translations[:, handle] = place - np.einsum("nij,j->ni", rotations[:, handle], joint - h[handle]) - h[handle]
    return rotations, translations


def _residual(motion: HandleMotion, reference_joints: Joints) -> np.ndarray:
    """What the motion's local translations hold beyond stiff joints: soft bending and shrugs, in the reference's metres (N, K, 3).

    Long residuals are cut to 5 cm: they are errors of the generator, not motion.
    """
    body = reference_body()
    stiff = _attached(motion.rotations.astype(np.float64), body.handles, reference_joints)[1]
    residual = motion.translations - stiff
    length = np.linalg.norm(residual, axis=-1, keepdims=True)
    return residual * np.minimum(1, 0.05 / np.maximum(length, 1e-9))


def _lowest(vertices: np.ndarray, weights: np.ndarray, motion: HandleMotion, positions: np.ndarray) -> np.ndarray:
    """Height of the lowest vertex in each frame [m], shape (N,), from an even sample of the vertices."""
    pick = slice(None, None, max(1, len(vertices) // SAMPLE))
    return skin(vertices[pick], weights[pick], motion.transforms(positions))[..., 1].min(axis=1)


def fit_motion(motion: HandleMotion, character: Character, handles: Handles, stages: Stages | None = None) -> HandleMotion:
    """A handle motion of the reference body, fitted to a character.

    Args:
        motion: Motion of the reference body's handles, feet on y = 0.
        character: The character, facing +Z.
        handles: Its handles, K = 30 with the reference body's meaning.
        stages: Which stages run; all when None.

    Returns:
        The motion for the character, its root path scaled by the height of the root handle above the lowest vertex.
    """
    stages = stages or Stages()
    body = reference_body()
    own_floor = float(character.vertices[:, 1].min())
    scale = max(float(handles.positions[0, 1]) - own_floor, 0.02 * character.height) / float(body.handles.positions[0, 1])
    joints = find_joints(character, handles)
    rotations = motion.rotations.astype(np.float64)
    reference_joints = _reference_joints()
    turns = np.tile(np.eye(3), (len(handles.positions), 1, 1))
    if stages.rest_pose:
        turns = rest_rotations(handles, joints, body.handles, _estimated_reference_joints(), character.height)
        rotations = rotations @ turns
    joints = _corrected(joints, handles, turns, _estimated_reference_joints())
    if stages.attach:
        rotations, translations = _attached(rotations, handles, joints)
        translations += _residual(motion, reference_joints) * scale * joints.present[:, None]
    else:
        translations = motion.translations * scale
    fitted = replace(motion, rotations=rotations, translations=translations, root_translation=motion.root_translation * scale)
    if stages.ground:
        fitted = _grounded(motion, fitted, character, handles, scale)
    return fitted


@lru_cache(maxsize=1)
def _reference_joints() -> Joints:
    body = reference_body()
    estimated = find_joints(body.character(), body.handles)
    return replace(estimated, positions=np.concatenate([body.joints, estimated.positions[len(body.joints) :]]))


@lru_cache(maxsize=1)
def _estimated_reference_joints() -> Joints:
    body = reference_body()
    return find_joints(body.character(), body.handles)


def _corrected(joints: Joints, handles: Handles, turns: np.ndarray, estimated: Joints) -> Joints:
    """Joints moved by what the estimate misses on the reference body, whose true joints are known, in each part's own scale."""
    body = reference_body()
    positions = joints.positions.copy()
    for handle in range(1, len(body.joints)):
        parent = int(joints.parents[handle])
        if not joints.present[handle] or parent != HANDLE_PARENTS[handle]:
            continue
        own = np.linalg.norm(handles.positions[handle] - handles.positions[parent])
        size = float(own / np.linalg.norm(body.handles.positions[handle] - body.handles.positions[parent]))
        positions[handle] += turns[handle].T @ (body.joints[handle] - estimated.positions[handle]) * size
    return replace(joints, positions=positions)


def _grounded(motion: HandleMotion, fitted: HandleMotion, character: Character, handles: Handles, scale: float) -> HandleMotion:
    """The fitted motion with its lowest point as high as the reference body's, whose own drift off the ground is taken out.

    Nobody stays in the air for a second, so the lowest height within 0.75 s of a frame is where the ground is for that frame.
    """
    body = reference_body()
    want = _lowest(body.vertices, body.handle_weights, motion, body.handles.positions)
    window = 2 * round(0.75 * motion.fps) + 1
    drift = gaussian_filter1d(minimum_filter1d(want, window, mode="nearest"), 0.25 * motion.fps, mode="nearest")
    have = _lowest(character.vertices, handles.weights, fitted, handles.positions)
    lift = uniform_filter1d((want - drift) * scale - have, 5, mode="nearest")
    moved = fitted.root_translation.copy()
    moved[:, 1] += lift
    return replace(fitted, root_translation=moved)
