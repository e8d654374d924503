"""What a motion does in some of its frames, and the frames in which something holds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


def runs(mask: np.ndarray, least: float = 1, bridge: float = 0) -> list[tuple[int, int]]:
    """Runs (start, stop) in which the mask holds for `least` frames or more, gaps of up to `bridge` frames included."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    merged: list[tuple[int, int]] = []
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if merged and start - merged[-1][1] <= bridge:
            merged[-1] = (merged[-1][0], stop)
        else:
            merged.append((start, stop))
    return [(start, stop) for start, stop in merged if stop - start >= least]


@dataclass(frozen=True)
class Phrase:
    """Something that a motion does in some of its frames."""

    kind: str  # "go", "turn", "jump", "kick", "arm", "bend" or "still"
    texts: tuple[str, ...]  # rewordings of the same, with verbs in braces
    # start, stop: first frame, and the one after the last
    start: int
    stop: int
    # words that are still true where only a part of the frames is there; empty where a part is nothing
    part: tuple[str, ...] = ()
    manner: tuple[str, ...] = ()  # for "go": direction and speed, to follow another verb, such as "backwards", "slowly"
