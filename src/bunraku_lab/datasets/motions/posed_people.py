"""Dressed people in the poses of captured clips: sitting, crouching, in mid-step, as statues and pictures show people.

A pose is kept as it is but for its heading; one that lies down or bends over is left out, since nobody could say which
way it faces.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.animation import Animation
from bunraku.geometry.rotations import matrix_y
from bunraku.retarget.fit import posed
from bunraku.retarget.rig_parts import RigParts
from bunraku_lab.datasets.motions.clips import load_clip, load_index
from bunraku_lab.synthetic.wardrobe.character import wardrobe_character

__all__ = ["FIRST", "FRAMES", "clips_of_people", "posed_people"]

FIRST, FRAMES = 50_000, 14
"""The seed of the first of these people, apart from those of other trainings, and the frames that are tried of each."""
UPRIGHT = np.cos(np.radians(35))
"""Cosine of the largest lean of hips and head, and of the turn between them, where the front is still told."""


def clips_of_people(folder: Path) -> list[Path]:
    """The clips of people in a folder of `bunraku data motions`.

    Raises:
        FormatError: There is no index in it.
    """
    index = load_index(folder)
    return [folder / f"{name}.npz" for name, row in sorted(index.items()) if not row.get("species")]


def posed_people(seed: int, clips: Sequence[Path], count: int = FRAMES) -> tuple[np.ndarray, list[np.ndarray]]:
    """Faces of a person in clothes made by code, and its vertices in frames of clips, +Y up and facing +Z.

    Args:
        seed: Of the person and of the choices.
        clips: Clips of people, to draw from.
        count: Frames that are tried.

    Returns:
        Faces (F, 3) and vertices, each (V, 3) [m].

    Raises:
        FormatError: A clip cannot be read.
    """
    rng = np.random.default_rng([seed, 1])
    character = wardrobe_character(seed)
    parts = RigParts.of(character)
    head = HANDLE_NAMES.index("head")
    found = []
    for number in rng.integers(len(clips), size=count):
        clip = load_clip(clips[number])
        frame = int(rng.integers(len(clip)))
        still = posed(clip.take(slice(frame, frame + 1)), parts.anatomy)
        body = still.root_rotation[0].astype(np.float64)
        face = body @ still.rotations[0, head]
        if min(body[1, 1], face[1, 1]) < UPRIGHT or face[:, 2] @ body[:, 2] < UPRIGHT:
            continue
        ahead = body[:, 2]
        heading = matrix_y(np.array(-np.arctan2(ahead[0], ahead[2])))
        found.append(Animation(character, parts.handles, still).vertices()[0].astype(np.float64) @ heading.T)
    return character.faces, found
