"""Show a blind study: who sees what next, in which order, and what they say."""

from __future__ import annotations

import json
import os
import re
import threading
from pathlib import Path
from typing import Any

from bunraku.errors import OptionError
from bunraku.formats.files import writing
from bunraku.studio.study.answers import QUESTIONS, load_answers, load_study

__all__ = ["Session", "placed", "trial_order"]

_NAME = re.compile(r"p[0-9]{1,6}")


def trial_order(participant: int, count: int) -> list[int]:
    """The order of trials for a participant: a row of a Latin square in which, over an even number of rows, each trial
    follows each other equally often (Williams 1949).
    """
    row = [0]
    for step in range(1, count):
        row.append((count - (step // 2)) % count if step % 2 == 0 else (step + 1) // 2)
    return [(trial + participant) % count for trial in row]


def placed(participant: int, trial: int, count: int) -> list[int]:
    """Which clip stands at each place: rows of a Latin square, then the same mirrored, so that each clip is at each
    place equally often.
    """
    row = [(index + participant + trial) % count for index in range(count)]
    return row[::-1] if (participant // count) % 2 else row


class Session:
    """A study that is shown.

    Args:
        folder: Of `make_study`.

    Raises:
        FormatError: There is no study, or it is broken.
    """

    def __init__(self, folder: Path):
        self.study = load_study(folder)
        self._lock = threading.Lock()
        answers = load_answers(self.study)
        self._done = {(one.participant, one.trial) for one in answers}
        numbers = [int(one.participant[1:]) for one in answers if _NAME.fullmatch(one.participant)]
        self._people = max(numbers, default=-1) + 1

    def next(self, participant: str) -> dict[str, Any]:
        """What a participant sees next; a new one gets a number.

        Raises:
            OptionError: The number is none that was given.
        """
        with self._lock:
            if not participant:
                participant = f"p{self._people}"
                self._people += 1
        number = self._number(participant)
        trials = self.study.trials
        order = trial_order(number, len(trials))
        left = [index for index in order if (participant, trials[index]["id"]) not in self._done]
        out: dict[str, Any] = {"participant": participant, "total": len(trials), "done": len(trials) - len(left)}
        if left:
            trial = trials[left[0]]
            clips = [trial["clips"][index] for index in placed(number, left[0], len(trial["clips"]))]
            out["trial"] = {"id": trial["id"], "prompt": trial["prompt"], "clips": clips}
            out["questions"] = QUESTIONS
        return out

    def answer(self, participant: str, trial: str, ranks: Any, seconds: float) -> None:
        """Write down an answer: for each question the ranks of the clips, by name.

        Raises:
            OptionError: It is not a rank from 1 on for each clip, no two alike, or was given before.
            FormatError: It cannot be written.
        """
        self._number(participant)
        found = self.study.trial(trial)
        if found is None:
            raise OptionError("there is no such trial in this study; reload the page")
        if not isinstance(ranks, dict) or set(ranks) != set(QUESTIONS):
            raise OptionError("rank the clips in every question")
        for values in ranks.values():
            whole = isinstance(values, dict) and set(values) == set(found["clips"])
            if not whole or sorted(values.values(), key=str) != list(range(1, len(values) + 1)):
                raise OptionError("give each clip another rank, from 1 for the best on")
        line = {
            "participant": participant,
            "trial": trial,
            "ranks": ranks,
            "seconds": round(seconds, 1),
        }
        path = self.study.folder / "answers.jsonl"
        with self._lock:
            if (participant, trial) in self._done:
                raise OptionError("this trial is answered already; reload the page")
            with writing(path), path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
                file.flush()
                os.fsync(file.fileno())
            self._done.add((participant, trial))

    def clip(self, name: str) -> Path:
        """The file of a clip.

        Raises:
            OptionError: There is none of this name.
        """
        if name not in self.study.methods:
            raise OptionError("there is no such clip in this study")
        return self.study.folder / "clips" / f"{name}.glb"

    def _number(self, participant: str) -> int:
        if not _NAME.fullmatch(participant) or int(participant[1:]) >= self._people:
            raise OptionError("there is no such participant; reload the page to begin")
        return int(participant[1:])
