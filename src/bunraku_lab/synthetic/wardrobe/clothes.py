"""What lies on the body of a wardrobe character: clothes cut from its skin, a drawn face, and colours."""

from __future__ import annotations

import colorsys
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from bunraku_lab.synthetic.figures import Figure, Skin
from bunraku_lab.synthetic.surfaces import patch
from bunraku_lab.synthetic.wardrobe.model import Costume, body_weights

_SKINS = (
    (255, 226, 205), (250, 214, 188), (240, 196, 164), (224, 172, 136), (198, 140, 104), (150, 100, 70), (104, 68, 48),
)  # fmt: skip
_HAIRS = (
    (38, 32, 34), (66, 44, 34), (112, 72, 44), (158, 104, 58), (226, 190, 120), (242, 224, 176), (196, 84, 48), (150,
    40, 44), (222, 224, 232),
    (128, 134, 150), (240, 150, 176), (92, 160, 210), (60, 84, 150), (110, 180, 150), (150, 110, 190), (96, 50, 90),
)  # fmt: skip


def _hsv(hue: float, saturation: float, value: float) -> np.ndarray:
    return np.array(colorsys.hsv_to_rgb(hue % 1, saturation, value))


def random_colors(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """sRGB of each material, 0 to 1, shape (3,): a main colour, one near or opposite to it, and quiet ones."""
    u = rng.uniform
    skin = np.array(_SKINS[rng.choice(len(_SKINS), p=[0.26, 0.24, 0.16, 0.12, 0.1, 0.07, 0.05])]) / 255
    hair = np.clip(np.array(_HAIRS[rng.integers(len(_HAIRS))]) / 255 * u(0.88, 1.08), 0, 1)
    hue = float(u(0, 1))
    other = hue + float(rng.choice([0.5, 0.08, -0.08, 0.33, 0.17]))
    dark, pale = _hsv(hue, u(0.15, 0.6), u(0.16, 0.34)), _hsv(hue, u(0.0, 0.14), u(0.88, 0.97))
    main = {0: _hsv(hue, u(0.4, 0.75), u(0.5, 0.9)), 1: _hsv(hue, u(0.15, 0.4), u(0.75, 0.95)), 2: dark}[
        int(rng.choice(3, p=[0.55, 0.25, 0.2]))
    ]
    accent = _hsv(other, u(0.3, 0.7), u(0.6, 0.95))
    quiet = pale if rng.random() < 0.55 else dark
    return {
        "skin": skin, "hair": hair, "hair tie": accent, "brow": hair * 0.7, "lashes": np.array([0.14, 0.1, 0.12]),
        "eye white": np.array([0.97, 0.97, 0.98]),
        "iris": _hsv(float(u(0, 1)), u(0.5, 0.85), u(0.45, 0.8)), "pupil": np.array([0.07, 0.06, 0.1]),
        "eye light": np.array([1.0, 1, 1]),
        "mouth": skin * [0.72, 0.42, 0.42], "cloth": main, "trim": accent, "top": quiet if rng.random() < 0.5 else main,
        "legs": dark if rng.random() < 0.6 else _hsv(other, u(0.1, 0.5), u(0.25, 0.7)), "socks": (pale, dark,
        accent)[rng.integers(3)],
        "shoes": (dark * 0.8, _hsv(0.07, u(0.4, 0.7), u(0.2, 0.5)), accent * 0.7)[rng.integers(3)],
        "gloves": quiet, "mantle": (main * 0.8, accent, dark)[rng.integers(3)],
        "lining": accent * 0.65 if rng.random() < 0.5 else pale, "fur": np.clip(hair * u(0.9, 1.1), 0, 1),
        "fur tip": pale,
    }  # fmt: skip


class _Front:
    """The front of the head as a height over X and Y."""

    def __init__(self, figure: Figure):
        skin = figure.skin
        inside = np.isin(skin.faces, np.flatnonzero(skin.weights[:, 15] > 0.5)).all(axis=1)
        corners = skin.points[skin.faces[inside]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        middle = figure.skull[0][2]
        self.corners = corners[(normal[:, 2] > 0) & (corners[:, :, 2].mean(axis=1) > middle)]

    def at(self, positions: np.ndarray) -> np.ndarray:
        """Z of the skin at X and Y, shape (V,)."""
        a, b, c = (self.corners[:, i] for i in range(3))
        u, v = (b - a)[:, :2], (c - a)[:, :2]
        det = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        det = np.where(np.abs(det) < 1e-12, 1e-12, det)
        w = positions[:, None, :] - a[None, :, :2]
        s = (w[..., 0] * v[:, 1] - w[..., 1] * v[:, 0]) / det
        t = (u[:, 0] * w[..., 1] - u[:, 1] * w[..., 0]) / det
        depth = a[None, :, 2] + s * (b - a)[None, :, 2] + t * (c - a)[None, :, 2]
        inside = (s >= -1e-6) & (t >= -1e-6) & (s + t <= 1 + 1e-6)
        found = np.where(inside, depth, -np.inf).max(axis=1)
        near = np.argmin(np.square(positions[:, None] - self.corners.mean(axis=1)[None, :, :2]).sum(axis=2), axis=1)
        return np.asarray(np.where(np.isfinite(found), found, self.corners[near].mean(axis=1)[:, 2]))


def add_face(costume: Costume, figure: Figure, rng: np.random.Generator) -> None:
    """Add eyes of an iris and a pupil with a light in it, lashes, brows and a mouth; all go with the head."""
    front, bone, u = _Front(figure), costume.bone_index("頭"), rng.uniform
    low, top = float(figure.head[:, 1].min()), float(figure.head[:, 1].max())
    wide = float(figure.skull[1][0])
    drawn = figure.kind in ("drawn", "chibi", "toon")
    size = wide * (u(0.22, 0.3) if drawn else u(0.17, 0.21))
    tall = size * (u(1.0, 1.45) if drawn else u(0.62, 0.8))
    height = low + (u(0.42, 0.46) if drawn else u(0.47, 0.5)) * (top - low)
    apart = wide * (u(0.4, 0.47) if drawn else u(0.38, 0.42))
    if figure.eyes is not None:
        apart, height = float(abs(figure.eyes[0, 0])), float(figure.eyes[0, 1])
    shape = float(u(2.0, 3.0))
    level = 0.01 * wide

    def lay(
        points: np.ndarray, faces: np.ndarray, center: tuple[float, float], step: int, material: str, bulge: float = 0.0
    ) -> None:
        positions = points + center
        z = front.at(positions)
        ahead = front.at(np.array([center]))[0]
        z = np.maximum(z, ahead - 0.25 * size) if bulge else z
        costume.add(np.column_stack([positions, z + level * (1 + 0.7 * step) + 0.002]), faces, bone, 1, material)

    slant = float(u(-0.08, 0.12))
    for side in (1, -1):
        at = (side * apart, height)
        tilt = np.array([[1, slant * side], [0, 1]])

        def oval(
            rings: int, around: int, half: tuple[float, float], square: float = shape, tilt: np.ndarray = tilt
        ) -> tuple[np.ndarray, np.ndarray]:
            points, faces = patch(rings, around, half, squareness=square)
            return points @ tilt, faces

        lay(*oval(3, 20, (size, tall)), at, 0, "eye white", 1)
        lay(*oval(3, 18, (0.62 * size, 0.86 * tall), 2.2), (at[0], at[1] - 0.04 * tall), 1, "iris", 1)
        lay(*oval(2, 14, (0.3 * size, 0.45 * tall), 2.0), (at[0], at[1] - 0.02 * tall), 2, "pupil", 1)
        lay(*oval(2, 10, (0.17 * size, 0.2 * tall), 2.0), (at[0] + 0.2 * size, at[1] + 0.4 * tall), 3, "eye light", 1)
        lash, faces = _arc(size * 1.12, tall * 1.02, 0.2 * tall, side)
        lay(lash @ tilt, faces, at, 3, "lashes", 1)
        brow, faces = _arc(size * 0.95, 0.35 * tall, 0.09 * tall, side)
        lay(brow @ tilt, faces, (at[0], height + 1.25 * tall), 2, "brow", 1)
    mouth, faces = _arc(0.28 * wide * u(0.6, 1.1), -0.07 * wide * u(0.3, 1.6), 0.035 * wide, 0)
    lay(mouth, faces, (0.0, low + 0.19 * (top - low)), 1, "mouth")


def _arc(half: float, rise: float, thick: float, side: int) -> tuple[np.ndarray, np.ndarray]:
    """A bow over the top of an ellipse, thicker in the middle, shape (V, 2), and its faces."""
    t = np.linspace(-1, 1, 13)
    high = rise * np.sqrt(np.maximum(1 - 0.92 * t**2, 0.0))
    deep = thick * (1 - 0.8 * np.abs(t) ** 2) * (1 + 0.4 * t * np.sign(side))
    upper, lower = np.column_stack([half * t, high + 0.5 * deep]), np.column_stack([half * t, high - 0.5 * deep])
    a = np.arange(12)
    faces = np.concatenate([np.stack([a + 13, a + 14, a + 1], axis=1), np.stack([a + 13, a + 1, a], axis=1)])
    return np.concatenate([upper, lower]), faces


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
        """Its pieces, those on top first: what it is, how thick over others, and fields that are positive inside."""
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
