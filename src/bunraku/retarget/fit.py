"""From the reference body to any character: the analytic adaptation of a handle motion.

The diffusion model speaks of the reference body: its proportions and its T-pose. Three named stages, each of which can be
switched off, turn its motion into one of another character.

- `rest_pose`: a limb that rests in another direction than the reference body's (arms down, A-pose, sitting, the front legs of a
  dog) is first turned into the reference's direction, so the motion means the same.
- `attach`: local translations are set so that each handle stays joined to its parent at the place where their weights meet. It
  takes the place of the learned adaptation delta (section 3.2 of TapMo) where bones are longer or shorter than the reference's.
- `ground`: the lowest point of what the character stands on is as high above the ground, in its own scale, as that of the reference body, and
  a reference body that drifts off the ground for longer than a jump lasts is set back on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d, minimum_filter1d, uniform_filter1d

from bunraku.bodies.layout import HANDLE_NAMES, HANDLE_PARENTS
from bunraku.bodies.reference import reference_body
from bunraku.character import Character, Handles
from bunraku.errors import CharacterError
from bunraku.geometry.skinning import skin
from bunraku.motion import HandleMotion
from bunraku.retarget.joints import Joints, attached, estimated_reference_joints, find_joints, reference_joints
from bunraku.retarget.rest_pose import rest_rotations, upright

__all__ = ["Stages", "fit_motion", "stride_scale"]

SAMPLE = 30000  # vertices looked at to find the lowest point
CHUNK = 200  # frames posed at once for it: bounds memory at about 70 MB
_LEGS = [i for i, name in enumerate(HANDLE_NAMES) if name.endswith(("hip", "knee", "ankle", "foot"))]
_HANGING = [i for i, name in enumerate(HANDLE_NAMES) if name.endswith(("shoulder", "elbow", "wrist", "fingers", "wing", "tail", "tail_tip"))]


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


def _standing(character: Character, handles: Handles) -> np.ndarray:
    """Vertices that may stand on the ground, shape (V,), bool: the surface, but of who stands on legs not what may hang lower
    than the feet, such as a weapon in a hand, long arms or a tail.
    """
    seen, heights = character.surface, character.vertices[:, 1]
    legs = seen & (handles.weights[:, _LEGS].sum(axis=1) > 0.5)
    if not upright(handles) or not legs.any() or heights[legs].min() - heights[seen].min() > 0.2 * character.height:
        return seen
    return seen & (handles.weights[:, _HANGING].sum(axis=1) < 0.5)


def stride_scale(character: Character, handles: Handles) -> float:
    """How long the character's strides are over the reference body's: the height of the root handle over the floor, as a ratio."""
    over_floor = float(handles.positions[0, 1]) - float(character.vertices[_standing(character, handles), 1].min())
    return max(over_floor, 0.02 * character.height) / float(reference_body().handles.positions[0, 1])


def _residual(motion: HandleMotion) -> np.ndarray:
    """What the motion's local translations hold beyond stiff joints: soft bending and shrugs, in the reference's metres (N, K, 3).

    Long residuals are cut to 5 cm: they are errors of the generator, not motion.
    """
    body = reference_body()
    stiff = attached(motion.rotations.astype(np.float64), body.handles, reference_joints())[1]
    residual = motion.translations - stiff
    length = np.linalg.norm(residual, axis=-1, keepdims=True)
    return residual * np.minimum(1, 0.05 / np.maximum(length, 1e-9))


def _lowest(vertices: np.ndarray, weights: np.ndarray, motion: HandleMotion, positions: np.ndarray) -> np.ndarray:
    """Height of the lowest vertex in each frame [m], shape (N,), from an even sample of the vertices."""
    pick = slice(None, None, max(1, len(vertices) // SAMPLE))
    transforms = motion.transforms(positions)
    parts = [transforms[start : start + CHUNK] for start in range(0, len(transforms), CHUNK)]
    return np.concatenate([skin(vertices[pick], weights[pick], part)[..., 1].min(axis=1) for part in parts])


def fit_motion(motion: HandleMotion, character: Character, handles: Handles, stages: Stages | None = None) -> HandleMotion:
    """A handle motion of the reference body, fitted to a character.

    Args:
        motion: Motion of the reference body's handles, feet on y = 0.
        character: The character, facing +Z.
        handles: Its handles, K = 30 with the reference body's meaning.
        stages: Which stages run; all when None.

    Returns:
        The motion for the character, its root path scaled by the height of the root handle above the floor.

    Raises:
        CharacterError: The handles are not as many as the reference body's.
    """
    stages = stages or Stages()
    body = reference_body()
    if len(handles.positions) != len(body.handles.positions):
        want = len(body.handles.positions)
        raise CharacterError(f"a motion is fitted to {want} handles, not {len(handles.positions)}; take those of `bunraku.rig`")
    scale = stride_scale(character, handles)
    joints = find_joints(character, handles)
    rotations = motion.rotations.astype(np.float64)
    turns = np.tile(np.eye(3), (len(handles.positions), 1, 1))
    if stages.rest_pose:
        turns = rest_rotations(handles, joints, body.handles, estimated_reference_joints(), character.height)
        rotations = rotations @ turns
    joints = _corrected(joints, handles, turns, estimated_reference_joints())
    if stages.attach:
        rotations, translations = attached(rotations, handles, joints)
        translations += _residual(motion) * scale * joints.present[:, None]
    else:
        translations = motion.translations * scale
    fitted = replace(motion, rotations=rotations, translations=translations, root_translation=motion.root_translation * scale)
    if stages.ground:
        fitted = _grounded(motion, fitted, character, handles, scale)
    return fitted


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
    stands = _standing(character, handles)
    have = _lowest(character.vertices[stands], handles.weights[stands], fitted, handles.positions)
    seen = character.surface
    if stands.sum() < seen.sum():
        feet = _standing(body.character(), body.handles)
        hands_down = _lowest(body.vertices[feet], body.handle_weights[feet], motion, body.handles.positions) > want + 0.01
        if hands_down.any():
            have = np.where(hands_down, _lowest(character.vertices[seen], handles.weights[seen], fitted, handles.positions), have)
    lift = uniform_filter1d((want - drift) * scale - have, 5, mode="nearest")
    moved = fitted.root_translation.copy()
    moved[:, 1] += lift
    return replace(fitted, root_translation=moved)
