"""Skirts laid over legs: a column that a leg has passed is turned outwards until the leg is behind it, as a skirt that
is driven by the thighs would be. What turns is smooth in time and from column to column.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.body.layout import JOINT_NAMES
from bunraku.core.rig_animation import RigAnimation
from bunraku.geometry.easing import smooth_step
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.physics.chains.chain import Chain

__all__ = ["over_legs"]

SAMPLES = 6
"""Places of a thigh, and of a shin, that are looked at."""
THICK = 0.045
"""Over the size [m]: half the thickness of a leg that no skin shows."""
GAP = 0.012
"""Over the size [m]: how far a skirt lies over a leg."""
WIDE = 0.08
"""Over the size [m]: a leg that is so far beside a column counts whole for it."""
FARTHEST = 1.4
"""As far as a column turns [rad]."""
SPREAD = 0.6
"""Of its turn, that its neighbours have at least."""
HOLD, SMOOTH = 0.15, 0.06
"""How long a turn is held, and its standard deviation in time [s]."""
_LEGS = [
    [JOINT_NAMES.index(f"{side}_{part}") for part in ("hip", "knee", "ankle")] for side in ("left", "right")
]  # fmt: skip


def over_legs(
    animation: RigAnimation, chains: Sequence[Chain], near: Sequence[tuple[int, int, float]],
    clothed: ClothedCharacter, bones: np.ndarray,
) -> RigAnimation:  # fmt: skip
    """An animation whose skirts lie over the legs.

    Args:
        animation: Of the rig that the chains are part of.
        chains: By the bones of that rig.
        near: Pairs of chains that are neighbours, as of `LaidChains`.
        clothed: The same mesh.
        bones: The bone of the rig that each of the 22 joints is, shape (22,).
    """
    skirts = [number for number, chain in enumerate(chains) if chain.kind == "skirt"]
    if not skirts:
        return animation
    affine = animation.transforms()
    world, heads = animation.world()
    extra = np.zeros((len(animation), len(chains)))
    axes = {}
    posed, rest, thick = _legs(affine, clothed, bones)
    for number in skirts:
        chain = chains[number]
        back = np.swapaxes(affine[:, chain.holder, :3, :3], 1, 2)
        origin = affine[:, chain.holder, :3, 3]
        legs = np.einsum("nab,npb->npa", back, posed - origin[:, None])
        end = heads[:, chain.bones[-1]] + world[:, chain.bones[-1]] @ (chain.points[-1] - chain.points[-2])
        line = np.concatenate([heads[:, chain.bones], end[:, None]], axis=1)
        line = np.einsum("nab,npb->npa", back, line - origin[:, None])
        out = chain.points[len(chain.points) // 2] - clothed.joints[0]
        out = np.array([out[0], 0.0, out[2]]) / max(float(np.hypot(out[0], out[2])), 1e-9)
        axes[number] = np.cross([0.0, -1.0, 0.0], out)
        wide = max(float(chain.width.max()), WIDE * clothed.scale)
        # the holder's rest frame lies along the world's axes, so the rest pose is one frame more
        turn = _turns(np.concatenate([rest[None], legs]), np.concatenate([chain.points[None], line]), out, thick, wide)
        extra[:, number] = np.clip((turn[1:] - turn[:1]).max(axis=1), 0, FARTHEST)
    whole = np.array(extra)
    for one, other, _ in near:
        whole[:, one] = np.maximum(whole[:, one], SPREAD * extra[:, other])
        whole[:, other] = np.maximum(whole[:, other], SPREAD * extra[:, one])
    size = max(1, round(HOLD * animation.fps))
    whole = gaussian_filter1d(maximum_filter1d(whole, size, axis=0), SMOOTH * animation.fps, axis=0, mode="nearest")
    rotations = np.array(animation.rotations, np.float64)
    for number, axis in axes.items():
        bone = int(chains[number].bones[0])
        rotations[:, bone] = matrix_from_axis_angle(whole[:, number, None] * axis) @ rotations[:, bone]
    return RigAnimation(animation.character, rotations, animation.translations, animation.fps, animation.reference)


def _turns(legs: np.ndarray, line: np.ndarray, out: np.ndarray, thick: np.ndarray, wide: float) -> np.ndarray:
    """How far a column would have to turn for places of legs to lie behind it [rad], 0 where they do, shape (N, P).

    Args:
        legs: The places [m], shape (N, P, 3).
        line: Its points [m], shape (N, R + 1, 3).
        out: The direction in which it turns.
        thick: Half how thick the legs are there [m], shape (P,).
        wide: Half of what it holds [m].
    """
    away, chain = legs - line[:, :1], line - line[:, :1]
    beyond, down = away @ out + thick, -away[..., 1]
    lateral = np.abs(away @ np.cross([0.0, 1.0, 0.0], out))
    drop = np.maximum.accumulate(-chain[..., 1], axis=1) + 1e-6 * np.arange(line.shape[1])
    there = np.stack([np.interp(v, d, o) for v, d, o in zip(down, drop, chain @ out, strict=True)])
    counts = smooth_step((lateral - 0.9 * wide) / (0.7 * wide + 1.2 * thick), 1.0, 0.0)
    counts = counts * ((down > 0.25 * thick) & (down < drop[:, -1:] + thick))
    level = np.maximum(down, 1e-6)
    return np.asarray(np.maximum((np.arctan2(beyond, level) - np.arctan2(there, level)) * counts, 0))


def _legs(
    affine: np.ndarray, clothed: ClothedCharacter, bones: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where places down the middle of both legs are [m], posed (N, P, 3) and in the rest pose (P, 3), and half the
    legs' thickness there (P,).
    """
    places, rests, thick = [], [], []
    share = (np.arange(SAMPLES) + 0.5)[:, None] / SAMPLES
    for leg in _LEGS:
        for above, below in zip(leg[:-1], leg[1:], strict=True):
            start, end = clothed.joints[above].astype(float), clothed.joints[below].astype(float)
            own = affine[:, bones[above]]
            rest = start + share * (end - start)
            rests.append(rest)
            places.append(np.einsum("nab,pb->npa", own[:, :3, :3], rest) + own[:, None, :3, 3])
            skin = clothed.rest[(clothed.weights[:, above] > 0.5) & (clothed.part < 0)]
            radius = THICK * clothed.scale
            if len(skin) > 8:
                along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
                away = skin - start
                off = np.linalg.norm(away - (away @ along)[:, None] * along, axis=1)
                radius = float(np.clip(np.percentile(off, 85), 0.4 * radius, 2 * radius))
            thick.append(np.full(SAMPLES, radius + GAP * clothed.scale))
    return np.concatenate(places, axis=1), np.concatenate(rests), np.concatenate(thick)
