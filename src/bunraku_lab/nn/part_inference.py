"""The parts of any mesh, found by the part network, before there are handles or joints.

The network is a hierarchy of points (PointNet++, Qi et al. 2017) with a transformer over the coarsest. Here it runs
without torch; `bunraku_lab.nn.parts` is what is trained, and a test holds the numbers of each to the other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from bunraku.core.nn.checkpoints import config_of, dated, load_network
from bunraku.core.nn.layers import Norm, PreNorm, Weights, gelu, one_thread, sigmoid, softmax
from bunraku_lab.nn.checkpoints import lab_checkpoint
from bunraku_lab.nn.part_points import (
    BESIDE,
    CENTRES,
    FEATURES,
    GATHERED,
    TOKENS,
    PartPoints,
    loose_parts,
    part_points,
    point_features,
)

PARTS = ("body", "hair", "skirt", "cape", "sleeve", "tail", "prop", "accessory", "ground")
"""Kinds of parts. A skirt is also a robe or the tails of a coat, a tail also an ear; ground is what a figure stands on
and what lies about it.
"""
CARRIERS = ("head", "chest", "pelvis", "left arm", "right arm", "left leg", "right leg")
"""What a part goes with."""
SCALES = (20.0, 12.0, 6.0)
"""What positions from a centre are multiplied by, from the finest level up."""
WAVES = 3 + 2 * 9
LIKELY = 0.15
"""Probability from which on a vertex hangs: long hair that physics move and stiff hair look alike. On the files that
settings are chosen on (`benchmarks/part_files.md`) 0.1 is best, which marks 1.02 % of machines, animals and the bare;
0.15 marks 0.75 %.
"""


@dataclass(frozen=True)
class PartConfig:
    """Shape of the part network.

    Args:
        fine: Channels of points.
        middle: Channels of centres.
        coarse: Channels of tokens.
        layers: Transformer layers over the tokens.
        heads: Of their attention.
        before, after: Blocks over the centres before and after the transformer.
    """

    fine: int = 64
    middle: int = 112
    coarse: int = 128
    layers: int = 4
    heads: int = 4
    before: int = 2
    after: int = 2


@dataclass(frozen=True, eq=False)
class FoundParts:
    """What the network says of each vertex of a mesh.

    Args:
        parts: Probability of each of `PARTS`, shape (V, 9).
        hangs: Probability that physics would move it, shape (V,).
        carriers: Probability of each of `CARRIERS`, shape (V, 7).
    """

    parts: np.ndarray
    hangs: np.ndarray
    carriers: np.ndarray

    @property
    def label(self) -> np.ndarray:
        """Number in `PARTS` of each vertex, shape (V,)."""
        return np.asarray(self.parts.argmax(axis=1))

    @property
    def mask(self) -> np.ndarray:
        """Vertices that hang, shape (V,), bool."""
        return np.asarray(self.hangs > LIKELY)


class _Near:
    """The most of linear features of neighbours and of where they are from a centre."""

    def __init__(self, width: int, out: int, scale: float, weights: Weights):
        self._value = weights.linear("value", width, out)
        self._place = weights.linear("place", 3, out, bias=False)
        self._scale = np.float32(scale)

    def __call__(self, x: np.ndarray, points: np.ndarray, count: int, index: np.ndarray) -> np.ndarray:
        place = self._place(self._scale * points)
        value = self._value(x)
        value += place
        most = value[index[:, 0]]
        for column in range(1, index.shape[1]):
            np.maximum(most, value[index[:, column]], out=most)
        most -= place[:count]
        return gelu(most)


class _Gather:
    def __init__(self, width: int, out: int, scale: float, weights: Weights):
        self._near = _Near(width, out, scale, weights.part("near"))
        self._mix, self._leave = weights.linear("mix", width + out, out), weights.linear("leave", out, out)

    def __call__(self, x: np.ndarray, points: np.ndarray, count: int, index: np.ndarray) -> np.ndarray:
        near = self._near(x, points, count, index)
        return self._leave(gelu(self._mix(np.concatenate([x[:count], near], axis=1))))


class _Beside:
    def __init__(self, width: int, weights: Weights):
        self._norm: Norm = weights.norm("norm", width)
        self._near = _Near(width, width, SCALES[1], weights.part("near"))
        self._mix, self._leave = weights.linear("mix", 2 * width, width), weights.linear("leave", width, width)

    def __call__(self, x: np.ndarray, points: np.ndarray, index: np.ndarray) -> np.ndarray:
        own = self._norm(x)
        near = self._near(own, points, len(points), index)
        return np.asarray(x + self._leave(gelu(self._mix(np.concatenate([own, near], axis=1)))))


class PartNetwork:
    """The network.

    Args:
        config: Its shape.
        weights: Of a checkpoint.

    Raises:
        ValueError: The weights have other sizes.
    """

    def __init__(self, config: PartConfig, weights: Weights):
        self.config = config
        fine, middle, coarse = config.fine, config.middle, config.coarse
        self._enter = weights.linear("enter.0", FEATURES, fine), weights.linear("enter.2", fine, fine)
        self._piece = weights.linear("piece", 2 * fine, fine)
        self._to_centres = _Gather(fine, middle, SCALES[0], weights.part("to_centres"))
        self._before = [_Beside(middle, weights.part(f"before.{number}")) for number in range(config.before)]
        self._to_tokens = _Gather(middle, coarse, SCALES[2], weights.part("to_tokens"))
        self._where, self._norm_tokens = weights.linear("where", WAVES, coarse), weights.norm("norm_tokens", coarse)
        self._layers = []
        for number in range(config.layers):
            own = weights.part(f"layers.{number}")
            self._layers.append(
                PreNorm(
                    own.attention("enter", "leave", coarse, config.heads),
                    own.norm("norm_a", coarse),
                    own.feed_forward("wide", "narrow", coarse, 3 * coarse),
                    own.norm("norm_b", coarse),
                )
            )
        self._norm = weights.norm("norm", coarse)
        self._down = weights.linear("down", middle + coarse, middle)
        self._after = [_Beside(middle, weights.part(f"after.{number}")) for number in range(config.after)]
        self._last = weights.linear("last", fine + middle, middle)
        self._whole = weights.linear("whole", 2 * middle, middle)
        out = len(PARTS) + 1 + len(CARRIERS)
        self._decoder = weights.norm("decoder.0", middle), weights.linear("decoder.1", middle, out)

    def scores(self, seen: PartPoints) -> np.ndarray:
        """Scores of the parts, of hanging and of the carriers, shape (S, parts + 1 + carriers)."""
        points = seen.surface.points.astype(np.float32)
        centres, beside = points[:CENTRES], seen.beside[:, :BESIDE]
        piece = np.unique(seen.surface.part, return_inverse=True)[1]
        x = self._enter[1](gelu(self._enter[0](point_features(seen.surface))))
        x += gelu(self._piece(np.concatenate([x, _piece_mean(gelu(x.copy()), piece)], axis=1)))
        y = self._to_centres(x, points, CENTRES, seen.gather[:, :GATHERED])
        for block in self._before:
            y = block(y, centres, beside)
        z = self._to_tokens(y, centres, TOKENS, seen.gather_up[:, :GATHERED]) + self._where(waves(points[:TOKENS]))
        z = self._norm_tokens(z)[None]
        for layer in self._layers:
            z = layer(z)
        z = _blended(self._norm(z[0]), seen.down, seen.down_shares)
        y += self._down(np.concatenate([y, z], axis=1))
        for block in self._after:
            y = block(y, centres, beside)
        y = _blended(y, seen.fine, seen.fine_shares)
        y = gelu(self._last(np.concatenate([x, y], axis=1)))
        y += gelu(self._whole(np.concatenate([y, _piece_mean(y, piece)], axis=1)))
        return self._decoder[1](self._decoder[0](y))


def waves(points: np.ndarray) -> np.ndarray:
    """Positions as the tokens know them: as they are, and as sines and cosines, shape (M, 3) -> (M, WAVES)."""
    turns = np.concatenate([factor * points for factor in np.array([3, 6, 12], np.float32)], axis=1)
    return np.concatenate([2 * points, np.sin(turns), np.cos(turns)], axis=1)


def _piece_mean(x: np.ndarray, piece: np.ndarray) -> np.ndarray:
    """The mean of each channel over the loose part of each row, shape (N, C)."""
    order = np.argsort(piece, kind="stable")
    starts = np.flatnonzero(np.diff(piece[order], prepend=-1))
    count = np.diff(starts, append=len(piece))
    return np.asarray((np.add.reduceat(x[order], starts, axis=0) / count[:, None].astype(np.float32))[piece])


def _blended(x: np.ndarray, index: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Sums of three rows by shares."""
    shares = shares.astype(np.float32)
    out = x[index[:, 0]] * shares[:, :1]
    for column in (1, 2):
        out += x[index[:, column]] * shares[:, column : column + 1]
    return out


def load_parts(path: str | Path) -> PartNetwork:
    """Read a checkpoint of kind "parts", ready to use.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    return load_network(path, "parts", lambda shape, weights: PartNetwork(config_of(PartConfig, shape), weights))


@lru_cache(maxsize=2)
def _model(path: Path, changed: int) -> PartNetwork:
    return load_parts(path)


def find_parts(
    vertices: np.ndarray,
    faces: np.ndarray,
    colors: np.ndarray | None = None,
    checkpoint: str | Path | None = None,
) -> FoundParts:
    """What part each vertex is of, what carries it, and whether it hangs.

    Args:
        vertices: Rest mesh [m], +Y up and facing +Z, shape (V, 3).
        faces: Shape (F, 3).
        colors: sRGB from 0 to 1 of each vertex, shape (V, 3), or None.
        checkpoint: Weights of kind "parts"; None looks for "parts" (`lab_checkpoint`).

    Raises:
        CharacterError: The mesh is broken.
        WeightsError: The checkpoint is missing or does not fit.
    """
    model = _model(*dated(lab_checkpoint("parts") if checkpoint is None else Path(checkpoint)))
    vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
    own = loose_parts(vertices, faces)
    part = np.zeros(len(vertices), np.int64)  # strays are of any
    part[faces] = own[:, None]
    used = vertices[np.unique(faces)]
    low, high = used.min(axis=0), used.max(axis=0)
    placed = (vertices - 0.5 * (low + high)) / max(float((high - low).max()), 1e-12)
    count = len(PARTS)
    with one_thread():
        seen = part_points(vertices, faces, own, colors)
        # Painted or not, a part is the same: where there are colours, both answers count.
        plain = replace(seen, surface=replace(seen.surface, colors=None))
        scores = [model.scores(one) for one in ((plain,) if colors is None else (plain, seen))]
        likely = np.mean(
            [
                np.concatenate(
                    [softmax(row[:, :count]), sigmoid(row[:, count : count + 1]), softmax(row[:, count + 1 :])], axis=1
                )
                for row in scores
            ],
            axis=0,
        )
    total = _spread(placed, part, seen, likely)
    return FoundParts(total[:, :count], total[:, count], total[:, count + 1 :])


def _spread(placed: np.ndarray, part: np.ndarray, seen: PartPoints, values: np.ndarray) -> np.ndarray:
    """Values of points at the vertices, from the three nearest of the same loose part, or of any where it has none."""
    # Parts that lie on one another stay apart: each has a layer of its own along a fourth axis.
    layer = np.concatenate([placed, 4.0 * part[:, None]], axis=1)
    known = np.concatenate([seen.surface.points, 4.0 * seen.surface.part[:, None]], axis=1)
    gap, near = cKDTree(known).query(layer, 3)
    lost = gap[:, 0] >= 4
    if lost.any():
        gap[lost], near[lost] = cKDTree(seen.surface.points).query(placed[lost], 3)
    weight = 1 / (gap.clip(max=4) + 1e-4) * (gap < 4)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
    return np.asarray((values[near] * weight[..., None]).sum(axis=1), np.float32)
