"""A young dragon on four legs, with a long neck, a long tail and wings spread."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from bunraku.core.character import Character
from bunraku_lab.synthetic.samples.assembly import Bones, Piece, assemble, clay, mirror_bones, mirror_piece, solid
from bunraku_lab.synthetic.samples.features import eye
from bunraku_lab.synthetic.samples.fields import Field, ball, bar, limb, mirrored
from bunraku_lab.synthetic.samples.paint import Paint, both, bump, either, slab
from bunraku_lab.synthetic.samples.surfaces import plate_mesh, tube_mesh

__all__ = ["build"]

SCALES, BELLY, MEMBRANE, HORN, SPIKE, CLAW = "#3f9b62", "#f3e2a9", "#e8864a", "#f7efe0", "#e8864a", "#f7efe0"

_BONES: Bones = mirror_bones(
    {
        "Hips": ("", (0, 0.62, -0.26)),
        "Spine": ("Hips", (0, 0.64, -0.08)),
        "Chest": ("Spine", (0, 0.65, 0.10)),
        "Neck": ("Chest", (0, 0.74, 0.28)),
        "Neck1": ("Neck", (0, 0.92, 0.38)),
        "Neck2": ("Neck1", (0, 1.09, 0.41)),
        "Head": ("Neck2", (0, 1.23, 0.46)),
        "Jaw": ("Head", (0, 1.19, 0.53)),
        "LeftArm": ("Chest", (0.12, 0.55, 0.18)),
        "LeftForeArm": ("LeftArm", (0.165, 0.31, 0.14)),
        "LeftHand": ("LeftForeArm", (0.165, 0.08, 0.20)),
        "LeftUpLeg": ("Hips", (0.13, 0.55, -0.28)),
        "LeftLeg": ("LeftUpLeg", (0.175, 0.31, -0.20)),
        "LeftFoot": ("LeftLeg", (0.175, 0.10, -0.30)),
        "LeftWing": ("Chest", (0.10, 0.82, 0.06)),
        "LeftWing1": ("LeftWing", (0.42, 1.10, 0.02)),
        "LeftWing2": ("LeftWing1", (0.78, 1.03, -0.03)),
        "Tail1": ("Hips", (0, 0.58, -0.45)),
        "Tail2": ("Tail1", (0, 0.43, -0.70)),
        "Tail3": ("Tail2", (0, 0.32, -0.97)),
        "Tail4": ("Tail3", (0, 0.33, -1.22)),
    }
)


def _field() -> Field:
    trunk = [
        ball((0, 0.61, -0.26), (0.175, 0.17, 0.20), "Hips"),
        bar((0, 0.62, -0.16), (0, 0.63, 0.0), (0.178, 0.178), "Spine", blend=0.05),
        ball((0, 0.645, 0.12), (0.18, 0.19, 0.20), "Chest", blend=0.05),
        *limb([(0, 0.70, 0.22), (0, 0.80, 0.335), (0, 0.93, 0.385)], [0.14, 0.112, 0.095], "Neck", blend=0.06, bends=2),
        *limb([(0, 0.93, 0.385), (0, 1.09, 0.405)], [0.095, 0.083], "Neck1", blend=0.01),
        *limb([(0, 1.09, 0.405), (0, 1.20, 0.445)], [0.083, 0.082], "Neck2", blend=0.01),
        ball((0, 1.265, 0.475), (0.112, 0.100, 0.115), "Head", blend=0.03),
        bar((0, 1.245, 0.56), (0, 1.228, 0.68), (0.078, 0.063), "Head", stretch=(1.05, 0.8, 1), blend=0.03),
        *mirrored([ball((0.034, 1.268, 0.715), (0.024, 0.018, 0.022), "Head", blend=0.02)]),
        bar((0, 1.185, 0.54), (0, 1.178, 0.665), (0.058, 0.045), "Jaw", stretch=(1.05, 0.62, 1), blend=0.008),
        *mirrored([ball((0.066, 1.325, 0.53), (0.04, 0.026, 0.04), "Head", blend=0.02)]),
        *limb(
            [(0, 0.60, -0.36), (0, 0.55, -0.52), (0, 0.43, -0.71)], [0.15, 0.118, 0.094], "Tail1", blend=0.05, bends=2
        ),
        *limb(
            [(0, 0.43, -0.71), (0, 0.355, -0.84), (0, 0.32, -0.98)], [0.094, 0.08, 0.066], "Tail2", blend=0.01, bends=2
        ),
        *limb(
            [(0, 0.32, -0.98), (0, 0.31, -1.10), (0, 0.335, -1.22)], [0.066, 0.052, 0.04], "Tail3", blend=0.01, bends=2
        ),
        *limb(
            [(0, 0.335, -1.22), (0, 0.37, -1.32), (0, 0.43, -1.40)], [0.04, 0.028, 0.014], "Tail4", blend=0.01, bends=2
        ),
    ]
    sides = [
        bar((0.11, 0.56, 0.17), (0.162, 0.33, 0.14), (0.10, 0.066), "LeftArm", blend=0.04),
        *limb([(0.162, 0.33, 0.14), (0.165, 0.10, 0.19)], [0.066, 0.056], "LeftForeArm", blend=0.01),
        bar((0.165, 0.055, 0.19), (0.168, 0.045, 0.26), (0.066, 0.064), "LeftHand", blend=0.02),
        bar((0.115, 0.56, -0.28), (0.172, 0.34, -0.20), (0.135, 0.078), "LeftUpLeg", blend=0.04),
        *limb([(0.172, 0.34, -0.20), (0.175, 0.12, -0.30)], [0.078, 0.058], "LeftLeg", blend=0.01),
        bar((0.175, 0.06, -0.29), (0.178, 0.045, -0.21), (0.066, 0.066), "LeftFoot", blend=0.02),
        *limb(
            [(0.09, 0.78, 0.07), (0.25, 0.98, 0.05), (0.42, 1.10, 0.02)],
            [0.055, 0.037, 0.03],
            "LeftWing",
            blend=0.03,
            bends=2,
        ),
        *limb(
            [(0.42, 1.10, 0.02), (0.60, 1.10, -0.005), (0.78, 1.03, -0.03)],
            [0.03, 0.025, 0.021],
            "LeftWing1",
            blend=0.005,
            bends=2,
        ),
        *limb(
            [(0.78, 1.03, -0.03), (0.93, 0.91, -0.06), (1.01, 0.78, -0.09)],
            [0.021, 0.017, 0.012],
            "LeftWing2",
            blend=0.004,
            bends=2,
        ),
    ]
    return Field([*trunk, *mirrored(sides)], floor=0.0)


def _membrane(detail: float) -> Piece:
    """The skin of the left wing: its upper edge lies in the wing's bones, its lower edge hangs in scallops."""
    fine = float(np.sqrt(detail))
    top = np.array([(0.13, 0.82), (0.25, 0.975), (0.42, 1.10), (0.60, 1.10), (0.78, 1.03), (0.93, 0.91), (1.01, 0.78)])
    low = np.array([(1.01, 0.78), (0.80, 0.70), (0.52, 0.66), (0.30, 0.66), (0.13, 0.74)])
    count = int(9 * fine)
    edge = []
    for a, b in pairwise(top):
        edge += [a + t * (b - a) for t in np.linspace(0, 1, max(count // 2, 3), endpoint=False)]
    for a, b in pairwise(low):
        edge += [
            a + t * (b - a) + np.array([0, 0.055 * np.sin(np.pi * t)]) for t in np.linspace(0, 1, count, endpoint=False)
        ]
    edge += [low[-1] + t * (top[0] - low[-1]) for t in np.linspace(0, 1, 3, endpoint=False)]

    def bulge(points: np.ndarray) -> np.ndarray:
        x, y, z = points.T
        belly = 0.045 * np.sin(np.pi * np.clip((x - 0.13) / 0.88, 0, 1)) * np.clip((1.10 - y) / 0.4, 0, 1)
        return np.stack([x, y, z + 0.065 - 0.155 * np.clip(x, 0, 1) ** 1.3 - belly], axis=1)

    vertices, faces = plate_mesh(np.array(edge), (0.50, 0.87), 0.016, int(6 * fine), bulge)
    x = vertices[:, 0]
    first, second = np.clip((x - 0.34) / 0.16, 0, 1), np.clip((x - 0.70) / 0.16, 0, 1)
    chest = np.clip((0.22 - x) / 0.12, 0, 1)
    weights = {
        "Chest": chest * (1 - first),
        "LeftWing": (1 - chest) * (1 - first),
        "LeftWing1": first * (1 - second),
        "LeftWing2": second,
    }
    return solid((vertices, faces), MEMBRANE, weights)


def _spikes() -> list[Piece]:
    """A row of spikes down the neck, back and tail."""
    line = [
        (1.345, 0.375, "Head", 0.6), (1.21, 0.345, "Neck2", 0.8), (1.09, 0.315, "Neck1", 0.9), (0.965, 0.283, "Neck1",
        0.95),
        (0.862, 0.21, "Neck", 1.0), (0.815, 0.11, "Chest", 1.1), (0.795, 0.0, "Spine", 1.15), (0.782, -0.115, "Spine",
        1.1),
        (0.765, -0.235, "Hips", 1.05), (0.73, -0.36, "Hips", 1.0), (0.66, -0.50, "Tail1", 0.9), (0.575, -0.62, "Tail1",
        0.85),
        (0.495, -0.74, "Tail2", 0.75), (0.425, -0.86, "Tail2", 0.7), (0.375, -0.98, "Tail3", 0.6), (0.355, -1.10,
        "Tail3", 0.5),
        (0.365, -1.22, "Tail4", 0.45),
    ]  # fmt: skip
    positions = np.array([entry[:2] for entry in line])
    slope = np.gradient(positions, axis=0)
    out = []
    for (y, z, joint, size), (dy, dz) in zip(line, slope, strict=True):
        length = float(np.hypot(dy, dz))
        up = np.array([-dz, dy]) / length
        back = np.array([dy, dz]) / length
        steps = np.linspace(-0.25, 1, 5)
        path = [
            (
                0,
                y + 0.075 * size * (s * up[0] + 0.35 * s * s * back[0]),
                z + 0.075 * size * (s * up[1] + 0.35 * s * s * back[1]),
            )
            for s in steps
        ]
        radii = 0.04 * size * np.array([1.0, 0.85, 0.6, 0.33, 0.1])
        out.append(solid(tube_mesh(np.array(path), radii, 8, flat=1.0, up=(1, 0, 0)), SPIKE, joint))
    for piece in out:
        piece.vertices[:, 0] *= 0.45
    return out


def build(detail: float, rigged: bool) -> Character:
    """See `bunraku_lab.synthetic.samples.make_sample`."""

    def underside(points: np.ndarray) -> np.ndarray:
        # a band along belly, throat and tail: a strip about x = 0 on whatever faces forward and down
        x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
        spine = np.interp(
            z, [-1.45, -1.22, -0.98, -0.71, -0.36, 0.15, 0.25], [0.45, 0.335, 0.32, 0.43, 0.60, 0.66, 0.75]
        )
        throat = np.interp(y, [0.55, 0.70, 0.80, 0.93, 1.09, 1.17], [0.02, 0.22, 0.335, 0.385, 0.405, 0.43])
        below = np.where(z < 0.15, spine - 0.025 - y, np.where(y < 1.17, z - throat - 0.02, -0.1))
        width = np.interp(z, [-1.45, -0.9, -0.4, 0.2], [0.02, 0.055, 0.105, 0.115]) * np.interp(
            y, [0.75, 1.15], [1, 0.6]
        )
        width = np.where((z > 0.06) & (y < 0.62), np.minimum(width, 0.072 + 0.3 * np.maximum(y - 0.50, 0)), width)
        trunk = np.where((z > -0.42) & (z < 0.06), y - 0.44, y - 0.40)
        trunk = np.where(z > -0.42, trunk, 0.5)
        return np.min([below, width - x, trunk], axis=0)

    paints = [
        Paint(BELLY, underside),
        Paint(BELLY, both(slab(2, 0.5), slab(1, 1.0, 1.198))),
        Paint("#2f7d4e", either(*(both(bump((0.17, y, z), (0.07, r, r), both_sides=True), slab(1, 0.4))
                                  for y, z, r in ((0.70, -0.05, 0.04), (0.74, -0.17, 0.028), (0.68, -0.30, 0.045),
                                  (0.66, 0.08, 0.026))))),
    ]  # fmt: skip
    field = _field()
    horn = np.array([(0.055, 1.335, 0.44), (0.072, 1.385, 0.41), (0.08, 1.43, 0.36), (0.078, 1.455, 0.305)])
    ear = np.array([(0.10, 1.275, 0.44), (0.145, 1.29, 0.40), (0.185, 1.315, 0.355)])
    left = [
        *eye(field, (0.078, 1.302, 0.565), (0.018, 0.027), "#2a1c18", "Head", "#fff8e8"),
        solid(tube_mesh(horn, [0.028, 0.023, 0.015, 0.004], 10), HORN, "Head"),
        solid(tube_mesh(ear, [0.03, 0.03, 0.006], 10, flat=0.5), SCALES, "Head"),
        _membrane(detail),
    ]  # fmt: skip
    for x, z, joint in ((0.168, 0.315, "LeftHand"), (0.178, -0.155, "LeftFoot")):
        for side in (-0.036, 0.0, 0.036):
            path = np.array(
                [
                    (x + side, 0.035, z - 0.025 - 8 * side * side),
                    (x + side * 1.1, 0.03, z + 0.005),
                    (x + side * 1.15, 0.016, z + 0.03),
                ]
            )
            left.append(solid(tube_mesh(path, [0.017, 0.014, 0.004], 8), CLAW, joint))
    pieces = [
        clay(field, int(3500 * detail), _BONES, SCALES, paints, half=True, softness=0.03),
        *left,
        *(mirror_piece(piece) for piece in left),
        *_spikes(),
    ]
    return assemble("dragon", pieces, _BONES, rigged)
