"""What body and apparel module say of a whole mesh, put together: tile(A, B) of section 4.4."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.displacement.player import ApparelPlayer
from bunraku.apparel.displacement.weights import DisplacementNetwork
from bunraku.apparel.fitting import fitted_clothes
from bunraku.apparel.segmentation.predict import find_apparel
from bunraku.apparel.skinning import eq4_transforms
from bunraku.core.skinning import skin
from bunraku_lab.training.apparel.networks.body_predict import body_weights

__all__ = ["clothed_by_mask", "tiled"]


def clothed_by_mask(
    true: ClothedCharacter, masks: Path | None = None, body: Path | None = None
) -> tuple[ClothedCharacter, np.ndarray]:
    """A character as the networks alone see it, and the weights that the body network gives all vertices, shape (V,
    22); of its own only mesh and joints are used.

    Args:
        true: The character.
        masks: Segmentation network; the shipped one when not given.
        body: Body network; the shipped one when not given.

    Raises:
        WeightsError: A network is missing or broken.
    """
    weights = body_weights(true.rest, true.faces, true.joints, body)
    found = find_apparel(true.rest, true.faces, true.joints, masks)
    guessed = fitted_clothes(true.rest, true.faces, true.joints, weights, found.mask, found.stiffness, found.damping)
    return guessed, weights


def tiled(
    clothed: ClothedCharacter, transforms: np.ndarray, network: DisplacementNetwork, frames: np.ndarray
) -> np.ndarray:
    """All vertices in some frames of a clip at 30 frames a second that begins from rest [m], shape (F, V, 3), float32.

    Args:
        clothed: The character.
        transforms: `[R | t]` of the joints, shape (N, 22, 3, 4).
        network: Of the displacement.
        frames: Which frames, rising, shape (F,).
    """
    affine = eq4_transforms(transforms[frames], clothed.joints)
    moved = np.array(skin(clothed.rest, clothed.weights, affine), np.float32)
    if clothed.apparel.any():
        player = ApparelPlayer(clothed, network)
        player.start(transforms[0])
        rows = {int(frame): row for row, frame in enumerate(frames)}
        for frame, pose in enumerate(transforms[: int(frames[-1]) + 1]):
            points = player.advance(pose)
            if frame in rows:
                moved[rows[frame], player.carrier.vertices] = points
    return moved
