"""A blind study on disk: its trials, what each clip is, and the answers.

`study.json` holds the trials as the page may know them, `key.json` which method made which clip and which trials are
checks, `answers.jsonl` one line for each answered trial. Ranks are 1 for the best.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bunraku.errors import FormatError

__all__ = ["FROZEN", "QUESTIONS", "Answer", "Study", "load_answers", "load_study"]

QUESTIONS = {
    "overall": "Overall quality: which motion is the best?",
    "text": "Text: which one does what the sentence says?",
    "geometry": "Geometry: which one keeps its shape best, without tears, folds and parts that cut through?",
}
"""What is ranked, in the paper's words, with what a participant reads."""
FROZEN = "(frozen)"
"""The method of a clip that does not move, put there to see who looks."""
LARGEST = 64 << 20
VERSION = 1


@dataclass(frozen=True)
class Study:
    """The trials of a study.

    Args:
        folder: Where it lies.
        trials: Each with `id`, `prompt`, `character` and the names of its `clips`.
        methods: Method of each clip.
        repeats: Trial that another one repeats, by its id.
    """

    folder: Path
    trials: tuple[dict[str, Any], ...]
    methods: dict[str, str]
    repeats: dict[str, str] = field(default_factory=dict)

    @property
    def compared(self) -> list[str]:
        """The methods, sorted, without those of checks."""
        return sorted(set(self.methods.values()) - {FROZEN})

    def trial(self, name: str) -> dict[str, Any] | None:
        """A trial by its id."""
        return next((trial for trial in self.trials if trial["id"] == name), None)

    def is_check(self, name: str) -> bool:
        """Whether a trial is there to see who looks."""
        trial = self.trial(name)
        return name in self.repeats or (
            trial is not None and any(self.methods[clip] == FROZEN for clip in trial["clips"])
        )


@dataclass(frozen=True)
class Answer:
    """What one person says of one trial.

    Args:
        participant: Who.
        trial: Its id.
        ranks: For each question the rank of each clip, by its name, 1 for the best.
        seconds: How long it took [s].
    """

    participant: str
    trial: str
    ranks: dict[str, dict[str, int]]
    seconds: float = 0.0


def _object(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > LARGEST:
            raise FormatError(path, "it is too large to be a study; make it again")
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError:
        raise FormatError(path, "there is no such file; make the study with `bunraku study make`") from None
    except ValueError:
        raise FormatError(path, "it is broken; make the study again") from None
    if not isinstance(found, dict) or found.get("version") != VERSION:
        raise FormatError(path, "it is no study of this version of Bunraku; make it again")
    return found


def load_study(folder: Path) -> Study:
    """Read a study.

    Raises:
        FormatError: There is none, or it is broken.
    """
    trials, key = _object(folder / "study.json"), _object(folder / "key.json")
    try:
        methods = {str(clip): str(method) for clip, method in key["clips"].items()}
        found = tuple(
            {
                "id": str(trial["id"]),
                "prompt": str(trial["prompt"]),
                "character": str(trial["character"]),
                "clips": [str(clip) for clip in trial["clips"]],
            }
            for trial in trials["trials"]
        )
        study = Study(folder, found, methods, {str(one): str(other) for one, other in key["repeats"].items()})
        whole = all(clip in methods for trial in found for clip in trial["clips"])
    except (KeyError, TypeError, AttributeError):
        whole = False
    if not whole or not found:
        raise FormatError(folder / "study.json", "its trials and its key do not fit each other; make the study again")
    return study


def load_answers(study: Study) -> list[Answer]:
    """The answers so far; a line that a crash cut off is left out.

    Raises:
        FormatError: A line is of another study.
    """
    path = study.folder / "answers.jsonl"
    if not path.is_file():
        return []
    out = []
    lines = path.read_text(encoding="utf-8").split("\n")
    for number, line in enumerate(lines, 1):
        try:
            found = json.loads(line) if line.strip() else None
        except ValueError:
            if number == len(lines):
                continue
            raise FormatError(path, f"line {number} is broken; correct or remove it") from None
        if found is None:
            continue
        try:
            answer = Answer(
                str(found["participant"]),
                str(found["trial"]),
                {str(q): {str(clip): int(rank) for clip, rank in ranks.items()} for q, ranks in found["ranks"].items()},
                float(found.get("seconds", 0)),
            )
        except (KeyError, TypeError, ValueError, AttributeError):
            raise FormatError(path, f"line {number} is no answer; correct or remove it") from None
        trial = study.trial(answer.trial)
        if trial is None or any(sorted(ranks) != sorted(trial["clips"]) for ranks in answer.ranks.values()):
            raise FormatError(path, f"line {number} answers a trial of another study; remove it")
        out.append(answer)
    return out
