"""Clothes that lie on the body: tops, sleeves, trousers, stockings, shoes and gloves, cut from its skin at the same
places on any body.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from bunraku_lab.synthetic.people.figure import Figure, Skin
from bunraku_lab.synthetic.wardrobe.kit.model import Costume
from bunraku_lab.synthetic.wardrobe.kit.skeleton import body_weights

__all__ = ["Outfit", "add_clothed_body", "collar_field"]

Field = Callable[[Skin], np.ndarray]


@dataclass(frozen=True)
class Outfit:
    """What lies on the body; lengths count as `Skin.reach` and `Skin.rise` do.

    Args:
        low: Rise of the top's hem, or None without a top.
        neck: Rise of the neckline.
        strapless: Whether nothing is on the shoulders.
        sleeve: Reach of the sleeves.
        legs: Rise where trousers end, or None without.
        socks: Rise where stockings end, or None.
        shoes: Rise where shoes or boots end, or None.
        gloves: Reach where gloves begin, or None.
    """

    low: float | None
    neck: float
    strapless: bool
    sleeve: float
    legs: float | None
    socks: float | None
    shoes: float | None
    gloves: float | None

    def pieces(self) -> list[tuple[str, float, list[Field]]]:
        """Its pieces, those on top first: what it is, how thick over others, and the fields that are positive inside of
        its borders.
        """
        out: list[tuple[str, float, list[Field]]] = []
        if self.gloves is not None:
            gloves = self.gloves
            out.append(("gloves", 0.5, [lambda s: s.reach - gloves]))
        if self.shoes is not None:
            shoes = self.shoes
            out.append(("shoes", 1.3, [lambda s: shoes - s.rise]))
        if self.low is not None:
            low = self.low
            top: list[Field] = [lambda s: s.rise - low, lambda s: self.sleeve - s.reach]
            top += [lambda s: 4.35 - s.rise] if self.strapless else [lambda s: collar_field(s, self.neck)]
            out.append(("top", 1.0, top))
        if self.legs is not None:
            legs = self.legs
            out.append(("legs", 0.8, [lambda s: s.rise - legs, lambda s: 3.05 - s.rise]))
        if self.socks is not None:
            socks = self.socks
            out.append(("socks", 0.35, [lambda s: socks - s.rise]))
        return out


def collar_field(skin: Skin, neck: float) -> np.ndarray:
    """Positive below a neckline that is lower in front than behind."""
    return np.asarray(neck - skin.rise - 4.0 * np.maximum(skin.depth, 0) * np.clip(1.2 - 1.5 * skin.reach, 0, 1))


def add_clothed_body(
    costume: Costume, figure: Figure, outfit: Outfit, thick: float, *, form: str, under: np.ndarray | None = None
) -> None:
    """Add the skin and the clothes that lie on it.

    Args:
        costume: What they are added to; its materials are "skin" and the words for the pieces.
        figure: The body.
        outfit: The clothes.
        thick: How far they stand off [m].
        form: "over": the clothes are loose surfaces over a whole body; "cut": the body is left out well inside of them;
            "painted": they are its own skin in other colours, one welded surface.
        under: Points of garments that the skin draws back from [m], shape (P, 3).
    """
    skin, pieces = figure.skin, outfit.pieces()
    if under is not None and len(under):
        skin = replace(
            skin,
            points=skin.points
            - skin.normals * (thick * np.clip(2 - cKDTree(under).query(skin.points)[0] / thick, 0, 1))[:, None],
        )
    if form == "painted":
        _painted(costume, skin, pieces)
        return
    deep = np.full(len(skin.points), -1.0)
    for what, over, fields in pieces:
        piece = skin
        for field in fields:
            piece = piece.above(field(piece)) if len(piece.faces) else piece
        if len(piece.faces):
            bones, shares = body_weights(costume, piece.weights)
            costume.add(piece.puffed(over * thick).points, piece.faces, bones, shares, what)
            deep = np.maximum(deep, np.min([field(skin) for field in fields], axis=0))
    if form == "cut":
        skin = skin.kept(~(deep[skin.faces] > 0.12).all(axis=1))
    bones, shares = body_weights(costume, skin.weights)
    costume.add(skin.points, skin.faces, bones, shares, "skin")


def _painted(costume: Costume, skin: Skin, pieces: list[tuple[str, float, list[Field]]]) -> None:
    """The skin taken apart along the borders of the pieces, and put together again with a material each."""
    rest, found = [skin], []
    for what, _, fields in pieces:
        inside, outside = rest, []
        for field in fields:
            parts = [(part.above(field(part)), part.below(field(part))) for part in inside if len(part.faces)]
            outside += [low for _, low in parts if len(low.faces)]
            inside = [high for high, _ in parts if len(high.faces)]
        found += [(what, part) for part in inside]
        rest = outside
    found += [("skin", part) for part in rest]
    starts = np.cumsum([0, *(len(part.points) for _, part in found)])
    points = np.concatenate([part.points for _, part in found])
    weights = np.concatenate([part.weights for _, part in found])
    faces = np.concatenate([part.faces + start for (_, part), start in zip(found, starts, strict=False)])
    materials = np.concatenate([np.full(len(part.faces), what) for what, part in found])
    _, first, where = np.unique(np.round(points, 6), axis=0, return_index=True, return_inverse=True)
    faces = where.reshape(-1)[faces]
    good = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    bones, shares = body_weights(costume, weights[first])
    costume.add(points[first], faces[good], bones, shares, materials[good])
