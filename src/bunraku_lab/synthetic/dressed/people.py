"""Dressed people for the Mesh Handle Predictor: MakeHuman bodies of every shape, in MakeHuman's clothes, in game
proportions.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from bunraku.body.layout import JOINT_NAMES, JOINT_PARENTS
from bunraku.core.character import Character, Rig, top_influences
from bunraku_lab.synthetic.dressed.outfits import Outfit, random_outfit
from bunraku_lab.synthetic.dressed.surfaces import melted, simplified
from bunraku_lab.synthetic.dressed.wardrobe import BodyShape, Piece, Wardrobe, joined
from bunraku_lab.synthetic.people.makehuman import BODY_VERTICES, pose_points
from bunraku_lab.synthetic.people.proportions import random_body, random_rest

__all__ = ["Dressed", "dressed_person"]


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

    A fifth of them are melted into one closed surface, as scans are, and a fifth are simplified to a game's few
    triangles.
    """
    rng = np.random.default_rng(seed)
    vertices = wardrobe.body.shape(random_body(rng))
    figure = BodyShape(vertices, wardrobe.body.joints(vertices))
    outfit = random_outfit(wardrobe, figure, rng)
    skin = wardrobe.part(figure, "body")
    names, pieces = outfit.names, list(outfit.pieces)
    if rng.random() < 0.6 and outfit.hidden:
        seen = np.ones(len(vertices), bool)
        seen[_covered(figure, outfit)] = False
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


def _covered(figure: BodyShape, outfit: Outfit) -> np.ndarray:
    """Base vertices that the clothes hide and that are near some of them: garments of an archive expect others beside
    them.
    """
    hidden = np.unique(np.concatenate(outfit.hidden))
    reach = 0.025 * float(np.ptp(figure.vertices[:BODY_VERTICES, 1]))
    distance = cKDTree(np.concatenate([piece.points for piece in outfit.pieces])).query(
        figure.vertices[hidden], distance_upper_bound=reach
    )[0]
    return hidden[np.isfinite(distance)]
