"""A friendly young person in a T-shirt, trousers and trainers."""

from __future__ import annotations

import numpy as np

from bunraku.core.character import Character
from bunraku_lab.synthetic.samples.assembly import Bones, Piece, assemble, clay, mirror_bones, mirror_piece
from bunraku_lab.synthetic.samples.features import button, eye, stroke
from bunraku_lab.synthetic.samples.fields import Field, Lump, ball, bar, limb, mirrored
from bunraku_lab.synthetic.samples.paint import Paint, both, bump, slab

__all__ = ["HUMAN_BONES", "arm_lumps", "build", "face_pieces", "head_lumps"]

SKIN, SHIRT, STRIPE, TROUSERS, SHOES, SOLE, HAIR = (
    "#f2b48c",
    "#1fa3a0",
    "#fff4dc",
    "#34457a",
    "#e4573d",
    "#fbf6ec",
    "#5a3422",
)

HUMAN_BONES: Bones = mirror_bones(
    {
        "Hips": ("", (0, 0.84, 0)),
        "Spine": ("Hips", (0, 0.93, 0)),
        "Chest": ("Spine", (0, 1.06, 0)),
        "Neck": ("Chest", (0, 1.235, -0.01)),
        "Head": ("Neck", (0, 1.31, 0)),
        "LeftShoulder": ("Chest", (0.05, 1.18, 0)),
        "LeftArm": ("LeftShoulder", (0.165, 1.18, 0)),
        "LeftForeArm": ("LeftArm", (0.385, 1.18, -0.005)),
        "LeftHand": ("LeftForeArm", (0.595, 1.18, 0)),
        "LeftUpLeg": ("Hips", (0.095, 0.79, 0)),
        "LeftLeg": ("LeftUpLeg", (0.108, 0.44, 0.008)),
        "LeftFoot": ("LeftLeg", (0.12, 0.085, -0.015)),
        "LeftToeBase": ("LeftFoot", (0.132, 0.04, 0.08)),
    }
)


def head_lumps() -> list[Lump]:
    """Neck, head, ears and nose."""
    return [
        bar((0, 1.2, -0.01), (0, 1.32, 0.0), (0.056, 0.05), "Neck", blend=0.03),
        ball((0, 1.475, 0.0), (0.15, 0.165, 0.158), "Head", blend=0.02),
        ball((0, 1.41, 0.03), (0.118, 0.09, 0.118), "Head", blend=0.06),
        ball((0, 1.437, 0.163), (0.021, 0.018, 0.022), "Head", blend=0.015),
        *mirrored([ball((0.152, 1.455, -0.005), (0.022, 0.04, 0.03), "Head", blend=0.012)]),
    ]


def arm_lumps(upper: float = 0.052, lower: float = 0.04, sleeve: float = 0.066) -> list[Lump]:
    """Both arms along X with mittens and thumbs; `sleeve` is the radius of a short sleeve, 0 for none."""
    left = [
        bar((0.10, 1.175, 0), (0.165, 1.18, 0), (0.085, 0.068), "LeftShoulder", blend=0.05),
        *limb(
            [(0.165, 1.18, 0), (0.385, 1.18, -0.005), (0.595, 1.18, 0)],
            [upper + 0.006, upper - 0.008, lower - 0.004],
            ["LeftArm", "LeftForeArm"],
        ),
        bar((0.625, 1.18, 0.0), (0.705, 1.178, 0.005), (0.05, 0.047), "LeftHand", stretch=(1, 0.62, 1), blend=0.03),
        bar((0.715, 1.178, 0.005), (0.745, 1.176, 0.006), (0.045, 0.038), "LeftHand", stretch=(1, 0.62, 1), blend=0.01),
        bar((0.632, 1.176, 0.035), (0.682, 1.17, 0.085), (0.024, 0.021), "LeftHand", blend=0.014),
    ]
    if sleeve:
        left.append(bar((0.16, 1.18, 0), (0.30, 1.178, -0.003), (0.072, sleeve), "LeftArm", blend=0.008))
    return mirrored(left)


def face_pieces(iris: str = "#2b1a14", brow: str = HAIR, blush: str = "#ee9a7c", lashes: bool = False) -> list[Piece]:
    """Eyes, brows, cheeks and a smile on the head of `head_lumps`."""
    head = Field(head_lumps())
    left = [
        *eye(head, (0.057, 1.475, 0.15), (0.026, 0.037), iris, "Head"),
        button(head, (0.094, 1.412, 0.12), (0.024, 0.017, 0.005), blush, "Head"),
    ]
    across = np.linspace(-1, 1, 7)
    arch = np.stack([0.058 + 0.03 * across, 1.534 - 0.009 * across**2 - 0.004 * across, np.full(7, 0.14)], axis=1)
    left.append(stroke(head, arch, 0.0075 - 0.003 * across**2, brow, "Head"))
    if lashes:
        for lift in (0.0, 0.017):
            line = np.array(
                [[0.078, 1.488 + lift, 0.14], [0.088, 1.495 + 1.2 * lift, 0.13], [0.099, 1.505 + 1.4 * lift, 0.12]]
            )
            left.append(stroke(head, line, [0.005, 0.004, 0.002], iris, "Head"))
    across = np.linspace(-1, 1, 11)
    smile = np.stack([0.042 * across, 1.384 + 0.018 * across**2, np.full(11, 0.15)], axis=1)
    return [
        *left,
        *(mirror_piece(piece) for piece in left),
        stroke(head, smile, 0.007 - 0.003 * across**2, "#8c3b32", "Head"),
    ]


def _body() -> Field:
    legs = mirrored(
        [
            *limb([(0.094, 0.80, 0), (0.108, 0.44, 0.008)], [0.084, 0.068], "LeftUpLeg", blend=0.02),
            *limb([(0.108, 0.44, 0.008), (0.119, 0.13, -0.012)], [0.068, 0.066], "LeftLeg", blend=0.006),
            bar((0.12, 0.12, -0.015), (0.12, 0.07, -0.015), 0.048, "LeftFoot", blend=0.01),
            bar((0.121, 0.05, -0.04), (0.132, 0.045, 0.085), (0.056, 0.062), "LeftFoot", blend=0.02),
            bar((0.132, 0.04, 0.085), (0.136, 0.036, 0.115), (0.064, 0.058), "LeftToeBase", blend=0.012),
        ]
    )
    torso = [
        ball((0, 0.85, 0), (0.148, 0.105, 0.108), "Hips", blend=0.03),
        bar((0, 0.905, 0), (0, 0.98, 0), (0.168, 0.152), "Spine", stretch=(1, 0.35, 0.78), blend=0.01),
        bar((0, 1.03, 0), (0, 1.13, 0), (0.153, 0.146), "Chest", stretch=(1.05, 0.8, 0.78), blend=0.05),
    ]
    return Field([*torso, *arm_lumps(), *legs, *head_lumps()], floor=0.0)


def _hair() -> Field:
    cap = [
        ball((0, 1.505, -0.022), (0.172, 0.168, 0.165), "Head"),
        ball((0, 1.43, -0.07), (0.14, 0.10, 0.10), "Head", blend=0.03),
        bar((-0.20, 1.40, 0.15), (0.20, 1.40, 0.15), 0.115, "Head", stretch=(1, 1.15, 1.12), blend=0.03, carve=True),
    ]
    quiff = [
        bar((0.085, 1.60, 0.085), (-0.03, 1.64, 0.115), (0.05, 0.062), "Head", blend=0.03),
        bar((-0.03, 1.64, 0.115), (-0.125, 1.60, 0.085), (0.062, 0.03), "Head", blend=0.02),
        bar((0.02, 1.66, 0.0), (-0.07, 1.672, 0.05), (0.06, 0.045), "Head", blend=0.03),
        *mirrored([bar((0.148, 1.52, 0.045), (0.156, 1.45, 0.04), (0.03, 0.012), "Head", blend=0.02)]),
        bar((0.02, 1.65, -0.07), (0.05, 1.705, -0.115), (0.045, 0.012), "Head", blend=0.03),
    ]
    return Field([*cap, *quiff])


def build(detail: float, rigged: bool) -> Character:
    """See `bunraku_lab.synthetic.samples.make_sample`."""
    paints = [
        Paint(SHIRT, both(slab(0, -0.348, 0.348), slab(1, 0.862, 1.3))),
        Paint(SKIN, bump((0, 1.275, 0.005), (0.088, 0.062, 0.1))),
        Paint(STRIPE, both(slab(0, -0.2, 0.2), slab(1, 1.02, 1.075))),
        Paint(TROUSERS, both(slab(1, -1, 0.862), slab(1, 0.106, 2, tilt=(0, 0, -0.35)))),
        Paint(SHOES, slab(1, -1, 0.106, tilt=(0, 0, -0.35))),
        Paint(SOLE, slab(1, -1, 0.026)),
        Paint(SOLE, both(slab(1, -1, 0.2), bump((0.136, 0.03, 0.165), (0.07, 0.05, 0.05), both_sides=True))),
    ]
    pieces = [
        clay(_body(), int(4300 * detail), HUMAN_BONES, SKIN, paints, half=True),
        clay(_hair(), int(900 * detail), HUMAN_BONES, HAIR),
        *face_pieces(),
    ]
    return assemble("person", pieces, HUMAN_BONES, rigged)
