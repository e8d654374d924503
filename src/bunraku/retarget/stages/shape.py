"""Stages for the surface: jitter is filtered out, and edges keep their lengths (the ARAP objective, Eq. 10 of
TapMo).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix
from threadpoolctl import ThreadpoolController

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.character import Character, Handles
from bunraku.core.geometry.curves import correlated, gaussian
from bunraku.core.geometry.rotations import Resampling, matrix_from_6d, matrix_to_6d
from bunraku.core.motion import HandleMotion, handle_offsets
from bunraku.retarget.stages.stage import Fitting, Stage

KERNEL = np.array([-1, 4, 10, 4, -1]) / 16
"""Maximally flat: keeps cubic motion as it is, and nothing at half the frame rate."""


@dataclass(frozen=True)
class Smooth(Stage, name="smooth"):
    """The generator's noise is taken out; fast moves stay."""

    local: float = 0.1  # over how long power is measured [s]
    floor: float = 0.25  # the noise floor is exceeded by the power of all frames but this share
    margin: float = 4.0  # power under so many times the floor is noise
    # The floor is no higher than this in an entry of a rotation; captured clips have more detail.
    most_turn: float = 0.003
    most_shift: float = 0.0006  # likewise of a position [m]
    least: int = 5  # shorter clips have no floor to be measured [frames]

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        return Fitting.of(self.smoothed(fitting.source), anatomy, fitting.heights)

    def _cored(self, signal: np.ndarray, most: float, fps: float) -> np.ndarray:
        """A signal (N, ..., C) without what is fast and weak in it; the C channels share their power."""
        slow = correlated(signal, KERNEL, edge="mirror")
        fast = signal - slow
        power = gaussian((fast**2).mean(axis=-1), self.local * fps)
        floor = np.minimum(np.quantile(power, self.floor, axis=0), most**2)
        gain = np.maximum(0, 1 - self.margin * floor / np.maximum(power, 1e-20))
        return np.asarray(slow + gain[..., None] * fast)

    def smoothed(self, motion: HandleMotion) -> HandleMotion:
        """The motion of the reference body without its jitter; fast moves keep their speed."""
        if len(motion) < self.least:
            return motion
        fps = motion.fps
        rotations = matrix_from_6d(self._cored(matrix_to_6d(motion.rotations.astype(np.float64)), self.most_turn, fps))
        root = matrix_from_6d(self._cored(matrix_to_6d(motion.root_rotation.astype(np.float64)), self.most_turn, fps))
        translations = self._cored(motion.translations.astype(np.float64), self.most_shift, fps)
        rotations[:, 0], translations[:, 0] = np.eye(3), 0
        path = self._cored(motion.root_translation.astype(np.float64), self.most_shift, fps)
        return replace(
            motion, rotations=rotations, translations=translations, root_rotation=root, root_translation=path
        )


PIECE = 1 << 15
"""Edges that are looked at together, few enough for the cache."""
_ROWS, _COLUMNS = np.triu_indices(3)
_BLOCK = np.array([0, 1, 2, 1, 3, 4, 2, 4, 5])
"""Where each number of a symmetric matrix (3, 3) is in its upper half."""
_FACTORS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)


@dataclass(frozen=True)
class Shape(Stage, name="shape"):
    """Handles move a little where that keeps the mesh's edges at their lengths."""

    looked_at: int = 20_000  # edges among which those are found that can change: a sample, where a mesh has more
    edges: int = 1000  # how many of them count
    # How much the squared changes of length count beside the squared move of the handles [m^2 of the reference body].
    strength: float = 0.2
    # ARAP-Loss that a character may have before the strength is taken back, so that one that distorts a lot by nature
    # is not pulled about.
    calm: float = 0.15
    longest: float = 0.04  # no handle is moved farther [m of the reference body]
    steps: int = 2  # gauss-Newton steps
    stride: int = 2  # every this many frames are solved; the moves between them are blended
    chunk: int = 32  # frames that are solved at once

    def applies(self, fitting: Fitting, anatomy: Anatomy) -> bool:
        return not anatomy.handles.rigid

    def __call__(self, fitting: Fitting, anatomy: Anatomy) -> Fitting:
        moves = self.moves(fitting.rotations, fitting.translations, anatomy.character, anatomy.handles, anatomy.scale)
        return replace(fitting, translations=fitting.translations + moves)

    def moves(
        self, rotations: np.ndarray, translations: np.ndarray, character: Character, handles: Handles, scale: float
    ) -> np.ndarray:
        """What to add to local translations (N, K, 3) so that the mesh is stretched less [m]; the root's share is zero.
        `scale` is the character's size over the reference body's.
        """
        system = _System.of(character, handles, self)
        if system is None:
            return np.zeros(translations.shape)
        frames = np.append(np.arange(0, len(translations) - 1, self.stride), len(translations) - 1)
        parts = [frames[start : start + self.chunk] for start in range(0, len(frames), self.chunk)]
        with _libraries().limit(limits=1, user_api="blas"):  # of small products threads would wait for each other
            moved = np.concatenate(
                [system.solved(rotations[part], translations[part], handles.positions, scale) for part in parts]
            )
        at = np.interp(np.arange(len(translations)), frames, np.arange(len(frames)))
        low = at.astype(int)
        high = np.minimum(low + 1, len(frames) - 1)
        return Resampling(low, high, at - low).linear(moved.astype(float))

    def some_edges(self, character: Character) -> tuple[np.ndarray, int]:
        """At most `looked_at` edges, and how many there are; edges at the same position count once.

        They are drawn by a hash of the position of their middle, so neither seams nor the order of vertices and faces
        make a difference.
        """
        edges = character.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        edges = edges[edges[:, 0] != edges[:, 1]]
        used = character.vertices[character.surface]
        low = used.min(axis=0)
        # coarse enough that rounding of coordinates hardly ever matters
        fine = 2**13 / float(np.ptp(used, axis=0).max())
        halves = np.ascontiguousarray(((character.vertices - low) * np.float32(fine / 2)).T)
        position = np.empty(len(edges), np.uint64)
        for start in range(0, len(edges), PIECE):
            first, second = edges[start : start + PIECE].T
            position[start : start + PIECE] = _hashed([
                np.floor(along.take(first) + along.take(second) + np.float32(0.37)).astype(np.int64) for along in halves
            ])  # fmt: skip
        ordered = np.sort(position)
        fresh = np.ones(len(ordered), bool)
        fresh[1:] = ordered[1:] != ordered[:-1]
        ordered = ordered[fresh]
        chosen = np.flatnonzero(position <= ordered[: self.looked_at].max(initial=0))
        return edges[chosen[np.unique(position[chosen], return_index=True)[1]]], len(ordered)


def _hashed(places: Sequence[np.ndarray]) -> np.ndarray:
    """A number for each place of a grid, its coordinates of shape (n,) -> (n,), as the finishing steps of splitmix64
    make it.
    """
    x, y, z = (along.astype(np.uint64) * factor for along, factor in zip(places, _FACTORS, strict=True))
    out: np.ndarray = x + y + z
    out ^= out >> np.uint64(29)
    out *= np.uint64(0xBF58476D1CE4E5B9)
    out ^= out >> np.uint64(32)
    return out


@functools.cache
def _libraries() -> ThreadpoolController:
    """The libraries that numpy multiplies with; looking for them takes longer than to set their threads."""
    return ThreadpoolController()


class _System:
    """Sampled edges of a character, and the handles that move their ends differently.

    An edge hears of three or four of the 30 handles, so all that goes over edges and handles are sparse products, of
    all frames side by side.
    """

    def __init__(self, stage: Shape, ends: np.ndarray, weights: np.ndarray, share: float, size: float):
        self.stage, self.share = stage, share
        apart = weights[:, 0] - weights[:, 1]  # (S, K)
        moments = weights[..., None] * ends[:, :, None]
        self.apart = csr_matrix(apart / size)
        self.moments = csr_matrix((moments[:, 0] - moments[:, 1]).reshape(len(ends), -1) / size)  # (S, 3K)
        self.rest = (np.linalg.norm(ends[:, 0] - ends[:, 1], axis=-1) / size).astype(np.float32)[:, None]
        self.held = np.flatnonzero(apart.any(axis=0))  # (H,); a handle that changes no edge stays where it is
        slope = (apart[:, self.held] / size).astype(np.float32)
        self.slope, self.back = csr_matrix(slope), csr_matrix(slope.T)
        first, second = np.triu_indices(len(self.held))
        both = np.any((slope[:, first] != 0) & (slope[:, second] != 0), axis=0)
        self.pair = first[both], second[both]
        self.products = csr_matrix((slope[:, self.pair[0]] * slope[:, self.pair[1]]).T)  # (pairs, S)

    @classmethod
    def of(cls, character: Character, handles: Handles, stage: Shape) -> _System | None:
        """The edges whose ends are moved differently, None where there are none."""
        edges, count = stage.some_edges(character)
        apart = np.abs(handles.weights[edges[:, 0]] - handles.weights[edges[:, 1]]).sum(axis=1) > 1e-3
        total = count * apart.mean()
        edges = edges[apart][: stage.edges]
        if not len(edges):
            return None
        size = float(np.ptp(character.vertices[character.surface], axis=0).max())
        ends, weights = character.vertices[edges].astype(float), handles.weights[edges].astype(float)
        return cls(stage, ends, weights, total / len(edges), size)

    def solved(
        self, rotations: np.ndarray, translations: np.ndarray, positions: np.ndarray, scale: float
    ) -> np.ndarray:
        """Gauss-Newton steps from no move at all, each frame on its own."""
        frames, handles = translations.shape[:2]
        offset = handle_offsets(positions, translations, rotations)
        base = self.moments @ rotations.transpose(1, 3, 0, 2).reshape(handles * 3, frames * 3)
        base += self.apart @ offset.transpose(1, 0, 2).reshape(handles, frames * 3)
        base = base.astype(np.float32)  # (S, 3N), as all that has edges in rows
        held, (first, second) = len(self.held), self.pair
        moved, weight = np.zeros((held, frames, 3), np.float32), None
        eye = np.eye(3 * held) / scale**2
        for _ in range(self.stage.steps):
            edges = (base + self.slope @ moved.reshape(held, -1)).reshape(-1, frames, 3)
            length = np.sqrt(np.einsum("sni,sni->sn", edges, edges) + np.float32(1e-12))
            change = length - self.rest
            if weight is None:
                loss = float(np.square(change).sum(axis=0).mean()) * self.share
                weight = self.stage.strength / (loss + self.stage.calm) * self.share
            edges /= length[..., None]
            turned = (edges[..., _ROWS] * edges[..., _COLUMNS]).reshape(len(edges), -1)
            blocks = (self.products @ turned).reshape(-1, frames, 6)[..., _BLOCK].reshape(-1, frames, 3, 3)
            square = np.zeros((frames, held, 3, held, 3))
            square[:, first, :, second] = square[:, second, :, first] = weight * blocks
            edges *= change[..., None]
            side = weight * (self.back @ edges.reshape(len(edges), -1)).reshape(held, frames, 3) + moved / scale**2
            system = square.reshape(frames, 3 * held, -1) + eye
            step = np.linalg.solve(system, side.transpose(1, 0, 2).reshape(frames, -1, 1))
            moved = moved - step.reshape(frames, held, 3).transpose(1, 0, 2)
            far = np.linalg.norm(moved, axis=-1, keepdims=True)
            moved = (moved * np.minimum(self.stage.longest * scale / np.maximum(far, 1e-12), 1)).astype(np.float32)
            moved[self.held == 0] = 0
        out = np.zeros((frames, handles, 3), np.float32)
        out[:, self.held] = moved.transpose(1, 0, 2)
        return out
