"""Pictures of how a character may stand."""

from __future__ import annotations

import numpy as np

from bunraku.core.character import Character
from bunraku.geometry.axes import ORIENTATIONS
from bunraku.render.frames import render_still
from bunraku.render.sheets import assemble

__all__ = ["orientation_views"]

SIZE = (320, 360)


def orientation_views(character: Character, count: int = 4) -> np.ndarray:
    """The likeliest ways in which a character may stand, side by side: the right one stands upright and faces the
    viewer. Each is labelled with the options that say it, and with how sure it is.

    Args:
        character: As its file has it.
        count: How many, 1 to 24.

    Returns:
        The picture, shape (H, W, 3), uint8.

    Raises:
        WeightsError: The weights of the orientation network are missing or broken.
        MissingExtraError: Pillow is not installed.
    """
    from bunraku.formats.gltf.turning import turned
    from bunraku.handles.orientation import guess_orientation

    guess = guess_orientation(character)
    likely = np.argsort(-guess.probabilities)[:count]
    pictures = [render_still(turned(character, *ORIENTATIONS[n]), size=SIZE, yaw=0.2) for n in likely]
    labels = [
        f"--up {ORIENTATIONS[n][0]} --front {ORIENTATIONS[n][1]} ({100 * min(guess.probabilities[n], 0.99):.0f} %)"
        for n in likely
    ]
    return assemble(pictures, labels, columns=count)
