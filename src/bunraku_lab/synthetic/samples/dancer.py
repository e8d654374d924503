"""A dancer with a flared skirt and a long ponytail."""

from __future__ import annotations

import numpy as np

from bunraku.core.character import Character
from bunraku_lab.synthetic.samples.assembly import Bones, Piece, assemble, clay, solid
from bunraku_lab.synthetic.samples.fields import Field, ball, bar, limb, mirrored
from bunraku_lab.synthetic.samples.paint import Paint, both, bump, either, slab
from bunraku_lab.synthetic.samples.person import HUMAN_BONES, arm_lumps, face_pieces, head_lumps
from bunraku_lab.synthetic.samples.surfaces import ring_mesh, sheet_mesh

__all__ = ["build"]

SKIN, DRESS, SASH, SHOES, HAIR, TRIM = "#c98a5e", "#c2366b", "#ffd166", "#8f2450", "#2b2130", "#ffe9d6"

_BONES: Bones = {
    **HUMAN_BONES,
    "Ponytail1": ("Head", (0, 1.60, -0.175)),
    "Ponytail2": ("Ponytail1", (0, 1.46, -0.275)),
    "Ponytail3": ("Ponytail2", (0, 1.28, -0.30)),
}


def _body() -> Field:
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


def _hair() -> Field:
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
    return [solid(outer, DRESS, weights(outer[0])), solid(under, TRIM, weights(under[0]))]


def build(detail: float, rigged: bool) -> Character:
    """See `bunraku_lab.synthetic.samples.make_sample`."""
    paints = [
        Paint(DRESS, both(slab(0, -0.16, 0.16), slab(1, 0.78, 1.125))),
        Paint(DRESS, both(slab(0, -0.118, 0.118), slab(1, 1.1, 1.3))),
        Paint(SKIN, bump((0, 1.265, 0.03), (0.082, 0.105, 0.14))),
        Paint(SHOES, both(slab(1, -1, 0.082), either(slab(1, -1, 0.034), slab(2, 0.055), slab(2, -1, -0.03)))),
    ]
    tie = np.array([[1, 0, 0], [0, 0.35, -0.94], [0, 0.94, 0.35]])
    pieces = [
        clay(_body(), int(3200 * detail), _BONES, SKIN, paints, half=True),
        clay(_hair(), int(700 * detail), _BONES, HAIR),
        clay(_ponytail(), int(500 * detail), _BONES, HAIR, softness=0.04, half=True),
        solid(ring_mesh((0, 1.605, -0.197), 0.032, 0.016, 18, 8, tie), SASH, "Ponytail1"),
        solid(ring_mesh((0, 0.945, 0), (0.122, 0.099), (0.014, 0.024), 40, 8), SASH, "Spine"),
        *_skirt(detail),
        *face_pieces("#241a22", HAIR, "#bd6c52", lashes=True),
    ]
    return assemble("dancer", pieces, _BONES, rigged)
