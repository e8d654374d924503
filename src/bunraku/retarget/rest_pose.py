"""Rest poses reconciled: limbs turned from where they rest to where the reference body's rest."""

from __future__ import annotations

import numpy as np

from bunraku.bodies.layout import HANDLE_NAMES
from bunraku.character import Handles
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, rotation_between
from bunraku.retarget.joints import Joints

__all__ = ["rest_rotations", "upright"]

_LIMB_ENDS = {"shoulder": "elbow", "elbow": "wrist", "hip": "knee", "knee": "ankle"}
_FOLLOWERS = {f"{side}_{part}": f"{side}_elbow" for side in ("left", "right") for part in ("wrist", "fingers")}
SHORTEST = 0.02  # limbs shorter than this share of the height have no direction worth a turn


def rest_rotations(handles: Handles, joints: Joints, reference: Handles, reference_joints: Joints, height: float) -> np.ndarray:
    """Rotation of each handle that turns the character's rest direction of a limb into the reference body's, shape (K, 3, 3).

    Arms, and the front legs of animals, are turned wholly, and hands follow their forearms. Legs of upright characters keep
    their stance (see `_leg_turn`); hind legs of animals are left as they are. Everything else keeps the identity.
    """
    out = np.tile(np.eye(3), (len(handles.positions), 1, 1))
    stands = upright(handles)
    for side in ("left", "right"):
        for part, end in _LIMB_ENDS.items():
            handle, child = HANDLE_NAMES.index(f"{side}_{part}"), HANDLE_NAMES.index(f"{side}_{end}")
            if not joints.present[handle]:
                if part == "elbow":
                    out[handle] = out[int(joints.parents[handle])]
                continue
            if joints.present[child]:
                own, want = joints.positions[child] - joints.positions[handle], reference_joints.positions[child] - reference_joints.positions[handle]
            else:
                own, want = handles.positions[handle] - joints.positions[handle], reference.positions[handle] - reference_joints.positions[handle]
            if np.linalg.norm(own) < SHORTEST * height:
                continue
            if part in ("hip", "knee"):
                out[handle] = _leg_turn(own, want) if stands else np.eye(3)
            else:
                out[handle] = rotation_between(own, want)
    for name, lead in _FOLLOWERS.items():
        out[HANDLE_NAMES.index(name)] = out[HANDLE_NAMES.index(lead)]
    return out


def upright(handles: Handles) -> bool:
    """Whether the head is over the hips rather than before them."""
    spine = handles.positions[HANDLE_NAMES.index("head")] - handles.positions[0]
    return bool(spine[1] > abs(spine[2]))


def _leg_turn(own: np.ndarray, want: np.ndarray) -> np.ndarray:
    """Turn of a thigh or a shin, shape (3, 3).

    Standing wide is style and stays. Bent forward or back, a leg comes from an idle pose (up to 30 degrees) or sits (over 65) and is
    straightened; in between it is most likely built that way, as the legs of birds and mechs are, and stays.
    """
    sideways = np.degrees(np.arctan2(own[0], -own[1]))
    down = np.hypot(own[0], own[1])
    lean = want[2] / np.hypot(want[0], want[1])  # the reference's own legs lean a little
    forward = abs(np.degrees(np.arctan2(own[2], down) - np.arctan(lean)))
    target = np.array([own[0], own[1], down * lean]) if abs(sideways) < 30 else want
    amount = np.interp(forward, [30, 45, 55, 65], [1, 0, 0, 1]) if abs(sideways) < 30 else 1.0
    return np.asarray(matrix_from_axis_angle(axis_angle_from_matrix(rotation_between(own, target)) * amount))
