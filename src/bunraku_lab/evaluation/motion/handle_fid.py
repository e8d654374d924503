"""Handle-FID (section 4.1 of TapMo): how close the handles of generated motion come to those of real motion on two
bodies of very different size.

The paper takes two SMPL bodies; ours are the reference body's tallest and smallest shapes, 2.4 m and 1.0 m. A model
that knows meshes makes motions for each body, with its mesh feature and its adaptation; they are fitted to the body by
`fit_motion`, real ones too. The handles' positions in a frame, seen from the root's position on the ground and its
heading and divided by the body's height, are one sample; FID compares the Gaussians of both sets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.reference import reference_body
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import posed_points
from bunraku.diffusion.features import decode
from bunraku.geometry.rotations import heading, matrix_y
from bunraku.retarget.fit import fit_motion
from bunraku_lab.evaluation.motion.metrics import fid

__all__ = ["BODIES", "body_handles", "handle_fid", "handle_samples"]

BODIES = ("tall", "toddler")
EVERY = 4  # frames; neighbours say the same


def handle_samples(motion: HandleMotion, positions: np.ndarray, height: float) -> np.ndarray:
    """Handle positions of every fourth frame without the position and the heading of the root.

    Args:
        motion: Motion of a body.
        positions: The body's handles at rest [m], shape (K, 3).
        height: What to divide by [m].

    Returns:
        Shape (frames, 3 K).
    """
    angle = heading(motion.root_rotation, motion.fps)
    path = motion.root_translation.astype(float)
    # the root turns about handle 0, so its position is where handle 0 is
    centre = positions[0] + path
    centre[:, 1] = 0
    transforms = motion.transforms(positions)
    points = posed_points(transforms, positions) - centre[:, None]
    points = np.einsum("nij,nkj->nki", matrix_y(-angle), points)
    return np.asarray(points[::EVERY].reshape(-1, positions.size) / height)


def body_handles(
    features: Sequence[np.ndarray], shape: str, progress: Callable[[int, int], None] | None = None
) -> np.ndarray:
    """Samples of motions on a body, shape (frames, 3 K).

    Args:
        features: Motions of the reference body, each of shape (N, 271).
        shape: One of `reference_shapes()`.
        progress: Called with (motions done, total).
    """
    body = reference_body(shape)
    character, handles = body.character(), body.handles
    height = float(np.ptp(body.vertices[:, 1]))
    found = []
    for done, values in enumerate(features, 1):
        motion = decode(values)
        fitted = fit_motion(motion, Anatomy.of(character, handles))
        found.append(handle_samples(fitted, handles.positions, height))
        if progress is not None:
            progress(done, len(features))
    return np.concatenate(found)


def handle_fid(generated: dict[str, np.ndarray], real: dict[str, np.ndarray]) -> float:
    """Mean over the bodies of the FID between samples, each of shape (frames, 3 K), by the body's name."""
    return float(np.mean([fid(generated[shape], real[shape]) for shape in generated]))
