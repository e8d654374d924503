"""Faults of simulated apparel: parts inside the body, which are pushed out, and hems that stay up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import igl
import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import csr_matrix

from bunraku.apparel.body import UnifiedBody, eq4_transforms, surface_points
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.learned.player import Carrier, Safety, SafetySettings
from bunraku.apparel.nodes import apparel_nodes
from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.skinning import skin
from bunraku.errors import CharacterError

_MOST_FACES = 12_000


@dataclass(frozen=True, eq=False)
class BodyVolume:
    """The surface of a character without what physics move, with fewer faces."""

    rest: np.ndarray  # vertices in the rest pose [m], shape (B, 3)
    faces: np.ndarray  # shape (F, 3), int64
    weights: np.ndarray  # for the 22 joints, shape (B, 22)

    @classmethod
    def of(cls, body: UnifiedBody, apparel: np.ndarray, most_faces: int = _MOST_FACES) -> BodyVolume:
        """The volume of a body and its mask (V,), bool; otherwise as `of_mesh`."""
        character = body.parts.character
        return cls.of_mesh(character.vertices, character.faces, body.weights, apparel, character.name, most_faces)

    @classmethod
    def of_mesh(
        cls, vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray, apparel: np.ndarray, name: str,
        most_faces: int = _MOST_FACES,
    ) -> BodyVolume:  # fmt: skip
        """The volume of a rest mesh [m] with weights for the 22 joints (V, 22) and its mask (V,), bool. A body with
        more faces than `most_faces` is simplified to about so many, which moves its surface by a millimetre or two.

        Raises:
            CharacterError: All of the character is apparel.
        """
        faces = faces[~apparel[faces].any(axis=1)]
        if not len(faces):
            raise CharacterError(f"{name}: the whole mesh counts as apparel, so no body is left; mark less of it")
        used = np.unique(faces)
        points, index = np.unique(np.round(vertices[used].astype(np.float64), 6), axis=0, return_inverse=True)
        numbering = np.full(len(vertices), -1)
        numbering[used] = index.ravel()
        shares = _means(weights[used], index.ravel(), len(points))
        faces = numbering[faces]
        faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
        if len(faces) <= most_faces:
            return cls(points, np.ascontiguousarray(faces, np.int64), shares)
        import fast_simplification

        few, few_faces, collapses = fast_simplification.simplify(
            points.astype(np.float32), faces.astype(np.int32), target_count=most_faces, return_collapses=True
        )
        few, few_faces, kept = fast_simplification.replay_simplification(
            points.astype(np.float32), faces.astype(np.int32), collapses
        )
        return cls(few.astype(np.float64), np.ascontiguousarray(few_faces, np.int64), _means(shares, kept, len(few)))

    def posed(self, transforms: np.ndarray) -> np.ndarray:
        """Vertices of frames [m], shape (N, B, 3), by transforms of the joints as `eq4_transforms` gives them."""
        return skin(self.rest.astype(np.float32), self.weights, transforms)


def _means(values: np.ndarray, groups: np.ndarray, count: int) -> np.ndarray:
    each = np.arange(len(groups))
    out = csr_matrix((np.ones(len(groups)), (groups, each)), (count, len(groups))) @ values.astype(np.float64)
    return np.asarray(out / np.maximum(out.sum(axis=1, keepdims=True), 1e-12), np.float32)


DEEP = 0.01
"""Vertices deeper than this are counted, by definition of the measure [m]."""


def deep_inside(body: BodyVolume, vertices: np.ndarray, points: np.ndarray, depth: float = DEEP) -> np.ndarray:
    """Which points are deeper than this inside a body, shape (P,), bool.

    Args:
        body: Its faces are taken.
        vertices: Of the body in this frame [m], shape (B, 3).
        points: Shape (P, 3).
        depth: [m].
    """
    vertices, points = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(points, np.float64)
    out = np.abs(igl.fast_winding_number(vertices, body.faces, points)) > 0.5
    inside = np.flatnonzero(out)
    if len(inside):
        out[inside] = igl.point_mesh_squared_distance(points[inside], vertices, body.faces)[0] > depth * depth
    return np.asarray(out)


HIPS = [JOINT_NAMES.index("left_hip"), JOINT_NAMES.index("right_hip")]
CALM = np.radians(25)
"""Angle between thighs and pelvis under which a leg is not raised [rad]."""
SETTLED = 15
"""Frames for which legs are calm before a hem that is still up stands out."""

# With these, one of 90 clips with calm legs was measured to stand out in more than a tenth of them.
UPRIGHT = 0.95
UP = 0.06
"""How much higher than at rest a hem is, over the character's size."""
STILL = 0.15
"""Speed under which it hangs there [m/s]."""
LEAST_SHARE = 0.03
"""Share of what hangs from the pelvis that must stand out for a frame to count."""


def standing_out(
    clothed: ClothedCharacter, transforms: np.ndarray, loose: np.ndarray, offsets: np.ndarray, fps: float = 30.0
) -> float:
    """Share of the frames with calm legs in which apparel that hangs from the pelvis stands out; 0 where there is none.

    Args:
        clothed: The character.
        transforms: `[R | t]` of the joints, shape (N, 22, 3, 4).
        loose: Vertices that leave their joints, shape (M,).
        offsets: By how much [m], shape (N, M, 3).
        fps: Frames a second.
    """
    hung = (
        clothed.apparel[loose] & (clothed.weights[loose].argmax(axis=1) == 0)
        & (clothed.rest[loose, 1] < clothed.joints[0, 1])
    )  # fmt: skip
    turn = np.asarray(transforms[:, 0, :, :3], np.float32)
    thighs = np.einsum("nba,njbc->njac", turn, transforms[:, HIPS, :, :3])
    angle = np.arccos(np.clip((np.trace(thighs, axis1=2, axis2=3) - 1) / 2, -1, 1)).max(axis=1)
    calm = (angle < CALM) & (turn[:, 1, 1] > UPRIGHT)
    settled = np.convolve(calm, np.ones(SETTLED + 1), "full")[: len(calm)] > SETTLED
    if not hung.any() or not settled.any():
        return 0.0
    away = np.einsum("nba,nmb->nma", turn, offsets[:, hung].astype(np.float32))
    speed = np.linalg.norm(np.gradient(away, axis=0), axis=2) * fps
    up = (away[..., 1] > UP * clothed.scale) & (speed < STILL)
    return float((up[settled].mean(axis=1) > LEAST_SHARE).mean())


NODES = 512
POINTS = 2000  # of the body
PASSES = 6
SMOOTH = 0.05
"""Of the push in time, standard deviation [s]."""
SETTINGS = SafetySettings(clear=0.004, slack=0.004, spread=0.07, most=0.2)


class PushOut:
    """The push for the clips of one character.

    Args:
        clothed: The character.
        fps: Frames a second [1/s].
    """

    def __init__(self, clothed: ClothedCharacter, fps: float = 30.0):
        self.clothed, self.fps = clothed, fps
        self.safety: Safety | None = None
        if clothed.apparel.any():
            self.nodes = apparel_nodes(clothed, NODES)
            self.carrier = Carrier(clothed, self.nodes)
            self.safety = Safety(clothed, self.nodes, surface_points(clothed, POINTS), self.carrier, SETTINGS)

    def __call__(self, transforms: np.ndarray, loose: np.ndarray, offsets: np.ndarray) -> np.ndarray:
        """The offsets of a clip with its apparel out of the body [m], shape (N, M, 3), of the type that they had.

        Args:
            transforms: `[R | t]` of the joints, shape (N, 22, 3, 4).
            loose: Vertices that have offsets, shape (M,).
            offsets: How far they are from what the joints alone give [m], shape (N, M, 3).
        """
        if self.safety is None or self.safety.body is None:
            return offsets
        clothed, nodes = self.clothed, self.nodes
        numbering = np.full(len(clothed.rest), -1)
        numbering[loose] = np.arange(len(loose))
        affine = eq4_transforms(transforms, clothed.joints)
        turns = affine[:, nodes.joint, :, :3]
        of_nodes = numbering[nodes.vertex]
        start = np.array(skin(nodes.rest, nodes.weights, affine))
        start[:, of_nodes >= 0] += offsets[:, of_nodes[of_nodes >= 0]].astype(np.float32)
        push, ways = np.zeros_like(start), []
        for frame, positions in enumerate(start):
            ways.append(self.safety.posed(affine[frame]))
            moved, near = positions, ways[-1].planes(positions)[1]
            for _ in range(PASSES):
                moved = self.safety.outside(moved, near)
            push[frame] = (turns[frame].transpose(0, 2, 1) * (moved - positions)[:, None, :]).sum(axis=-1)
        push = gaussian_filter1d(push, SMOOTH * self.fps, axis=0, mode="nearest")
        # apparel without offsets goes with its joint, and so it stays
        moving = np.flatnonzero(numbering[self.carrier.vertices] >= 0)
        chosen = self.carrier.vertices[moving]
        columns, index, share = numbering[chosen], self.carrier.index[moving], self.carrier.share[moving]
        carried = skin(clothed.rest[chosen], clothed.weights[chosen], affine)
        everywhere = np.zeros((len(self.carrier.vertices), 3), np.float32)
        out = np.array(offsets)
        for frame, body in enumerate(ways):
            own = (turns[frame] * push[frame][:, None, :]).sum(axis=-1)
            everywhere[moving] = carried[frame] + offsets[frame, columns] + (share[..., None] * own[index]).sum(axis=1)
            out[frame, columns] = self.safety.vertices(everywhere, body)[moving] - carried[frame]
        return out


def pushed_out_clips(
    clothed: ClothedCharacter, transforms: np.ndarray, loose: np.ndarray, offsets: np.ndarray,
    clips: Sequence[Mapping[str, Any]],
) -> np.ndarray:  # fmt: skip
    """The offsets of a character's clips with its apparel out of its body, shape (N, M, 3).

    Args:
        clothed: The character.
        transforms, loose, offsets: As of `Recording`.
        clips: Where each begins ("first") and how long it is ("frames").
    """
    push = PushOut(clothed)
    spans = [slice(clip["first"], clip["first"] + clip["frames"]) for clip in clips]
    return np.concatenate([push(transforms[span], loose, offsets[span]) for span in spans])


def unclothed(
    rest: np.ndarray, faces: np.ndarray, joints: np.ndarray, weights: np.ndarray, apparel: np.ndarray, part: np.ndarray
) -> ClothedCharacter:
    """A clothed character of whose springs nothing is said."""
    none = np.zeros(int(part.max(initial=-1)) + 1, np.float32)
    return ClothedCharacter(rest, faces, joints, weights, apparel.astype(bool), part, none, none)
