"""A dog with floppy ears, a snout, a raised tail and a red collar."""

from __future__ import annotations

import numpy as np

from bunraku.core.character import Character
from bunraku_lab.synthetic.samples.assembly import Bones, assemble, clay, mirror_bones, mirror_piece, solid
from bunraku_lab.synthetic.samples.features import eye
from bunraku_lab.synthetic.samples.fields import Field, ball, bar, limb, mirrored
from bunraku_lab.synthetic.samples.paint import Paint, both, bump, either, slab
from bunraku_lab.synthetic.samples.surfaces import ball_mesh, cylinder_mesh, ring_mesh, tube_mesh

__all__ = ["build"]

COAT, CREAM, EAR, COLLAR, TAG, NOSE, TONGUE = (
    "#d08a46",
    "#fbeeda",
    "#8a5228",
    "#d63a3a",
    "#ffcc4d",
    "#2a2023",
    "#f08a94",
)

_BONES: Bones = mirror_bones(
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


def _field() -> Field:
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


def build(detail: float, rigged: bool) -> Character:
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
    field = _field()
    left = eye(field, (0.058, 0.878, 0.46), (0.023, 0.03), NOSE, "Head")
    tilt = np.array([[1, 0, 0], [0, np.cos(0.5), -np.sin(0.5)], [0, np.sin(0.5), np.cos(0.5)]])
    tongue = np.array([(0, 0.765, 0.53), (0, 0.757, 0.575), (0, 0.728, 0.592), (0, 0.705, 0.592)])
    pieces = [
        clay(field, int(5000 * detail), _BONES, COAT, paints, half=True),
        *left,
        *(mirror_piece(piece) for piece in left),
        solid(ball_mesh((0, 0.838, 0.602), (0.034, 0.025, 0.022), 2), NOSE, "Head"),
        solid(tube_mesh(tongue, [0.008, 0.0085, 0.0085, 0.007], 10, flat=3.0, up=(1, 0, 0)), TONGUE, "Jaw"),
        solid(ring_mesh((0, 0.69, 0.268), 0.112, (0.014, 0.022), 40, 8, tilt), COLLAR, "Neck"),
        solid(cylinder_mesh((0, 0.618, 0.372), (0, 0.612, 0.382), (0.028, 0.028), 20, 1, 0.003), TAG, "Neck"),
    ]
    return assemble("dog", pieces, _BONES, rigged)
