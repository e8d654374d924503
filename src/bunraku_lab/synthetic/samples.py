"""The sample characters of `bunraku.files.samples` with their rigs, and coarser ones for quick tests.

The files beside this module were written by code that built the samples from distance fields; the history has it. The
coarse ones stay out of the wheel.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from bunraku.core.character import Character, Rig
from bunraku.errors import OptionError
from bunraku.files import sample_character, sample_names

DETAILS = (0.3, 0.5, 1.0)
"""Shares of the vertices that there are meshes with; 1 is what is shipped."""


def make_sample(name: str, detail: float = 1.0, *, rigged: bool = False) -> Character:
    """A sample character, which stands on y = 0, faces +Z and has its left side at +X; people are in T-pose.

    Args:
        name: One of `bunraku.files.samples.sample_names`.
        detail: One of `DETAILS`, a factor on the number of vertices, roughly.
        rigged: Give it its skeleton and skin weights (Hips, Spine, LeftArm, Tail1); without it `rig` is None.

    Returns:
        The character: closed parts, wound outward, with one colour a face, faces of one colour together. Vertices are
        doubled along the seams between colours, as in most files from artists.

    Raises:
        OptionError: The name or the detail is unknown.
    """
    if name not in sample_names():
        raise OptionError(f"there is no sample character named {name!r}; choose one of {', '.join(sample_names())}")
    if detail not in DETAILS:
        raise OptionError(f"the detail of a sample character must be one of {DETAILS}, not {detail}")
    kept = {
        key.rpartition(" ")[2]: value for key, value in _arrays(detail).items() if key.startswith(f"{name} {detail} ")
    }
    if detail == 1:
        shipped = sample_character(name)
        assert shipped.colors is not None
        kept |= {"vertices": shipped.vertices, "faces": shipped.faces, "colors": shipped.colors}
    transforms = np.tile(np.eye(4), (len(kept["names"]), 1, 1))
    transforms[:, :3, 3] = kept["positions"]
    weights = kept["weights"].astype(np.float32)  # halves in the file
    weights /= weights.sum(axis=1, keepdims=True)
    rig = Rig(tuple(kept["names"].tolist()), kept["parents"], transforms, kept["indices"], weights)
    return Character(name, kept["vertices"], kept["faces"], rig if rigged else None, kept["colors"])


@cache
def _arrays(detail: float) -> dict[str, np.ndarray]:
    """What is kept of a detail, by name, detail and field."""
    with np.load(Path(__file__).with_name("samples.npz" if detail == 1 else "coarse_samples.npz")) as file:
        return dict(file)
