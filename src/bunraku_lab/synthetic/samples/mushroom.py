"""A walking mushroom: a spotted cap on a stem with two short arms and two short legs."""

from __future__ import annotations

import numpy as np

from bunraku.core.character import Character
from bunraku_lab.synthetic.samples.assembly import Bones, assemble, clay, mirror_bones, mirror_piece
from bunraku_lab.synthetic.samples.features import button, eye, stroke
from bunraku_lab.synthetic.samples.fields import Field, ball, bar, limb, mirrored
from bunraku_lab.synthetic.samples.paint import Paint, bump, either, slab

__all__ = ["build"]

STEM, BLUSH, CAP, SPOT, GILLS, FEET = "#f6e3c5", "#f0a284", "#d8342f", "#fff6e6", "#e9c9a0", "#a4683c"

_BONES: Bones = mirror_bones(
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

_CAP_CENTRE, _CAP_RADII = np.array([0, 0.76, 0]), np.array([0.395, 0.30, 0.385])
_SPOTS = (
    (0, 0.75, 0.62, 0.075), (0.57, 0.47, 0.66, 0.062), (0.91, 0.13, 0.08, 0.07), (0.48, 0.85, 0, 0.064), (0.6, 0.45,
    -0.66, 0.068),
    (0, 0.68, -0.72, 0.078), (0.26, 0.13, 0.97, 0.05), (0.84, 0.10, -0.54, 0.046), (0.85, 0.05, 0.53, 0.046),
)  # fmt: skip


def _spots() -> list[tuple[np.ndarray, float]]:
    """Place on the cap and radius of the spots of one side [m]."""
    return [(_CAP_CENTRE + _CAP_RADII * np.array(spot[:3]) / np.linalg.norm(spot[:3]), spot[3]) for spot in _SPOTS]


def _field() -> Field:
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


def build(detail: float, rigged: bool) -> Character:
    """See `bunraku_lab.synthetic.samples.make_sample`."""
    rim = slab(1, 0.665)

    def gills(points: np.ndarray) -> np.ndarray:
        # the underside: below the cap's widest line and away from the stem
        out = np.hypot(points[:, 0], points[:, 2])
        return np.minimum(np.minimum(out - 0.185, points[:, 1] - 0.53), 0.665 - points[:, 1])

    paints = [
        Paint(CAP, rim),
        Paint(SPOT, either(*(bump(spot, radius, both_sides=True) for spot, radius in _spots()))),
        Paint(GILLS, gills),
        Paint(FEET, slab(1, -1, 0.115)),
    ]
    field = _field()
    across = np.linspace(-1, 1, 11)
    smile = np.stack([0.04 * across, 0.468 + 0.018 * across**2, np.full(11, 0.18)], axis=1)
    left = [
        *eye(field, (0.066, 0.54, 0.16), (0.027, 0.039), "#2a1c18", "Head"),
        button(field, (0.112, 0.482, 0.13), (0.028, 0.019, 0.005), BLUSH, "Head"),
    ]
    pieces = [
        clay(field, int(5000 * detail), _BONES, STEM, paints, half=True, softness=0.03, crease=0.025),
        *left,
        *(mirror_piece(piece) for piece in left),
        stroke(field, smile, 0.0075 - 0.003 * across**2, "#7a3b30", "Head"),
    ]
    return assemble("mushroom", pieces, _BONES, rigged)
