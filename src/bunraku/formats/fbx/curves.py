"""The curves of FBX clips: keys with constant, linear and cubic spans, the tangents of the latter weighted or not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bunraku.formats.fbx.nodes import BROKEN, FbxTree
from bunraku.formats.fbx.scene import TICKS, FbxObject

__all__ = ["Curve", "read_curve"]

CONSTANT, CUBIC, NEXT, WEIGHTED_RIGHT, WEIGHTED_LEFT = 0x2, 0x8, 0x100, 0x0100_0000, 0x0200_0000
AUTO, TCB, USER, FLAT_AT_EQUAL, OVER_TIME, PROGRESSIVE = (
    0x100,
    0x200,
    0x400,
    0x1000,
    0x2000,
    0x4000,
)  # how a cubic key gets its tangents
WEIGHT_UNIT = 9999.0


@dataclass(frozen=True, eq=False)
class Curve:
    """One number over time.

    Args:
        times: Of the keys [s], ascending, shape (M,).
        values: At the keys, shape (M,).
        flags: How each key goes to the next, shape (M,).
        slopes: Slopes after each key and before the next [1/s], shape (M, 2).
        weights: Lengths of these tangents as a share of the span, shape (M, 2).
    """

    times: np.ndarray
    values: np.ndarray
    flags: np.ndarray
    slopes: np.ndarray
    weights: np.ndarray

    def at(self, moments: np.ndarray) -> np.ndarray:
        """Values at moments [s], held before the first key and after the last, shape (N,)."""
        times, values = self.times, self.values
        before = np.clip(np.searchsorted(times, moments, side="right") - 1, 0, len(times) - 1)
        after = np.minimum(before + 1, len(times) - 1)
        span = times[after] - times[before]
        share = np.clip((moments - times[before]) / np.where(span > 0, span, 1), 0, 1)
        start, end, flags = values[before], values[after], self.flags[before]
        out = start + (end - start) * share
        held = (flags & CONSTANT) > 0
        out = np.where(held, np.where((flags & NEXT) > 0, end, start), out)
        curved = np.flatnonzero(((flags & CUBIC) > 0) & ~held & (after > before))
        if len(curved):
            rows = before[curved]
            out[curved] = _cubic(
                share[curved], start[curved], end[curved], span[curved], self.slopes[rows], self.weights[rows]
            )
        return np.where(share <= 0, start, np.where(share >= 1, end, out))


def _cubic(
    share: np.ndarray, start: np.ndarray, end: np.ndarray, span: np.ndarray, slopes: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """A Bezier curve over time whose inner points lie on the tangents, at shares of its span."""
    right, left = weights[:, 0], weights[:, 1]
    s = share.copy()
    bent = np.flatnonzero((np.abs(right - 1 / 3) > 1e-3) | (np.abs(left - 1 / 3) > 1e-3))
    if len(bent):  # time itself bends: find the parameter by bisection, time only goes forward
        low, high = np.zeros(len(bent)), np.ones(len(bent))
        for _ in range(40):
            middle = (low + high) / 2
            time = (
                3 * (1 - middle) ** 2 * middle * right[bent]
                + 3 * (1 - middle) * middle**2 * (1 - left[bent])
                + middle**3
            )
            low, high = np.where(time < share[bent], middle, low), np.where(time < share[bent], high, middle)
        s[bent] = (low + high) / 2
    first, second = start + right * span * slopes[:, 0], end - left * span * slopes[:, 1]
    out: np.ndarray = (1 - s) ** 3 * start + 3 * (1 - s) ** 2 * s * first + 3 * (1 - s) * s**2 * second + s**3 * end
    return out


def read_curve(tree: FbxTree, thing: FbxObject) -> Curve | None:
    """The curve of an AnimationCurve object, None where it has no keys.

    Raises:
        FormatError: Its keys do not fit together.
    """
    times, values = thing.node.array("KeyTime") / TICKS, thing.node.array("KeyValueFloat").astype(float)
    if len(times) != len(values) or not np.isfinite(values).all() or (np.diff(times) < 0).any():
        tree.fail(f"a curve of a clip has keys that do not fit together; {BROKEN}")
    if not len(times):
        return None
    flags, data, counts = (thing.node.array(name) for name in ("KeyAttrFlags", "KeyAttrDataFloat", "KeyAttrRefCount"))
    known = (
        len(flags) == len(counts)
        and counts.min(initial=1) >= 1
        and int(counts.astype(float).sum()) == len(times)
        and len(data) == 4 * len(flags)
    )
    if not known or not len(flags):  # without what says how to go from key to key, straight on
        straight = np.zeros((len(times), 2))
        return Curve(times, values, np.zeros(len(times), np.int64), straight, straight + 1 / 3)
    data = data.reshape(-1, 4)
    packed = data[:, 2].astype(np.float32).view(np.int32)
    weights = np.stack([packed & 0xFFFF, (packed >> 16) & 0xFFFF], 1) / WEIGHT_UNIT
    flags = flags.astype(np.int64)
    used = np.stack([(flags & WEIGHTED_RIGHT) > 0, (flags & WEIGHTED_LEFT) > 0], 1)
    weights = np.where(used, np.clip(weights, 0, 1), 1 / 3)
    slopes = np.nan_to_num(data[:, :2], posinf=0, neginf=0)
    counts = counts.astype(np.int64)
    flags, slopes, weights = (np.repeat(each, counts, axis=0) for each in (flags, slopes, weights))
    return Curve(times, values, flags, _with_auto(times, values, flags, slopes), weights)


def _with_auto(times: np.ndarray, values: np.ndarray, flags: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """The slopes with those computed that a key leaves to the program, which stores nothing for them, shape (M, 2)."""
    own = ((flags & CUBIC) > 0) & ((flags & (AUTO | TCB)) > 0) & ((flags & USER) == 0)
    if len(times) < 2 or not own.any():
        return slopes
    span = np.diff(times)
    secant = np.diff(values) / np.where(span > 0, span, 1)
    left, right = np.concatenate([secant[:1], secant]), np.concatenate([secant, secant[-1:]])
    gap = np.concatenate([span[:1], times[2:] - times[:-2], span[-1:]])
    over_time = np.concatenate(
        [secant[:1], (values[2:] - values[:-2]) / np.where(gap[1:-1] > 0, gap[1:-1], 1), secant[-1:]]
    )
    slope = np.where((flags & OVER_TIME) > 0, over_time, (left + right) / 2)
    limit = 3 * np.minimum(np.abs(left), np.abs(right))
    limited = np.where(left * right > 0, np.clip(slope, -limit, limit), 0)  # never beyond the values of its neighbours
    limited[[0, -1]] = 0
    slope = np.where((flags & PROGRESSIVE) > 0, limited, slope)
    slope = np.where(((flags & FLAT_AT_EQUAL) > 0) & ((left == 0) | (right == 0)), 0, slope)
    out = slopes.copy()
    out[own, 0] = slope[own]
    out[:-1, 1] = np.where(own[1:], slope[1:], slopes[:-1, 1])
    return out
