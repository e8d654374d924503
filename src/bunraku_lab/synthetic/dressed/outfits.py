"""What a dressed character wears: random outfits from the archive's clothes, garments cut from the base mesh, and
extras.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bunraku.body.layout import JOINT_NAMES
from bunraku_lab.synthetic.dressed import extras
from bunraku_lab.synthetic.dressed.wardrobe import BodyShape, Garment, Piece, Wardrobe

__all__ = ["Outfit", "random_outfit"]

_J = {name: joint for joint, name in enumerate(JOINT_NAMES)}
_LEGS = [_J[f"{side}_{part}"] for side in ("left", "right") for part in ("hip", "knee", "ankle", "foot")]
_FOREARMS = [_J[f"{side}_{part}"] for side in ("left", "right") for part in ("elbow", "wrist")]
_ARMS = [*_FOREARMS, _J["left_shoulder"], _J["right_shoulder"]]
LONG = 0.03
"""Over the height: hair that reaches so far below the base of the skull swings."""


@dataclass
class Outfit:
    """Pieces on one body.

    Args:
        pieces: Without the body itself.
        hidden: Base vertices that the pieces cover, several arrays.
        names: What they are, for people to read.
        hangs: Which points of each piece would swing, shape (P,) each: skirts, capes, tails, ears and long hair.
    """

    pieces: list[Piece] = field(default_factory=list)
    hidden: list[np.ndarray] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    hangs: list[np.ndarray] = field(default_factory=list)

    def add(self, name: str, piece: Piece, hidden: np.ndarray | None = None, hangs: bool | np.ndarray = False) -> None:
        if len(piece.faces):
            self.pieces.append(piece)
            self.names.append(name)
            self.hangs.append(np.broadcast_to(hangs, len(piece.points)))
            if hidden is not None:
                self.hidden.append(hidden)


def random_outfit(wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> Outfit:
    """A random outfit: a suit of the archive, its parts mixed, garments made of the helper surfaces, or next to
    nothing.
    """
    outfit = Outfit()
    kind = rng.choice(["archive", "overall", "gown", "bare"], p=[0.73, 0.1, 0.1, 0.07])
    if kind == "overall" and wardrobe.whole:
        name, garment = _pick(wardrobe.whole, rng)
        piece = wardrobe.wear(garment, figure)
        hips = float(figure.joints[[_J["left_hip"], _J["right_hip"]], 1].mean())
        outfit.add(name, piece, garment.clothes.deleted, hangs=(piece.points[:, 1] < hips) & garment.skirt)
    elif kind == "gown":
        outfit.add("gown", _top(wardrobe, figure, rng))
        outfit.add(
            "long skirt", wardrobe.skirt(figure, float(rng.uniform(0.5, 2)), float(rng.uniform(0, 0.9))), hangs=True
        )
    elif kind != "bare":
        _two_parts(outfit, wardrobe, figure, rng)
    _hands_and_feet(outfit, wardrobe, figure, rng)
    if rng.random() < 0.1:
        _armour(outfit, wardrobe, figure, rng)
    _head(outfit, wardrobe, figure, rng)
    for rate, extra in (
        (0.1, extras.cape),
        (0.04, extras.wings),
        (0.06, extras.tail),
        (0.08, extras.bag),
        (0.06, extras.shoulder_pads),
    ):
        if rng.random() < rate:
            outfit.add(extra.__name__, extra(wardrobe, figure, rng), hangs=extra in (extras.cape, extras.tail))
    return outfit


def _pick(shelf: dict[str, Garment], rng: np.random.Generator) -> tuple[str, Garment]:
    name = str(rng.choice(sorted(shelf)))
    return name, shelf[name]


def _two_parts(outfit: Outfit, wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> None:
    legs = wardrobe.body.joint_weights[:, _LEGS].sum(axis=1) > 0.5
    name, garment = _pick(wardrobe.upper, rng)
    if rng.random() < 0.7:
        deleted = garment.clothes.deleted
        outfit.add(name, wardrobe.wear(garment, figure), deleted[~legs[deleted]])
    else:
        outfit.add("top", _top(wardrobe, figure, rng))
    choice = rng.choice(["same", "other", "trousers", "skirt"], p=[0.25, 0.3, 0.2, 0.25])
    if choice == "trousers":
        outfit.add("trousers", _trousers(wardrobe, figure, rng))
        return
    if choice == "skirt":
        length = float(rng.uniform(0.3, 2.0))
        wide = float(rng.choice([0.0, rng.uniform(0, 0.9)]))
        outfit.add(f"skirt {length:.1f}", wardrobe.skirt(figure, length, wide), hangs=True)
        return
    if choice == "other" or name not in wardrobe.lower:
        name = _pick(wardrobe.lower, rng)[0]
    garment = wardrobe.lower[name]
    deleted = garment.clothes.deleted
    outfit.add(
        name, wardrobe.wear(garment, figure), None if garment.skirt else deleted[legs[deleted]], hangs=garment.skirt
    )


def _top(wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> Piece:
    """The upper part of the tights with sleeves of any length, tight or wide."""
    tights = wardrobe.part(figure, "helper-tights")
    without = ([], _FOREARMS, _ARMS)[rng.choice(3, p=[0.5, 0.3, 0.2])]
    keep = tights.joints[:, _LEGS].sum(axis=1) < 0.4
    if without:
        keep &= tights.joints[:, without].sum(axis=1) < 0.5
    top = tights.cut(keep)
    wide = float(rng.choice([0.0, rng.uniform(0, 0.06)]))
    return top.puffed(rng.uniform(0.003, 0.02) + wide * top.joints[:, _FOREARMS].sum(axis=1))


def _trousers(wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> Piece:
    """The lower part of the tights: shorts, leggings, wide trousers."""
    tights = wardrobe.part(figure, "helper-tights")
    shins = [_J["left_knee"], _J["right_knee"]]
    keep = tights.joints[:, [0, *_LEGS]].sum(axis=1) > 0.5
    keep &= tights.joints[:, [_J["left_ankle"], _J["right_ankle"], _J["left_foot"], _J["right_foot"]]].sum(axis=1) < 0.5
    if rng.random() < 0.35:
        keep &= tights.joints[:, shins].sum(axis=1) < rng.uniform(0.2, 0.9)
    cut = tights.cut(keep)
    wide = float(rng.choice([0.0, rng.uniform(0, 0.05)]))
    return cut.puffed(rng.uniform(0.003, 0.025) + wide * cut.joints[:, shins].sum(axis=1))


def _hands_and_feet(outfit: Outfit, wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> None:
    chance = rng.random()
    if chance < 0.6 and wardrobe.shoes:
        name, garment = _pick(wardrobe.shoes, rng)
        outfit.add(name, wardrobe.wear(garment, figure), garment.clothes.deleted)
    elif chance < 0.85:
        shaft = wardrobe.body.joint_weights[:, 4:6].sum(axis=1) + wardrobe.body.joint_weights[:, [7, 8, 10, 11]].sum(
            axis=1
        )
        boots = wardrobe.part(figure, "helper-tights").puffed(rng.uniform(0.006, 0.03))
        knee, ankle = figure.joints[4, 1], figure.joints[7, 1]
        tights = np.unique(wardrobe.body.groups["helper-tights"])
        outfit.add(
            "boots",
            boots.cut((shaft[tights] > 0.5) & (boots.points[:, 1] < ankle + rng.uniform(0.15, 1) * (knee - ankle))),
        )
    if rng.random() < 0.15:
        outfit.add(
            "gloves", extras.shell(wardrobe, figure, "body", ("left_wrist", "right_wrist"), rng.uniform(0.002, 0.008))
        )


def _armour(outfit: Outfit, wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> None:
    thick = float(rng.uniform(0.015, 0.04))
    for rate, name, joints in (
        (0.8, "breastplate", ("spine1", "spine2", "spine3", "left_collar", "right_collar")),
        (0.6, "greaves", ("left_knee", "right_knee")),
        (0.6, "bracers", ("left_elbow", "right_elbow")),
    ):
        if rng.random() < rate:
            outfit.add(
                name, extras.shell(wardrobe, figure, "helper-tights", joints, thick, float(rng.uniform(0, 0.02)))
            )


def _head(outfit: Outfit, wardrobe: Wardrobe, figure: BodyShape, rng: np.random.Generator) -> None:
    if rng.random() < 0.07:
        outfit.add("helmet", extras.helmet(wardrobe, figure, rng))
        return
    chance = rng.random()
    if chance < 0.62 and wardrobe.hair:
        name, garment = _pick(wardrobe.hair, rng)
        hair = _trimmed(wardrobe.wear_on_head(garment, figure), figure, float(rng.uniform(0.3, 1.1)))
        below = figure.joints[_J["head"], 1] - LONG * float(np.ptp(figure.vertices[:, 1]))
        outfit.add(name, hair, hangs=bool((hair.points[:, 1] < below).any()))
    elif chance < 0.75:
        outfit.add("spikes", extras.spikes(wardrobe, figure, rng))
    chance = rng.random()
    if chance < 0.06 and wardrobe.hats:
        name, garment = _pick(wardrobe.hats, rng)
        outfit.add(name, wardrobe.wear_on_head(garment, figure))
    elif chance < 0.2:
        outfit.add("hat", extras.hat(wardrobe, figure, rng))
    elif chance < 0.29:
        outfit.add("ears", extras.ears(wardrobe, figure, rng), hangs=True)
    if rng.random() < 0.06:
        outfit.add("glasses", extras.glasses(wardrobe, figure, rng))


def _trimmed(hair: Piece, figure: BodyShape, length: float) -> Piece:
    """Hair whose part below the base of the skull is this much as long."""
    points = hair.points.copy()
    chin = figure.joints[_J["head"], 1]
    points[:, 1] = np.where(points[:, 1] < chin, chin + length * (points[:, 1] - chin), points[:, 1])
    return Piece(points, hair.faces, hair.joints, hair.handles)
