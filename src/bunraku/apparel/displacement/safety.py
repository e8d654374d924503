"""The safety stage: apparel does not stretch beyond bounds, and does not enter the body.

Projections in the manner of extended position-based dynamics (Macklin et al. 2016), a few passes over the nodes of one
frame. It can be switched off, and its effect is a row of its own in the tables.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.apparel.displacement.body_points import BodyPoints, nearest_plane, nearest_point
from bunraku.apparel.displacement.nodes import ApparelNodes

__all__ = ["Safety", "SafetySettings"]


@dataclass(frozen=True)
class SafetySettings:
    """How much is allowed.

    Args:
        shortest, longest: Of an edge of the apparel graph, over its length at rest.
        clear: How near to the body nodes may come that were farther off at rest [m].
        passes: Over all edges and the body.
        most: Nodes deeper than this are left where they are: they are on the wrong side of something thin [m].
    """

    shortest: float = 0.85
    longest: float = 1.15
    clear: float = 0.006
    passes: int = 3
    most: float = 0.2


class Safety:
    """The stage for one wearer.

    Args:
        nodes: The nodes.
        points: The body's points, denser than those of the features.
        scale: The wearer's size.
        settings: What is allowed.
    """

    def __init__(
        self, nodes: ApparelNodes, points: BodyPoints, scale: float = 1.0, settings: SafetySettings | None = None
    ):
        self.settings = settings or SafetySettings()
        self.points, self.scale = points, scale
        here = np.repeat(np.arange(len(nodes)), nodes.neighbours.shape[1])
        pairs = np.sort(np.stack([here, nodes.neighbours.reshape(-1)], axis=1), axis=1)
        self.edges = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)
        self.lengths = np.linalg.norm(nodes.rest[self.edges[:, 0]] - nodes.rest[self.edges[:, 1]], axis=1)
        self.degree = np.maximum(np.bincount(self.edges.reshape(-1), minlength=len(nodes)), 1)[:, None]
        gap = nearest_point(nodes.rest, points.rest, points.normals)[0]
        self.gap = np.minimum(gap, self.settings.clear * scale)
        # what lies on the body at rest stays there: the root of a part is held
        self.free = np.where(nodes.distance < 0.02 * scale, 0.0, 1.0)[:, None].astype(np.float32)

    def __call__(self, places: np.ndarray, body: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Nodes made safe [m], shape (M, 3).

        Args:
            places: Of the nodes [m], shape (M, 3).
            body: Places and normals of the posed body points, shape (B, 3) each.
        """
        out = np.array(places, np.float32)
        anchor, normal = nearest_plane(out, *body)  # nodes move little, so the planes stay theirs
        for _ in range(self.settings.passes):
            out = self._bounded(out)
            out = self._outside(out, anchor, normal)
        return out

    def _bounded(self, places: np.ndarray) -> np.ndarray:
        a, b = self.edges.T
        way = places[b] - places[a]
        now = np.linalg.norm(way, axis=1)
        wanted = np.clip(now, self.settings.shortest * self.lengths, self.settings.longest * self.lengths)
        step = way * (0.5 * (1 - wanted / np.maximum(now, 1e-9)))[:, None]
        total = np.stack(
            [np.bincount(a, column, len(places)) - np.bincount(b, column, len(places)) for column in step.T], 1
        )
        return np.asarray(places + self.free * total / np.sqrt(self.degree))

    def _outside(self, places: np.ndarray, anchor: np.ndarray, normal: np.ndarray) -> np.ndarray:
        deep = self.gap - ((places - anchor) * normal).sum(axis=1)
        deep = np.where(deep < self.settings.most * self.scale, np.maximum(deep, 0), 0)
        return np.asarray(places + self.free * deep[:, None] * normal)
