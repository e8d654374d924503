"""Whether one can tell what a creature does: a classifier of actions, trained on real clips of the species that
training sees.

A motion is described part by part (root, spine, head, arms, legs, tail, wings), so that a fish without legs and a horse
without wings are told by the same numbers: how far a part moves, how fast, how suddenly, how far it is in the end from
where it began, and how lively it still is then; and by the spectrum of the whole body. A multinomial logistic
regression tells the classes apart; it is convex, so the same clips give the same classifier.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.motion import HandleMotion
from bunraku.datasets.motions.clips import load_clip, load_index
from bunraku.diffusion.features import ROOT_SIZE, encode
from bunraku.errors import FormatError

__all__ = [
    "CLASSES", "ActionClassifier", "CreatureCase", "action_features", "creature_accuracy", "load_cases", "main_action",
    "real_accuracy",
    "train_classifier",
]  # fmt: skip

CLASSES: tuple[str, ...] = ("walk", "run", "attack", "death", "idle", "swim")
_SAME = {
    "gallop": "run", "trot": "run", "run carry": "run", "carry": "walk", "headbutt": "attack", "kick": "attack",
    "bite": "attack", "punch": "attack",
    "slash": "attack", "swim fast": "swim", "swim impulse": "swim", "idle head low": "idle", "hover": "idle",
}  # fmt: skip
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
WINDOW = 64
RIDGE = 5.0
LONG = 60  # frames: clips shorter than this are also shown played on, as generated ones last longer


def main_action(action: str) -> str:
    """The class of an action: "gallop" is a run, "bite" an attack; actions of no class stay themselves."""
    return _SAME.get(action, action)


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


@dataclass(frozen=True)
class CreatureCase:
    """A real clip of a creature.

    Args:
        name: Of the clip in the index.
        action: Its class.
        species: What the creature is.
        character: Its name in the mesh bank.
        text: A sentence that says it all.
        motion: Of the reference body.
        weight: How much it counts.
    """

    name: str
    action: str
    species: str
    character: str
    text: str
    motion: HandleMotion
    weight: float = 1.0


def load_cases(folder: str | Path, held_out: bool) -> list[CreatureCase]:
    """Clips of creatures in the classes, from what `bunraku data motions --creatures` wrote.

    Args:
        folder: With `index.json`.
        held_out: The species and characters that no training sees ("test"), or those of "train".

    Raises:
        FormatError: The index or a clip is missing or damaged, or there is no such clip.
    """
    folder, wanted = Path(folder), "test" if held_out else "train"
    cases = [
        CreatureCase(
            name, main_action(entry["action"]), str(entry["species"]), str(entry["character"]), str(entry["texts"][0]),
            load_clip(folder / f"{name}.npz"), float(entry.get("weight", 1.0)),
        )
        for name, entry in sorted(load_index(folder).items())
        if entry.get("species") and entry.get("split") == wanted and main_action(entry.get("action", "")) in CLASSES
    ]  # fmt: skip
    if not cases:
        raise FormatError(folder, "there are no clips of creatures; build them with 'bunraku data motions --creatures'")
    return cases


def _played_on(motion: HandleMotion) -> HandleMotion:
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
        weights: Shape (D + 1, 6), the last row for the constant.
    """

    mean: np.ndarray
    scale: np.ndarray
    weights: np.ndarray

    def inputs(self, motions: Sequence[HandleMotion]) -> np.ndarray:
        """Standardised features with a constant column, shape (M, D + 1)."""
        raw = np.stack([action_features(motion) for motion in motions])
        return np.column_stack([np.clip((raw - self.mean) / self.scale, -4, 4), np.ones(len(raw))])

    def predict(self, motions: Sequence[HandleMotion]) -> list[str]:
        """The class of each motion."""
        return [CLASSES[index] for index in (self.inputs(motions) @ self.weights).argmax(axis=1)]


def train_classifier(cases: Sequence[CreatureCase]) -> ActionClassifier:
    """Fit the classifier to real clips, each also played on; all classes count the same in all."""
    motions = [
        motion
        for case in cases
        for motion in ([case.motion, _played_on(case.motion)] if len(case.motion) < LONG else [case.motion])
    ]
    labels = np.array(
        [CLASSES.index(case.action) for case in cases for _ in range(2 if len(case.motion) < LONG else 1)]
    )
    weights = np.array([case.weight for case in cases for _ in range(2 if len(case.motion) < LONG else 1)])
    total = np.bincount(labels, weights, len(CLASSES))
    weights = weights / np.maximum(total, 1e-9)[labels] * len(labels) / np.count_nonzero(total)
    raw = np.stack([action_features(motion) for motion in motions])
    empty = ActionClassifier(raw.mean(axis=0), raw.std(axis=0) + 1e-6, np.zeros((raw.shape[1] + 1, len(CLASSES))))
    inputs = np.column_stack([np.clip((raw - empty.mean) / empty.scale, -4, 4), np.ones(len(raw))])
    rows = np.arange(len(labels))

    def loss(flat: np.ndarray) -> tuple[float, np.ndarray]:
        theta = flat.reshape(empty.weights.shape)
        scores = inputs @ theta
        scores -= scores.max(axis=1, keepdims=True)
        share = np.exp(scores)
        share /= share.sum(axis=1, keepdims=True)
        value = -float(weights @ np.log(share[rows, labels] + 1e-12)) + 0.5 * RIDGE * float((theta[:-1] ** 2).sum())
        share[rows, labels] -= 1
        slope = inputs.T @ (share * weights[:, None])
        slope[:-1] += RIDGE * theta[:-1]
        return value, slope.ravel()

    found = minimize(loss, empty.weights.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": 1000})
    return ActionClassifier(empty.mean, empty.scale, found.x.reshape(empty.weights.shape))


def _table(cases: Sequence[CreatureCase], predicted: Sequence[str]) -> dict[str, Any]:
    """Share told rightly, overall ("accuracy"), as the mean over classes ("balanced"), and by class, with all
    confusions.
    """
    confusion = {name: dict.fromkeys(CLASSES, 0) for name in CLASSES}
    for case, answer in zip(cases, predicted, strict=True):
        confusion[case.action][answer] += 1
    by_class = {name: row[name] / sum(row.values()) for name, row in confusion.items() if sum(row.values())}
    right = sum(confusion[name][name] for name in CLASSES)
    return {
        "accuracy": right / len(cases),
        "balanced": float(np.mean(list(by_class.values()))),
        "by_class": by_class,
        "confusion": confusion,
    }


def real_accuracy(classifier: ActionClassifier, cases: Sequence[CreatureCase]) -> dict[str, Any]:
    """How well the classifier tells real clips: `accuracy`, `balanced` (mean over classes), `by_class` and
    `confusion`.
    """
    return _table(cases, classifier.predict([case.motion for case in cases]))


def creature_accuracy(
    generate: Callable[[str, np.ndarray | None, float, int], HandleMotion],
    data: str | Path,
    features: Mapping[str, np.ndarray],
    *,
    seconds: float = 3.0,
    seeds: Sequence[int] = (0,),
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """How often generated clips of held-out species are told to be what was asked for.

    Args:
        generate: Called with a sentence, f_phi of the character (448,) or None, a length [s] and a seed; gives a motion
            of the reference body.
        data: What `bunraku data motions --creatures` wrote.
        features: f_phi of each character by its name (the mesh bank).
        seconds: Length of each clip [s].
        seeds: Each sentence is generated once with each.
        progress: Called with the number of clips done and of all.

    Returns:
        `accuracy`, `balanced`, `by_class` and `confusion` of the generated clips; `real`: the same of the real held-out
        clips; `clips`: how many were generated; `wrong`: (sentence, character, told as) of each failure.

    Raises:
        FormatError: The data hold no clips of creatures.
    """
    classifier, held = train_classifier(load_cases(data, held_out=False)), load_cases(data, held_out=True)
    asked: dict[tuple[str, str, str], CreatureCase] = {}
    for case in held:
        asked.setdefault((case.character, case.action, case.text), case)
    cases = [case for case in asked.values() for _ in seeds]
    predicted: list[str] = []
    for number, case in enumerate(cases):
        motion = generate(case.text, features.get(case.character), seconds, seeds[number % len(seeds)])
        predicted += classifier.predict([motion])
        if progress:
            progress(number + 1, len(cases))
    wrong = [
        (case.text, case.character, answer)
        for case, answer in zip(cases, predicted, strict=True)
        if answer != case.action
    ]
    return {**_table(cases, predicted), "real": real_accuracy(classifier, held), "clips": len(cases), "wrong": wrong}
