"""What the simulation ends with: apparel that is in the body is pushed out of it.

Rigid bodies are coarse, so a lock of hair or a hem that touches nothing may lie in the body by some centimetres. The
push is spread over what is around it, is smooth in time, and leaves alone what is in the body at rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from bunraku.apparel.body_volume import BodyVolume
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.displacement.body_points import body_points
from bunraku.apparel.displacement.carry import Carrier
from bunraku.apparel.displacement.safety import Safety, SafetySettings
from bunraku.apparel.nodes import apparel_nodes
from bunraku.apparel.skinning import eq4_transforms
from bunraku.core.skinning import skin
from bunraku_lab.datasets.apparel.body_inside import deep_inside

__all__ = ["Insides", "PushOut", "inside_shares", "pushed_out_clips", "unclothed"]

NODES = 512
POINTS = 2000  # of the body
PASSES = 6
SMOOTH = 0.05
"""Of the push in time, standard deviation [s]."""
SETTINGS = SafetySettings(clear=0.004, slack=0.004, spread=0.07, most=0.2)
Insides = tuple[float, float, float]


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
            self.safety = Safety(clothed, self.nodes, body_points(clothed, POINTS), self.carrier, SETTINGS)

    def __call__(self, transforms: np.ndarray, loose: np.ndarray, offsets: np.ndarray) -> np.ndarray:
        """The offsets of a clip with its apparel out of the body [m], shape (N, M, 3), of the type that they had.

        Args:
            transforms: `[R | t]` of the joints, shape (N, 22, 3, 4).
            loose: Vertices that have offsets, shape (M,).
            offsets: How far they are from what the joints alone give [m], shape (N, M, 3).
        """
        if self.safety is None or self.safety.depth is None:
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
            ways.append(self.safety.unposed(positions, affine[frame]))
            moved = positions
            for _ in range(PASSES):
                moved = self.safety.outside(moved, ways[-1])
            push[frame] = (turns[frame].transpose(0, 2, 1) * (moved - positions)[:, None, :]).sum(axis=-1)
        push = gaussian_filter1d(push, SMOOTH * self.fps, axis=0, mode="nearest")
        # apparel without offsets goes with its joint, and so it stays
        moving = np.flatnonzero(numbering[self.carrier.vertices] >= 0)
        chosen = self.carrier.vertices[moving]
        columns, index, share = numbering[chosen], self.carrier.index[moving], self.carrier.share[moving]
        carried = skin(clothed.rest[chosen], clothed.weights[chosen], affine)
        everywhere = np.zeros((len(self.carrier.vertices), 3), np.float32)
        out = np.array(offsets)
        for frame, unposed in enumerate(ways):
            own = (turns[frame] * push[frame][:, None, :]).sum(axis=-1)
            everywhere[moving] = carried[frame] + offsets[frame, columns] + (share[..., None] * own[index]).sum(axis=1)
            out[frame, columns] = self.safety.vertices(everywhere, unposed)[moving] - carried[frame]
        return out


def inside_shares(
    clothed: ClothedCharacter,
    transforms: np.ndarray,
    loose: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    most: int = 600,
) -> Insides:
    """Share of the apparel vertices deeper than 1 cm in the body, of those that are not so at rest, mean over the
    frames: of rigid apparel, of some offsets, and of others.

    Args:
        clothed: The character.
        transforms: `[R | t]` of its joints, shape (N, 22, 3, 4).
        loose: Vertices that have offsets, shape (M,).
        before, after: Their offsets [m], shape (N, M, 3).
        most: Vertices that are looked at.

    Raises:
        CharacterError: All of the character is apparel.
    """
    volume = BodyVolume.of_mesh(clothed.rest, clothed.faces, clothed.weights, clothed.apparel, "the mesh")
    cloth = np.flatnonzero(clothed.apparel)
    cloth = cloth[np.linspace(0, len(cloth) - 1, min(most, len(cloth))).astype(np.int64)]
    cloth = cloth[~deep_inside(volume, volume.rest, clothed.rest[cloth])]
    if not len(cloth):
        return 0.0, 0.0, 0.0
    affine = eq4_transforms(transforms, clothed.joints)
    rigid = skin(clothed.rest[cloth], clothed.weights[cloth], affine)
    index = np.full(len(clothed.rest), -1)
    index[loose] = np.arange(len(loose))
    rows = index[cloth]
    clouds = [np.array(rigid) for _ in range(3)]
    for cloud, offsets in zip(clouds[1:], (before, after), strict=True):
        cloud[:, rows >= 0] += offsets[:, rows[rows >= 0]].astype(np.float32)
    bodies = volume.posed(affine)
    deep = [
        deep_inside(volume, body, np.concatenate([cloud[frame] for cloud in clouds]))
        for frame, body in enumerate(bodies)
    ]
    return tuple(np.reshape(deep, (len(bodies), 3, -1)).mean(axis=(0, 2)).tolist())


def pushed_out_clips(
    clothed: ClothedCharacter,
    transforms: np.ndarray,
    loose: np.ndarray,
    offsets: np.ndarray,
    clips: Sequence[Mapping[str, Any]],
) -> np.ndarray:
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
