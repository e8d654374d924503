"""What hangs beside an arm is told from what the arm wears: a sleeve goes round it, a cape or long hair lies on one
side.
"""

from __future__ import annotations

import numpy as np

from bunraku.body.layout import HANDLE_COUNT
from bunraku.body.reference import handle_positions
from bunraku.geometry.axes import directions_about, goes_round
from bunraku.geometry.simplify import NetworkMesh
from bunraku.handles.limbs import FAMILIES, LIMB_HANDLES, SIDES, limb_handles

__all__ = ["freed_from_arms"]

HELD = 0.1  # a vertex goes with an arm that holds so much of it
ROOT, ROOTS = 0.15, 0.5  # of a part's height, that is its root; share of that which the limbs hold at the most
FEWEST = 12  # vertices of a part


def freed_from_arms(mesh: NetworkMesh, weights: np.ndarray) -> np.ndarray:
    """Weights in which a loose part that hangs from the head or the trunk goes with no arm that it does not go round;
    what the arm held goes to the other handles of its vertices, or else to those of its root.

    Args:
        mesh: The network mesh.
        weights: Of its vertices, rows sum to 1, shape (M, 30).
    """
    part, areas = mesh.components, mesh.areas.astype(np.float64)
    out = np.array(weights, np.float64)
    others = np.setdiff1d(np.arange(HANDLE_COUNT), LIMB_HANDLES)
    places = handle_positions(mesh.vertices, weights, mesh.areas)
    for arm in (np.array(limb_handles(side, FAMILIES[1])) for side in SIDES):
        held = weights[:, arm].sum(axis=1) > HELD
        angle = directions_about(mesh.vertices, places[arm[0]], places[arm[-1]])
        for number in np.unique(part[held]):
            own = part == number
            mine = own & held
            if own.sum() < FEWEST or goes_round(angle[mine]):
                continue
            height = mesh.vertices[own, 1]
            rows = np.flatnonzero(own)
            top = rows[height >= height.max() - ROOT * np.ptp(height)]
            root = areas[top] @ weights[top][:, others]
            if root.sum() < ROOTS * areas[top].sum():
                continue
            away = out[np.ix_(rows, arm)].sum(axis=1)
            out[np.ix_(rows, arm)] = 0
            left = out[rows].sum(axis=1)
            kept = left > 0.5
            out[rows[kept]] *= ((left + away) / np.maximum(left, 1e-9))[kept, None]
            out[np.ix_(rows[~kept], others)] += away[~kept, None] * root / root.sum()
    return out.astype(np.float32)
