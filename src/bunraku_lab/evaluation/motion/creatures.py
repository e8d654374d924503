"""Whether one can tell what a creature does, by a classifier that was fitted to real clips of the species that training
sees.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bunraku.core.motion import HandleMotion
from bunraku.errors import FormatError
from bunraku_lab.datasets.motions.clips import load_clip, load_index
from bunraku_lab.evaluation.motion.classifier import ActionClassifier, fit_classifier

__all__ = [
    "CLASSES", "CreatureCase", "creature_accuracy", "load_cases", "main_action", "real_accuracy", "train_classifier",
]  # fmt: skip

CLASSES: tuple[str, ...] = ("walk", "run", "attack", "death", "idle", "swim")
_SAME = {
    "gallop": "run", "trot": "run", "run carry": "run", "carry": "walk", "headbutt": "attack", "kick": "attack",
    "bite": "attack", "punch": "attack",
    "slash": "attack", "swim fast": "swim", "swim impulse": "swim", "idle head low": "idle", "hover": "idle",
}  # fmt: skip


def main_action(action: str) -> str:
    """The class of an action: "gallop" is a run, "bite" an attack; actions of no class stay themselves."""
    return _SAME.get(action, action)


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


def train_classifier(cases: Sequence[CreatureCase]) -> ActionClassifier:
    """Fit the classifier to real clips."""
    return fit_classifier(
        [case.motion for case in cases], [case.action for case in cases], [case.weight for case in cases]
    )


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
    """How often generated clips of held-out species are recognised as what was requested.

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
