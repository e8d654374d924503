"""A classifier of actions: what somebody, person or creature, does in a motion.

A motion is described part by part (root, spine, head, arms, legs, tail, wings), so that a fish without legs and a horse
without wings are told by the same numbers: how far a part moves, how fast, how suddenly, how far it is in the end from
where it began, and how lively it still is then; and by the spectrum of the whole body. A multinomial logistic
regression tells the classes apart; it is convex, so the same clips give the same classifier.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.motion import HandleMotion
from bunraku.diffusion.features import ROOT_SIZE, encode

__all__ = ["LONG", "ActionClassifier", "action_features", "fit_classifier", "played_on"]

_KINDS = (
    ("spine1", "spine2", "spine3"), ("neck", "head", "head_top", "face"), ("shoulder", "elbow", "wrist"), ("hip",
    "knee", "ankle"),
    ("tail", "tail_tip"), ("wing",),
)  # fmt: skip
_PARTS = [
    [i - 1 for i, name in enumerate(HANDLE_NAMES) if name.removeprefix("left_").removeprefix("right_") in kind]
    for kind in _KINDS
]
_BANDS = (1, 3, 5, 8, 13, 33)  # edges of the spectrum's bands, in cycles over WINDOW frames
Describe = Callable[[HandleMotion], np.ndarray]
WINDOW = 64
RIDGE = 5.0
LONG = 60  # frames: clips shorter than this are also shown played on, as generated ones last longer


def _log(value: float) -> float:
    return float(np.log(value + 0.02))


def _course(values: np.ndarray, fps: float) -> list[float]:
    """How numbers (N, D) run: extent, speed, and how they end."""
    speed = np.linalg.norm(np.diff(values, axis=0), axis=1) * fps
    edge = max(1, len(values) // 6)
    extent = _log(float(np.sqrt(values.var(axis=0).sum())))
    mean, peak, end = (
        _log(float(np.sqrt((speed**2).mean()))),
        _log(float(speed.max())),
        _log(float(speed[-edge:].mean())),
    )
    change = _log(float(np.linalg.norm(values[-edge:].mean(axis=0) - values[:edge].mean(axis=0))))
    reach = _log(float(np.linalg.norm(values - values[0], axis=1).max()))
    return [extent, mean, peak, change, reach, end, mean - extent, peak - mean, change - extent, end - mean]


def _spectrum(poses: np.ndarray) -> list[float]:
    """Shares of the bands in the power of poses (N, D), played again where they are shorter than the window."""
    poses = poses - poses.mean(axis=0)
    poses = np.tile(poses, (-(-WINDOW // len(poses)), 1))[:WINDOW]
    power = (np.abs(np.fft.rfft(poses, axis=0)) ** 2).sum(axis=1)
    power /= power[1:].sum() + 1e-9
    return [_log(float(power[start:stop].sum())) for start, stop in zip(_BANDS, _BANDS[1:], strict=False)]


def action_features(motion: HandleMotion) -> np.ndarray:
    """What the classifier sees of a motion of the reference body with at least two frames, shape (96,)."""
    x, fps = encode(motion).astype(np.float64), motion.fps
    local = x[:, ROOT_SIZE:].reshape(len(x), -1, 9)[..., 3:]
    edge = max(1, len(x) // 6)
    turned = x[-edge:, 4:10].mean(axis=0) - x[:edge, 4:10].mean(axis=0)
    out = _course(x[:, 3:4], fps) + _course(x[:, 4:10], fps)
    out += [
        x[:, 1].mean(),
        x[:, 2].mean(),
        _log(np.abs(x[:, 2]).mean()),
        _log(x[:, 1:3].std(axis=0).sum()),
        _log(x[:, 0].std()),
    ]
    out += [x[:, 3].mean(), x[:, 3].min(), x[:, 3].max(), x[-edge:, 3].mean(), turned[4], turned[0]]
    for part in _PARTS:
        out += _course(local[:, part].reshape(len(x), -1), fps)
    return np.array(out + _spectrum(local.reshape(len(x), -1)))


def played_on(motion: HandleMotion) -> HandleMotion:
    """The motion played on to `LONG` frames: again from its start where it ends as it began, with its last pose held
    otherwise.
    """
    frames, poses = len(motion), motion.rotations.reshape(len(motion), -1)
    step = np.linalg.norm(np.diff(poses, axis=0), axis=1).max(initial=0) if frames > 1 else 0.0
    loops = frames > 2 and np.linalg.norm(poses[-1] - poses[0]) <= 1.5 * step
    order = np.arange(LONG) % frames if loops else np.minimum(np.arange(LONG), frames - 1)
    path = motion.root_translation[order].astype(np.float64)
    if loops:  # where it goes, it goes on
        rounds = np.arange(LONG) // frames
        path[:, [0, 2]] += np.outer(
            rounds, (motion.root_translation[-1] - motion.root_translation[0])[[0, 2]] * frames / (frames - 1)
        )
    return replace(motion.take(order), root_translation=path)


@dataclass(frozen=True, eq=False)
class ActionClassifier:
    """A multinomial logistic regression over `action_features`.

    Args:
        mean, scale: That bring features to about zero and one, shape (D,).
        weights: Shape (D + 1, C), the last row for the constant.
        classes: Names of the C classes.
        describe: What it sees of a motion, shape (D,).
    """

    mean: np.ndarray
    scale: np.ndarray
    weights: np.ndarray
    classes: tuple[str, ...]
    describe: Describe = action_features

    def inputs(self, motions: Sequence[HandleMotion]) -> np.ndarray:
        """Standardised features with a constant column, shape (M, D + 1)."""
        raw = np.stack([self.describe(motion) for motion in motions])
        return np.column_stack([np.clip((raw - self.mean) / self.scale, -4, 4), np.ones(len(raw))])

    def predict(self, motions: Sequence[HandleMotion]) -> list[str]:
        """The class of each motion."""
        return [self.classes[index] for index in (self.inputs(motions) @ self.weights).argmax(axis=1)]


def fit_classifier(
    motions: Sequence[HandleMotion],
    labels: Sequence[str],
    weights: Sequence[float] | None = None,
    describe: Describe = action_features,
) -> ActionClassifier:
    """Fit the classifier; short motions are also shown played on, and all classes count the same in all.

    Args:
        motions: M motions of the reference body.
        labels: The class of each.
        weights: How much each counts within its class; all the same when None.
        describe: What it sees of a motion, shape (D,).
    """
    classes = tuple(sorted(set(labels)))
    own = [1.0] * len(labels) if weights is None else list(weights)
    shown = [
        (some, classes.index(label), worth)
        for motion, label, worth in zip(motions, labels, own, strict=True)
        for some in ([motion, played_on(motion)] if len(motion) < LONG else [motion])
    ]
    targets, worths = np.array([row[1] for row in shown]), np.array([row[2] for row in shown])
    total = np.bincount(targets, worths, len(classes))
    worths = worths / np.maximum(total, 1e-9)[targets] * len(targets) / np.count_nonzero(total)
    raw = np.stack([describe(row[0]) for row in shown])
    mean, scale = raw.mean(axis=0), raw.std(axis=0) + 1e-6
    inputs = np.column_stack([np.clip((raw - mean) / scale, -4, 4), np.ones(len(raw))])
    shape, rows = (raw.shape[1] + 1, len(classes)), np.arange(len(targets))

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        theta = flat.reshape(shape)
        scores = inputs @ theta
        scores -= scores.max(axis=1, keepdims=True)
        share = np.exp(scores)
        share /= share.sum(axis=1, keepdims=True)
        value = -float(worths @ np.log(share[rows, targets] + 1e-12)) + 0.5 * RIDGE * float((theta[:-1] ** 2).sum())
        share[rows, targets] -= 1
        slope = inputs.T @ (share * worths[:, None])
        slope[:-1] += RIDGE * theta[:-1]
        return value, slope.ravel()

    found = minimize(loss, np.zeros(shape[0] * shape[1]), jac=True, method="L-BFGS-B", options={"maxiter": 1000})
    return ActionClassifier(mean, scale, found.x.reshape(shape), classes, describe)
