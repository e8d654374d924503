"""Dressed people for the Mesh Handle Predictor: MakeHuman bodies of every shape in random outfits and game styles."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from bunraku.core.body.layout import JOINT_NAMES, JOINT_PARENTS
from bunraku.core.character import Character, Rig, top_influences
from bunraku_lab.synthetic.dressed import extras
from bunraku_lab.synthetic.dressed.garments import BodyShape, Garment, Piece, Wardrobe, joined
from bunraku_lab.synthetic.makehuman import BODY_VERTICES, pose_points, random_body, random_rest
from bunraku_lab.synthetic.surfaces import nearest_shares

_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])


def melted(piece: Piece, solid: Piece, cell: float, thickness: float) -> Piece:
    """The outside of all points nearer to a mesh than `thickness`; weights are those of the nearest points.

    Args:
        piece: Everything that is seen, open and closed surfaces.
        solid: A closed surface whose inside is filled: the body.
        cell: Edge of the cubes [m].
        thickness: At least 0.6 cells, or holes appear [m].
    """
    import igl

    low = piece.points.min(axis=0) - thickness - 2 * cell
    size = np.ceil((piece.points.max(axis=0) + thickness + 2 * cell - low) / cell).astype(int) + 1
    near = np.zeros(size, bool)  # corners of cubes that the surface can cross
    corners = piece.points[piece.faces]
    steps = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1) / cell
    for count in range(1, int(min(steps.max(), 64)) + 2):
        some = corners[np.ceil(steps).clip(1, 65) == count]
        if len(some):
            a, b = np.meshgrid(np.linspace(0, 1, count + 1), np.linspace(0, 1, count + 1))
            shares = np.stack([1 - a, a * (1 - b), a * b], axis=-1).reshape(-1, 3)
            near[tuple(np.rint((np.einsum("kc,fca->fka", shares, some) - low) / cell).astype(int).reshape(-1, 3).T)] = (
                True
            )
    reach = int(np.ceil(thickness / cell)) + 1
    for axis in range(3):
        near = np.any([np.roll(near, shift, axis) for shift in range(-reach, reach + 1)], axis=0)
    number = np.argwhere(near)
    positions = number * cell + low
    distance = np.sqrt(igl.point_mesh_squared_distance(positions, piece.points, piece.faces)[0])
    inside = igl.fast_winding_number(solid.points, solid.faces, positions) > 0.5
    field = np.full(size, 1.0)
    field[tuple(number.T)] = np.where(inside, -distance, distance) - thickness
    whole = near[:-1, :-1, :-1].copy()
    for dx, dy, dz in _CORNERS[1:]:
        whole &= near[dx : dx + whole.shape[0], dy : dy + whole.shape[1], dz : dz + whole.shape[2]]
    cubes = np.argwhere(whole)
    index = np.ravel_multi_index((cubes[:, None] + _CORNERS).reshape(-1, 3).T, tuple(size))
    used, index = np.unique(index, return_inverse=True)
    grid = np.stack(np.unravel_index(used, tuple(size)), axis=1) * cell + low
    vertices, faces, _ = igl.marching_cubes(field.reshape(-1)[used], grid, index.reshape(-1, 8).astype(np.int64), 0.0)
    return _labelled(np.asarray(vertices), np.asarray(faces, np.int64), piece)


def simplified(piece: Piece, faces: int) -> Piece:
    """The mesh with at most so many triangles; weights are those of the nearest points."""
    import fast_simplification

    if faces >= len(piece.faces):
        return piece
    points, triangles = fast_simplification.simplify(
        piece.points.astype(np.float32), piece.faces.astype(np.int32), target_count=faces
    )
    if len(triangles) < 0.2 * faces:  # it collapsed
        return piece
    return _labelled(points.astype(np.float64), triangles.astype(np.int64), piece)


def _labelled(vertices: np.ndarray, faces: np.ndarray, piece: Piece) -> Piece:
    corners, shares = nearest_shares(vertices, piece.points, piece.faces)
    shares /= np.maximum(shares.sum(axis=1, keepdims=True), 1e-9)
    joints, handles = (np.einsum("vc,vck->vk", shares, weights[corners]) for weights in (piece.joints, piece.handles))
    return Piece(vertices, faces, joints, handles)


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
    """A random outfit: a suit of the archive, its parts mixed, garments of helper surfaces, or next to nothing."""
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


class Dressed:
    """A dressed character.

    Args:
        piece: Its mesh, all parts joined, with weights.
        joints: Joint positions [m], shape (22, 3).
        outfit: What it wears, for people to read.
        hangs: Which vertices are of skirts, capes, tails, ears and long hair, shape (V,), bool.
    """

    def __init__(self, piece: Piece, joints: np.ndarray, outfit: str, hangs: np.ndarray):
        self.piece, self.joints, self.outfit, self.hangs = piece, joints, outfit, hangs

    def character(self, name: str) -> Character:
        """As a character with the rig of the 22 joints."""
        indices, weights = top_influences(self.piece.joints, 4)
        transforms = np.tile(np.eye(4), (len(JOINT_NAMES), 1, 1))
        transforms[:, :3, 3] = self.joints
        rig = Rig(JOINT_NAMES, np.array(JOINT_PARENTS), transforms, indices, weights)
        return Character(name, self.piece.points.astype(np.float32), self.piece.faces, rig)


def dressed_person(wardrobe: Wardrobe, seed: tuple[int, ...] | int) -> Dressed:
    """A random person in random clothes; the same seed gives the same one.

    A fifth of them are melted into one closed surface, as scans are, and a fifth are simplified.
    """
    rng = np.random.default_rng(seed)
    vertices = wardrobe.body.shape(random_body(rng))
    figure = BodyShape(vertices, wardrobe.body.joints(vertices))
    outfit = random_outfit(wardrobe, figure, rng)
    skin = wardrobe.part(figure, "body")
    names, pieces = outfit.names, list(outfit.pieces)
    if rng.random() < 0.6 and outfit.hidden:
        seen = np.ones(len(vertices), bool)
        seen[covered_by(figure, outfit)] = False
        pieces.append(wardrobe.part(figure, "body", keep=seen))
        names.append("skin cut")
    else:
        pieces.append(skin)
    if rng.random() < 0.6:
        pieces.append(wardrobe.part(figure, "helper-l-eye", "helper-r-eye"))
    if rng.random() < 0.15:
        pieces.append(wardrobe.part(figure, "helper-upper-teeth", "helper-lower-teeth", "helper-tongue"))
    linear = random_rest(rng, figure.joints)
    whole = joined(pieces)
    hangs = np.zeros(len(whole.points), bool)
    worn = np.concatenate([*outfit.hangs, np.zeros(0, bool)])
    hangs[: len(worn)] = worn
    points, joints = pose_points(whole.points, figure.joints, whole.joints, linear)
    whole = Piece(points, whole.faces, whole.joints, whole.handles)
    plain = whole
    form = rng.choice(["plain", "melted", "low"], p=[0.6, 0.2, 0.2])
    if form == "melted":
        solid = Piece(
            pose_points(skin.points, figure.joints, skin.joints, linear)[0], skin.faces, skin.joints, skin.handles
        )
        cell = float(np.ptp(points[:, 1]) / rng.uniform(70, 130))
        whole = melted(whole, solid, cell, cell * float(rng.uniform(0.6, 1.0)))
    elif form == "low":
        whole = simplified(whole, int(rng.integers(1200, 6000)))
    if whole is not plain:
        hangs = hangs[cKDTree(plain.points).query(whole.points)[1]]
    return Dressed(whole, joints, ", ".join([*names, form]), hangs)


def covered_by(figure: BodyShape, outfit: Outfit) -> np.ndarray:
    """Vertices that the clothes hide and that lie near some of them."""
    hidden = np.unique(np.concatenate(outfit.hidden))
    reach = 0.025 * float(np.ptp(figure.vertices[:BODY_VERTICES, 1]))
    distance = cKDTree(np.concatenate([piece.points for piece in outfit.pieces])).query(
        figure.vertices[hidden], distance_upper_bound=reach
    )[0]
    return hidden[np.isfinite(distance)]
