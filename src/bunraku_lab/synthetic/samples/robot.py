"""A tin robot of more than forty loose, hard-edged parts."""

from __future__ import annotations

import numpy as np

from bunraku.core.character import Character
from bunraku_lab.synthetic.samples.assembly import Bones, Piece, assemble, mirror_bones, mirror_piece, solid
from bunraku_lab.synthetic.samples.surfaces import ball_mesh, box_mesh, cylinder_mesh, ring_mesh

__all__ = ["build"]

SHELL, DARK, TRIM, LIGHT, GLOW, WARN = "#f4b740", "#3b4252", "#e9ecef", "#8d99ae", "#5ef0e0", "#ef5b4c"

Place = tuple[float, float, float]

_BONES: Bones = mirror_bones(
    {
        "Hips": ("", (0, 0.72, 0)),
        "Spine": ("Hips", (0, 0.82, 0)),
        "Chest": ("Spine", (0, 0.95, 0)),
        "Neck": ("Chest", (0, 1.20, 0)),
        "Head": ("Neck", (0, 1.27, 0)),
        "LeftShoulder": ("Chest", (0.12, 1.10, 0)),
        "LeftArm": ("LeftShoulder", (0.275, 1.10, 0)),
        "LeftForeArm": ("LeftArm", (0.475, 1.10, 0)),
        "LeftHand": ("LeftForeArm", (0.68, 1.10, 0)),
        "LeftUpLeg": ("Hips", (0.125, 0.67, 0)),
        "LeftLeg": ("LeftUpLeg", (0.125, 0.40, 0)),
        "LeftFoot": ("LeftLeg", (0.125, 0.10, 0)),
    }
)


def build(detail: float, rigged: bool) -> Character:
    """See `bunraku_lab.synthetic.samples.make_sample`."""
    cells = 0.07 / float(np.sqrt(detail))
    around = 2 * int(7 * np.sqrt(detail) + 0.5)
    level = 1 if detail < 0.7 else 2 if detail < 2.5 else 3
    facing = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    sideways = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])

    def block(color: str, joint: str, centre: Place, size: Place, bevel: float = 0.014, taper: float = 1) -> Piece:
        return solid(box_mesh(centre, size, bevel, cells, taper=taper), color, joint)

    def rod(color: str, joint: str, start: Place, end: Place, r0: float, r1: float, bevel: float = 0.006) -> Piece:
        length = float(np.linalg.norm(np.subtract(end, start)))
        return solid(
            cylinder_mesh(start, end, (r0, r1), around, max(int(length / cells), 1), min(bevel, length / 4)),
            color,
            joint,
        )

    middle = [
        block(SHELL, "Chest", (0, 1.03, 0), (0.40, 0.29, 0.27), 0.03, 1.08),
        block(DARK, "Chest", (0, 1.05, 0.137), (0.22, 0.15, 0.022), 0.006),
        rod(GLOW, "Chest", (-0.05, 1.065, 0.143), (-0.05, 1.065, 0.156), 0.034, 0.030, 0.004),
        block(WARN, "Chest", (0.045, 1.087, 0.148), (0.06, 0.022, 0.014), 0.004),
        block(TRIM, "Chest", (0.045, 1.048, 0.148), (0.06, 0.022, 0.014), 0.004),
        rod(DARK, "Spine", (0, 0.80, 0), (0, 0.90, 0), 0.095, 0.095),
        *(solid(ring_mesh((0, y, 0), 0.096, 0.014, around + 8, 6), LIGHT, "Spine") for y in (0.822, 0.852, 0.882)),
        block(SHELL, "Hips", (0, 0.735, 0), (0.32, 0.13, 0.22), 0.025, 0.85),
        rod(LIGHT, "Neck", (0, 1.17, 0), (0, 1.255, 0), 0.052, 0.046),
        block(SHELL, "Head", (0, 1.40, 0), (0.34, 0.28, 0.28), 0.04, 0.9),
        block(DARK, "Head", (0, 1.405, 0.135), (0.255, 0.15, 0.024), 0.008),
        block(GLOW, "Head", (0, 1.358, 0.149), (0.07, 0.012, 0.01), 0.003),
        rod(LIGHT, "Head", (0, 1.53, 0), (0, 1.605, 0), 0.010, 0.008, 0.002),
        solid(ball_mesh((0, 1.625, 0), 0.028, level), WARN, "Head"),
        block(LIGHT, "Chest", (0, 1.04, -0.155), (0.24, 0.20, 0.06), 0.012),
    ]
    left = [
        solid(ball_mesh((0.06, 1.418, 0.148), (0.034, 0.034, 0.012), level), GLOW, "Head"),
        solid(ball_mesh((0.069, 1.428, 0.158), (0.009, 0.009, 0.004), 1), "#ffffff", "Head"),
        rod(WARN, "Head", (0.158, 1.40, 0), (0.192, 1.40, 0), 0.058, 0.050),
        rod(DARK, "LeftShoulder", (0.20, 1.10, 0), (0.235, 1.10, 0), 0.06, 0.06),
        solid(ball_mesh((0.275, 1.10, 0), 0.078, level), WARN, "LeftArm"),
        rod(LIGHT, "LeftArm", (0.33, 1.10, 0), (0.45, 1.10, 0), 0.042, 0.042),
        *(solid(ring_mesh((x, 1.10, 0), 0.043, 0.009, around, 6, sideways), DARK, "LeftArm") for x in (0.37, 0.405)),
        solid(ball_mesh((0.475, 1.10, 0), 0.055, level), DARK, "LeftForeArm"),
        solid(box_mesh((0.585, 1.10, 0), (0.13, 0.165, 0.13), 0.016, cells, sideways, 1.2), SHELL, "LeftForeArm"),
        rod(LIGHT, "LeftHand", (0.664, 1.10, 0), (0.695, 1.10, 0), 0.046, 0.046),
        block(DARK, "LeftHand", (0.725, 1.10, 0), (0.065, 0.05, 0.11), 0.012),
        block(SHELL, "LeftHand", (0.79, 1.10, -0.036), (0.085, 0.036, 0.03), 0.008),
        block(SHELL, "LeftHand", (0.79, 1.10, 0.004), (0.085, 0.036, 0.03), 0.008),
        block(SHELL, "LeftHand", (0.735, 1.10, 0.085), (0.03, 0.036, 0.07), 0.008),
        solid(ball_mesh((0.125, 0.655, 0), 0.066, level), DARK, "LeftUpLeg"),
        rod(LIGHT, "LeftUpLeg", (0.125, 0.62, 0), (0.125, 0.44, 0), 0.05, 0.046),
        *(solid(ring_mesh((0.125, y, 0), 0.05, 0.009, around, 6), DARK, "LeftUpLeg") for y in (0.56, 0.525, 0.49)),
        rod(WARN, "LeftLeg", (0.065, 0.40, 0), (0.185, 0.40, 0), 0.062, 0.062, 0.012),
        block(SHELL, "LeftLeg", (0.125, 0.245, 0), (0.14, 0.23, 0.14), 0.018, 0.78),
        rod(LIGHT, "LeftFoot", (0.125, 0.085, 0), (0.125, 0.135, 0), 0.046, 0.046),
        block(SHELL, "LeftFoot", (0.125, 0.065, 0.03), (0.16, 0.07, 0.25), 0.018, 0.85),
        block(DARK, "LeftFoot", (0.125, 0.0175, 0.03), (0.175, 0.035, 0.27), 0.01),
        solid(ring_mesh((0.125, 0.072, 0.095), 0.03, 0.008, around, 6, facing), DARK, "LeftFoot"),
    ]
    return assemble("robot", [*middle, *left, *(mirror_piece(piece) for piece in left)], _BONES, rigged)
