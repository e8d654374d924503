"""Handle motion of a mesh that moves, by weighted rigid registration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import ReferenceBody, handle_positions, reference_body
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.geometry.registration import register
from bunraku.geometry.surface import vertex_areas

__all__ = ["handle_motion_of_body", "handle_motion_of_mesh", "registered_body"]


def handle_motion_of_mesh(
    rest: np.ndarray, posed: np.ndarray, weights: np.ndarray, positions: np.ndarray, areas: np.ndarray, fps: float
) -> HandleMotion:
    """Handle motion of a mesh that moves, by weighted rigid registration (section A.2).

    The root handle's motion is the global one; it is taken off before the other handles are registered, so theirs are
    local.

    Args:
        rest: Rest vertices [m], shape (V, 3).
        posed: Moved vertices of each frame [m], shape (N, V, 3).
        weights: Handle weights, shape (V, K).
        positions: Handle positions [m], shape (K, 3).
        areas: Surface area that each vertex stands for, shape (V,).
        fps: Frames a second [1/s].

    Returns:
        The motion; handles without weight stay at the identity.
    """
    mass = weights * areas[:, None]
    rotations, translations = register(rest, posed, mass[:, :1], positions[:1])
    root_rotation, root_translation = rotations[:, 0], translations[:, 0]
    local = np.einsum("nji,nvj->nvi", root_rotation, posed - positions[0] - root_translation[:, None]) + positions[0]
    rotations, translations = register(rest, local, mass, positions)
    still = mass.sum(axis=0) <= 1e-6 * areas.sum()
    still[0] = True
    rotations[:, still], translations[:, still] = np.eye(3), 0
    return HandleMotion(translations, rotations, root_translation, root_rotation, fps)


CHUNK = 400  # frames posed at once: bounds memory at about 30 MB a worker


def handle_motion_of_body(motion: SkeletalMotion, body: ReferenceBody | None = None) -> HandleMotion:
    """Skeletal motion of SMPL's joints as handle motion of the reference body.

    The body is set on the ground: the clip is moved along Y so that the lowest point of its standing frames (5 %
    quantile) is at 0, unless that is more than 15 cm away, where the clip means to be off the ground.
    """
    whole, lowest, _ = registered_body(motion, body)
    floor = float(np.quantile(lowest, 0.05))
    drop = np.array([0, floor if abs(floor) < 0.15 else 0, 0], np.float32)
    return replace(whole, root_translation=whole.root_translation - drop)


def registered_body(
    motion: SkeletalMotion, body: ReferenceBody | None = None
) -> tuple[HandleMotion, np.ndarray, np.ndarray]:
    """Handle motion of the reference body as the skeleton moves it, wherever the ground is.

    Returns:
        The motion, the lowest point of the body in each frame [m], shape (N,), and that of all but its arms.
    """
    body = body or reference_body()
    areas = vertex_areas(body.vertices, body.faces)
    positions = handle_positions(body.vertices, body.handle_weights, areas)
    arms = [
        HANDLE_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("elbow", "wrist", "fingers")
    ]
    carries = body.handle_weights[:, arms].sum(axis=1) < 0.5
    parts, lowest, carrying = [], [], []
    for start in range(0, len(motion), CHUNK):
        cut = slice(start, start + CHUNK)
        posed = body.pose(
            SkeletalMotion(motion.skeleton, motion.rotations[cut], motion.root_translation[cut], motion.fps)
        )
        lowest.append(posed[..., 1].min(axis=1))
        carrying.append(posed[:, carries, 1].min(axis=1))
        parts.append(handle_motion_of_mesh(body.vertices, posed, body.handle_weights, positions, areas, motion.fps))
    return HandleMotion.joined(parts), np.concatenate(lowest), np.concatenate(carrying)
