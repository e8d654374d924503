"""The sample characters that are no people: a dog, a young dragon with spread wings, and a walking mushroom."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from bunraku.core.character import Character
from bunraku_lab.synthetic.fields import Field, ball, bar, limb, mirrored
from bunraku_lab.synthetic.samples.pieces import (
    Bones,
    Paint,
    Piece,
    assemble,
    both,
    bump,
    button,
    clay,
    either,
    eye,
    mirror_bones,
    mirror_piece,
    slab,
    solid,
    stroke,
)
from bunraku_lab.synthetic.surfaces import ball_mesh, cylinder_mesh, plate_mesh, ring_mesh, tube_mesh

__all__ = ["build_dog", "build_dragon", "build_mushroom"]

COAT, CREAM, EAR, COLLAR, TAG, NOSE, TONGUE = (
    "#d08a46", "#fbeeda", "#8a5228", "#d63a3a", "#ffcc4d", "#2a2023", "#f08a94",
)  # fmt: skip

# Modelled by eye.
_DOG_BONES: Bones = mirror_bones(
    {
        "Hips": ("", (0, 0.53, -0.26)),
        "Spine": ("Hips", (0, 0.55, -0.10)),
        "Chest": ("Spine", (0, 0.55, 0.10)),
        "Neck": ("Chest", (0, 0.62, 0.24)),
        "Head": ("Neck", (0, 0.80, 0.35)),
        "Jaw": ("Head", (0, 0.755, 0.43)),
        "LeftEar": ("Head", (0.115, 0.90, 0.31)),
        "LeftArm": ("Chest", (0.095, 0.47, 0.20)),
        "LeftForeArm": ("LeftArm", (0.105, 0.27, 0.18)),
        "LeftHand": ("LeftForeArm", (0.108, 0.08, 0.195)),
        "LeftUpLeg": ("Hips", (0.095, 0.48, -0.28)),
        "LeftLeg": ("LeftUpLeg", (0.11, 0.29, -0.25)),
        "LeftFoot": ("LeftLeg", (0.112, 0.14, -0.325)),
        "Tail1": ("Hips", (0, 0.60, -0.385)),
        "Tail2": ("Tail1", (0, 0.74, -0.475)),
        "Tail3": ("Tail2", (0, 0.88, -0.465)),
    }
)


def _dog_field() -> Field:
    trunk = [
        ball((0, 0.53, -0.26), (0.142, 0.145, 0.16), "Hips"),
        bar((0, 0.54, -0.20), (0, 0.535, 0.0), (0.132, 0.138), "Spine", blend=0.04),
        bar((0, 0.525, 0.06), (0, 0.53, 0.17), (0.155, 0.15), "Chest", stretch=(0.94, 1.08, 1), blend=0.05),
        bar((0, 0.58, 0.21), (0, 0.76, 0.31), (0.115, 0.092), "Neck", blend=0.06),
        ball((0, 0.845, 0.345), (0.135, 0.125, 0.135), "Head", blend=0.03),
        bar((0, 0.805, 0.44), (0, 0.80, 0.55), (0.078, 0.06), "Head", stretch=(1.05, 0.82, 1), blend=0.035),
        bar((0, 0.758, 0.44), (0, 0.757, 0.525), (0.052, 0.04), "Jaw", stretch=(1, 0.75, 1), blend=0.008),
    ]
    tail = [
        *limb(
            [(0, 0.585, -0.35), (0, 0.66, -0.45), (0, 0.74, -0.485)], [0.056, 0.05, 0.046], "Tail1", blend=0.05, bends=3
        ),
        *limb(
            [(0, 0.74, -0.485), (0, 0.82, -0.495), (0, 0.89, -0.475)],
            [0.046, 0.046, 0.046],
            "Tail2",
            blend=0.01,
            bends=2,
        ),
        *limb(
            [(0, 0.89, -0.475), (0, 0.955, -0.43), (0, 0.985, -0.37)],
            [0.046, 0.038, 0.014],
            "Tail3",
            blend=0.01,
            bends=3,
        ),
    ]
    sides = [
        bar((0.085, 0.47, 0.18), (0.102, 0.30, 0.18), (0.080, 0.058), "LeftArm", blend=0.055),
        *limb([(0.102, 0.30, 0.18), (0.108, 0.09, 0.192)], [0.058, 0.05], "LeftForeArm", blend=0.01),
        bar((0.108, 0.05, 0.195), (0.11, 0.045, 0.245), (0.058, 0.056), "LeftHand", blend=0.015),
        bar((0.085, 0.49, -0.28), (0.11, 0.31, -0.245), (0.105, 0.066), "LeftUpLeg", blend=0.03),
        *limb([(0.11, 0.31, -0.245), (0.112, 0.16, -0.325)], [0.066, 0.048], "LeftLeg", blend=0.01),
        *limb([(0.112, 0.16, -0.325), (0.112, 0.06, -0.305)], [0.047, 0.047], "LeftFoot", blend=0.01),
        bar((0.112, 0.05, -0.30), (0.114, 0.045, -0.245), (0.057, 0.055), "LeftFoot", blend=0.015),
        bar((0.10, 0.92, 0.315), (0.155, 0.90, 0.315), (0.035, 0.042), "LeftEar", stretch=(1, 0.75, 1), blend=0.02),
        bar((0.157, 0.895, 0.315), (0.178, 0.76, 0.325), (0.044, 0.056), "LeftEar", stretch=(0.5, 1, 1), blend=0.012),
    ]
    return Field([*trunk, *tail, *mirrored(sides)], floor=0.0)


def build_dog(detail: float, rigged: bool) -> Character:
    """See `bunraku_lab.synthetic.samples.make_sample`."""
    paints = [
        Paint(CREAM, either(
            both(slab(1, 0.25, 0.66), bump((0, 0.40, 0.16), (0.10, 0.22, 0.30))),
            both(slab(2, 0.40), slab(1, -1, 0.842)),
            both(slab(0, -0.02, 0.02, tilt=(0, 0, 0)), slab(2, 0.36), slab(1, 0.8)),
            slab(1, -1, 0.122),
            both(slab(2, -1, -0.35), slab(1, 0.895)),
        )),
        Paint(EAR, both(slab(0, 0.118, both_sides=True), slab(1, 0.68), slab(2, 0.22, 0.42))),
        Paint(EAR, bump((0, 0.66, -0.12), (0.12, 0.13, 0.17))),
    ]  # fmt: skip
    field = _dog_field()
    left = eye(field, (0.058, 0.878, 0.46), (0.023, 0.03), NOSE, "Head")
    tilt = np.array([[1, 0, 0], [0, np.cos(0.5), -np.sin(0.5)], [0, np.sin(0.5), np.cos(0.5)]])
    tongue = np.array([(0, 0.765, 0.53), (0, 0.757, 0.575), (0, 0.728, 0.592), (0, 0.705, 0.592)])
    pieces = [
        clay(field, int(5000 * detail), _DOG_BONES, COAT, paints, half=True),
        *left,
        *(mirror_piece(piece) for piece in left),
        solid(ball_mesh((0, 0.838, 0.602), (0.034, 0.025, 0.022), 2), NOSE, "Head"),
        solid(tube_mesh(tongue, [0.008, 0.0085, 0.0085, 0.007], 10, flat=3.0, up=(1, 0, 0)), TONGUE, "Jaw"),
        solid(ring_mesh((0, 0.69, 0.268), 0.112, (0.014, 0.022), 40, 8, tilt), COLLAR, "Neck"),
        solid(cylinder_mesh((0, 0.618, 0.372), (0, 0.612, 0.382), (0.028, 0.028), 20, 1, 0.003), TAG, "Neck"),
    ]
    return assemble("dog", pieces, _DOG_BONES, rigged)


SCALES, BELLY, MEMBRANE, HORN, SPIKE, CLAW = "#3f9b62", "#f3e2a9", "#e8864a", "#f7efe0", "#e8864a", "#f7efe0"

# Modelled by eye.
_DRAGON_BONES: Bones = mirror_bones(
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


def _dragon_field() -> Field:
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
        "Chest": chest * (1 - first), "LeftWing": (1 - chest) * (1 - first), "LeftWing1": first * (1 - second),
        "LeftWing2": second,
    }  # fmt: skip
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


def build_dragon(detail: float, rigged: bool) -> Character:
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
    field = _dragon_field()
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
            path = np.array([
                (x + side, 0.035, z - 0.025 - 8 * side * side), (x + side * 1.1, 0.03, z + 0.005),
                (x + side * 1.15, 0.016, z + 0.03),
            ])  # fmt: skip
            left.append(solid(tube_mesh(path, [0.017, 0.014, 0.004], 8), CLAW, joint))
    pieces = [
        clay(field, int(3500 * detail), _DRAGON_BONES, SCALES, paints, half=True, softness=0.03), *left,
        *(mirror_piece(piece) for piece in left), *_spikes(),
    ]  # fmt: skip
    return assemble("dragon", pieces, _DRAGON_BONES, rigged)


STEM, BLUSH, CAP, SPOT, GILLS, FEET = "#f6e3c5", "#f0a284", "#d8342f", "#fff6e6", "#e9c9a0", "#a4683c"

# Modelled by eye.
_MUSHROOM_BONES: Bones = mirror_bones(
    {
        "Hips": ("", (0, 0.26, 0)),
        "Spine": ("Hips", (0, 0.38, 0)),
        "Head": ("Spine", (0, 0.60, 0)),
        "Cap": ("Head", (0, 0.80, 0)),
        "LeftArm": ("Spine", (0.18, 0.42, 0)),
        "LeftForeArm": ("LeftArm", (0.29, 0.415, 0.01)),
        "LeftHand": ("LeftForeArm", (0.385, 0.41, 0.02)),
        "LeftUpLeg": ("Hips", (0.095, 0.21, 0)),
        "LeftFoot": ("LeftUpLeg", (0.105, 0.07, 0)),
    }
)

# Modelled by eye.
_CAP_CENTRE, _CAP_RADII = np.array([0, 0.76, 0]), np.array([0.395, 0.30, 0.385])
_SPOTS = (
    (0, 0.75, 0.62, 0.075), (0.57, 0.47, 0.66, 0.062), (0.91, 0.13, 0.08, 0.07), (0.48, 0.85, 0, 0.064), (0.6, 0.45,
    -0.66, 0.068),
    (0, 0.68, -0.72, 0.078), (0.26, 0.13, 0.97, 0.05), (0.84, 0.10, -0.54, 0.046), (0.85, 0.05, 0.53, 0.046),
)  # fmt: skip


def _spots() -> list[tuple[np.ndarray, float]]:
    """Place on the cap and radius of the spots of one side [m]."""
    return [(_CAP_CENTRE + _CAP_RADII * np.array(spot[:3]) / np.linalg.norm(spot[:3]), spot[3]) for spot in _SPOTS]


def _mushroom_field() -> Field:
    stem = [
        ball((0, 0.30, 0), (0.195, 0.16, 0.18), "Hips"),
        bar((0, 0.36, 0), (0, 0.47, 0), (0.178, 0.165), "Spine", blend=0.03),
        bar((0, 0.55, 0), (0, 0.72, 0), (0.172, 0.16), "Head", blend=0.03),
    ]
    cap = [
        ball(_CAP_CENTRE, _CAP_RADII, "Cap", blend=0.01),
        ball((0, 0.53, 0), (0.35, 0.165, 0.34), "Cap", blend=0.07, carve=True),
        bar((0, 0.36, 0), (0, 0.50, 0), (0.178, 0.168), "Spine", blend=0.03),
        bar((0, 0.52, 0), (0, 0.70, 0), (0.167, 0.15), "Head", blend=0.05),
    ]
    limbs = [
        *limb(
            [(0.15, 0.42, 0), (0.29, 0.415, 0.01), (0.385, 0.41, 0.02)],
            [0.06, 0.05, 0.046],
            ["LeftArm", "LeftForeArm"],
            blend=0.03,
        ),
        ball((0.425, 0.408, 0.025), (0.062, 0.052, 0.058), "LeftHand", blend=0.02),
        bar((0.405, 0.44, 0.035), (0.405, 0.492, 0.045), (0.026, 0.024), "LeftHand", blend=0.014),
        *limb([(0.095, 0.24, 0), (0.105, 0.08, 0)], [0.082, 0.062], "LeftUpLeg", blend=0.02),
        bar((0.108, 0.055, -0.02), (0.118, 0.052, 0.06), (0.068, 0.075), "LeftFoot", blend=0.02),
    ]
    spots = mirrored(
        [ball(_CAP_CENTRE + 0.93 * (spot - _CAP_CENTRE), radius * 0.62, "Cap", blend=0.05) for spot, radius in _spots()]
    )
    return Field([*stem, *cap, *mirrored(limbs), *spots], floor=0.0)


def build_mushroom(detail: float, rigged: bool) -> Character:
    """See `bunraku_lab.synthetic.samples.make_sample`."""
    rim = slab(1, 0.665)

    def gills(points: np.ndarray) -> np.ndarray:
        # the underside: below the cap's widest line and away from the stem
        out = np.hypot(points[:, 0], points[:, 2])
        return np.minimum(np.minimum(out - 0.185, points[:, 1] - 0.53), 0.665 - points[:, 1])

    paints = [
        Paint(CAP, rim), Paint(SPOT, either(*(bump(spot, radius, both_sides=True) for spot, radius in _spots()))),
        Paint(GILLS, gills), Paint(FEET, slab(1, -1, 0.115)),
    ]  # fmt: skip
    field = _mushroom_field()
    across = np.linspace(-1, 1, 11)
    smile = np.stack([0.04 * across, 0.468 + 0.018 * across**2, np.full(11, 0.18)], axis=1)
    left = [
        *eye(field, (0.066, 0.54, 0.16), (0.027, 0.039), "#2a1c18", "Head"),
        button(field, (0.112, 0.482, 0.13), (0.028, 0.019, 0.005), BLUSH, "Head"),
    ]
    pieces = [
        clay(field, int(5000 * detail), _MUSHROOM_BONES, STEM, paints, half=True, softness=0.03, crease=0.025), *left,
        *(mirror_piece(piece) for piece in left), stroke(field, smile, 0.0075 - 0.003 * across**2, "#7a3b30", "Head"),
    ]  # fmt: skip
    return assemble("mushroom", pieces, _MUSHROOM_BONES, rigged)
