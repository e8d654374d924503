"""The sample characters on two legs: a young person, a dancer with skirt and ponytail, and a tin robot."""

from __future__ import annotations

import numpy as np

from bunraku.core.character import Character
from bunraku_lab.synthetic.fields import Field, Lump, ball, bar, limb, mirrored
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
from bunraku_lab.synthetic.surfaces import ball_mesh, box_mesh, cylinder_mesh, ring_mesh, sheet_mesh

__all__ = ["HUMAN_BONES", "arm_lumps", "build_dancer", "build_person", "build_robot", "face_pieces", "head_lumps"]

PERSON_SKIN, SHIRT, STRIPE, TROUSERS, PERSON_SHOES, SOLE, PERSON_HAIR = (
    "#f2b48c", "#1fa3a0", "#fff4dc", "#34457a", "#e4573d", "#fbf6ec", "#5a3422",
)  # fmt: skip

# Modelled by eye.
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


def face_pieces(
    iris: str = "#2b1a14", brow: str = PERSON_HAIR, blush: str = "#ee9a7c", lashes: bool = False
) -> list[Piece]:
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


def _person_body() -> Field:
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


def _person_hair() -> Field:
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


def build_person(detail: float, rigged: bool) -> Character:
    """See `bunraku_lab.synthetic.samples.make_sample`."""
    paints = [
        Paint(SHIRT, both(slab(0, -0.348, 0.348), slab(1, 0.862, 1.3))),
        Paint(PERSON_SKIN, bump((0, 1.275, 0.005), (0.088, 0.062, 0.1))),
        Paint(STRIPE, both(slab(0, -0.2, 0.2), slab(1, 1.02, 1.075))),
        Paint(TROUSERS, both(slab(1, -1, 0.862), slab(1, 0.106, 2, tilt=(0, 0, -0.35)))),
        Paint(PERSON_SHOES, slab(1, -1, 0.106, tilt=(0, 0, -0.35))),
        Paint(SOLE, slab(1, -1, 0.026)),
        Paint(SOLE, both(slab(1, -1, 0.2), bump((0.136, 0.03, 0.165), (0.07, 0.05, 0.05), both_sides=True))),
    ]
    pieces = [
        clay(_person_body(), int(4300 * detail), HUMAN_BONES, PERSON_SKIN, paints, half=True),
        clay(_person_hair(), int(900 * detail), HUMAN_BONES, PERSON_HAIR),
        *face_pieces(),
    ]
    return assemble("person", pieces, HUMAN_BONES, rigged)


DANCER_SKIN, DRESS, SASH, DANCER_SHOES, DANCER_HAIR, DRESS_TRIM = (
    "#c98a5e", "#c2366b", "#ffd166", "#8f2450", "#2b2130", "#ffe9d6",
)  # fmt: skip

# Modelled by eye.
_DANCER_BONES: Bones = {
    **HUMAN_BONES, "Ponytail1": ("Head", (0, 1.60, -0.175)), "Ponytail2": ("Ponytail1", (0, 1.46, -0.275)),
    "Ponytail3": ("Ponytail2", (0, 1.28, -0.30)),
}  # fmt: skip


def _dancer_body() -> Field:
    legs = mirrored(
        [
            *limb([(0.086, 0.80, 0), (0.10, 0.44, 0.01)], [0.078, 0.053], "LeftUpLeg", blend=0.02),
            *limb(
                [(0.10, 0.44, 0.01), (0.107, 0.30, -0.005), (0.112, 0.08, -0.015)],
                [0.053, 0.051, 0.036],
                "LeftLeg",
                blend=0.006,
            ),
            bar((0.112, 0.04, -0.03), (0.124, 0.032, 0.08), (0.042, 0.042), "LeftFoot", blend=0.02),
            bar((0.124, 0.03, 0.08), (0.128, 0.026, 0.118), (0.042, 0.03), "LeftToeBase", blend=0.012),
        ]
    )
    torso = [
        ball((0, 0.85, 0), (0.142, 0.105, 0.11), "Hips", blend=0.03),
        bar((0, 0.92, 0), (0, 1.0, 0), (0.118, 0.116), "Spine", stretch=(1, 1, 0.8), blend=0.04),
        bar((0, 1.06, 0), (0, 1.13, 0), (0.136, 0.132), "Chest", stretch=(1.02, 0.8, 0.8), blend=0.05),
        *mirrored([ball((0.058, 1.09, 0.07), (0.056, 0.05, 0.05), "Chest", blend=0.04)]),
    ]
    return Field([*torso, *arm_lumps(0.044, 0.036, 0.0), *legs, *head_lumps()], floor=0.0)


def _dancer_hair() -> Field:
    cap = [
        ball((0, 1.50, -0.018), (0.170, 0.168, 0.168), "Head"),
        bar(
            (-0.20, 1.395, 0.155), (0.20, 1.395, 0.155), 0.125, "Head", stretch=(1, 1.15, 1.15), blend=0.02, carve=True
        ),
        ball((0, 1.42, -0.085), (0.128, 0.095, 0.085), "Head", blend=0.03),
        ball((0, 1.605, -0.15), (0.05, 0.05, 0.05), "Head", blend=0.03),
    ]
    fringe = [
        bar((0.015, 1.645, 0.085), (0.115, 1.565, 0.115), (0.045, 0.03), "Head", blend=0.02),
        bar((0.115, 1.565, 0.115), (0.157, 1.46, 0.058), (0.03, 0.012), "Head", blend=0.01),
        bar((0.005, 1.645, 0.085), (-0.095, 1.575, 0.125), (0.045, 0.034), "Head", blend=0.012),
        bar((-0.095, 1.575, 0.125), (-0.155, 1.46, 0.06), (0.034, 0.012), "Head", blend=0.01),
    ]
    return Field([*cap, *fringe])


def _ponytail() -> Field:
    return Field(
        [
            *limb(
                [(0, 1.605, -0.19), (0, 1.575, -0.265), (0, 1.46, -0.305)],
                [0.032, 0.062, 0.078],
                "Ponytail1",
                inner=0.02,
                bends=3,
            ),
            *limb([(0, 1.46, -0.305), (0, 1.28, -0.285)], [0.078, 0.07], "Ponytail2", blend=0.03),
            *limb(
                [(0, 1.28, -0.285), (0, 1.12, -0.275), (0, 1.0, -0.335), (0, 0.985, -0.38)],
                [0.07, 0.055, 0.026, 0.008],
                "Ponytail3",
                blend=0.03,
                inner=0.02,
                bends=2,
            ),
            *mirrored([bar((0.035, 1.32, -0.275), (0.05, 1.09, -0.32), (0.042, 0.008), "Ponytail3", blend=0.012)]),
        ]
    )


def _skirt(detail: float) -> list[Piece]:
    """A bell of two layers with soft folds, hung from the waist; the hips carry it and the legs push it."""
    fine = float(np.sqrt(detail))

    def fold(radius: np.ndarray, angle: np.ndarray, down: np.ndarray) -> np.ndarray:
        wave = 1 + 0.085 * down**1.3 * np.cos(9 * angle)
        depth = 0.80 + 0.20 * np.minimum(2 * down, 1)
        lift = 0.016 * down**2 * np.cos(9 * angle)
        return np.stack([radius * wave * np.sin(angle), lift, radius * wave * depth * np.cos(angle)], axis=-1)

    def weights(vertices: np.ndarray) -> dict[str, np.ndarray]:
        down = np.clip((0.86 - vertices[:, 1]) / 0.34, 0, 1)
        legs = 0.65 * down * down * (3 - 2 * down)
        left = 0.5 + 0.5 * np.tanh(vertices[:, 0] / 0.12)
        return {"Hips": 1 - legs, "LeftUpLeg": legs * left, "RightUpLeg": legs * (1 - left)}

    share = np.linspace(0, 1, int(12 * fine))
    radius = 0.126 + 0.285 * share**0.85
    outer = sheet_mesh(np.stack([radius, 0.945 - 0.43 * share**1.12], axis=1), 0.007, 2 * int(31 * fine), fold)
    share = share[int(6 * fine) :]
    under = sheet_mesh(
        np.stack([0.110 + 0.285 * share**0.85, 0.935 - 0.455 * share**1.12], axis=1), 0.006, 2 * int(26 * fine), fold
    )
    return [solid(outer, DRESS, weights(outer[0])), solid(under, DRESS_TRIM, weights(under[0]))]


def build_dancer(detail: float, rigged: bool) -> Character:
    """See `bunraku_lab.synthetic.samples.make_sample`."""
    paints = [
        Paint(DRESS, both(slab(0, -0.16, 0.16), slab(1, 0.78, 1.125))),
        Paint(DRESS, both(slab(0, -0.118, 0.118), slab(1, 1.1, 1.3))),
        Paint(DANCER_SKIN, bump((0, 1.265, 0.03), (0.082, 0.105, 0.14))),
        Paint(DANCER_SHOES, both(slab(1, -1, 0.082), either(slab(1, -1, 0.034), slab(2, 0.055), slab(2, -1, -0.03)))),
    ]
    tie = np.array([[1, 0, 0], [0, 0.35, -0.94], [0, 0.94, 0.35]])
    pieces = [
        clay(_dancer_body(), int(3200 * detail), _DANCER_BONES, DANCER_SKIN, paints, half=True),
        clay(_dancer_hair(), int(700 * detail), _DANCER_BONES, DANCER_HAIR),
        clay(_ponytail(), int(500 * detail), _DANCER_BONES, DANCER_HAIR, softness=0.04, half=True),
        solid(ring_mesh((0, 1.605, -0.197), 0.032, 0.016, 18, 8, tie), SASH, "Ponytail1"),
        solid(ring_mesh((0, 0.945, 0), (0.122, 0.099), (0.014, 0.024), 40, 8), SASH, "Spine"),
        *_skirt(detail),
        *face_pieces("#241a22", DANCER_HAIR, "#bd6c52", lashes=True),
    ]
    return assemble("dancer", pieces, _DANCER_BONES, rigged)


SHELL, DARK, ROBOT_TRIM, LIGHT, GLOW, WARN = "#f4b740", "#3b4252", "#e9ecef", "#8d99ae", "#5ef0e0", "#ef5b4c"

Position = tuple[float, float, float]

# Modelled by eye.
_ROBOT_BONES: Bones = mirror_bones(
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


def build_robot(detail: float, rigged: bool) -> Character:
    """See `bunraku_lab.synthetic.samples.make_sample`."""
    cells = 0.07 / float(np.sqrt(detail))
    around = 2 * int(7 * np.sqrt(detail) + 0.5)
    level = 1 if detail < 0.7 else 2 if detail < 2.5 else 3
    facing = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    sideways = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])

    def block(
        color: str, joint: str, centre: Position, size: Position, bevel: float = 0.014, taper: float = 1
    ) -> Piece:
        return solid(box_mesh(centre, size, bevel, cells, taper=taper), color, joint)

    def rod(
        color: str, joint: str, start: Position, end: Position, r0: float, r1: float, bevel: float = 0.006
    ) -> Piece:
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
        block(ROBOT_TRIM, "Chest", (0.045, 1.048, 0.148), (0.06, 0.022, 0.014), 0.004),
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
    return assemble("robot", [*middle, *left, *(mirror_piece(piece) for piece in left)], _ROBOT_BONES, rigged)
