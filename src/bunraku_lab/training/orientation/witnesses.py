"""The weights of what a shape tells by simple means (`bunraku.handles.orientation_shape`), fitted to characters whose
orientation is known.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.optimize import minimize

from bunraku.geometry.axes import AXES
from bunraku.handles.orientation_shape import lean, rest
from bunraku_lab.training.orientation.measures import FRONTS, UPRIGHT

__all__ = ["fitted_weights"]


def fitted_weights(surfaces: Iterable[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, float]:
    """The weights of `rest` and of `lean` that have the least cross-entropy.

    Args:
        surfaces: Points and unit normals of characters that stand along +Y and face +Z, shape (N, 3) each.

    Returns:
        Of `rest`, shape (3,), and of `lean`.
    """
    rests, leans = [], []
    for points, normals in surfaces:
        rests.append(rest(points, normals))
        leans.append(lean(points)[FRONTS, None])
    return (
        _least(np.stack(rests), AXES.index("+y")),
        float(_least(np.stack(leans), FRONTS.index(UPRIGHT))[0]),
    )


def _least(features: np.ndarray, right: int) -> np.ndarray:
    """Weights of a softmax over choices, features of shape (S, choices, K), always with the same right one."""

    def loss(weights: np.ndarray) -> float:
        scores = features @ weights
        scores = scores - scores.max(axis=1, keepdims=True)
        return float((np.log(np.exp(scores).sum(axis=1)) - scores[:, right]).mean() + 1e-3 * np.square(weights).sum())

    return np.asarray(minimize(loss, np.zeros(features.shape[2])).x)
