"""Training data cut out of longer clips: rotations on the spot, and dressed people in poses of clips."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bunraku.core.geometry.rotations import heading
from bunraku.core.motion import HandleMotion
from bunraku_lab.datasets.motions.clips import load_clip, load_index, write_clip, write_index

__all__ = ["add_turns", "find_turn"]

WINDOWS = (50, 70)  # frames
LEAST, MOST, FARTHEST = 2.5, 3.9, 0.9  # rad, rad, m
MARGIN = 6  # frames kept before and after
_WALKS = ("walk", "turn", "stand", "push", "stop")
_OTHERS = (
    "dance", "jete", "pirouette", "wheel", "ball", "tennis", "jump", "hop", "climb", "sit", "pick", "uneven", "spiral",
    "playground",
)  # fmt: skip


def find_turn(motion: HandleMotion) -> tuple[int, int, float] | None:
    """The stretch in which somebody turns round the farthest with the smallest move, if there is one.

    Returns:
        First frame, frame after the last, and the change of heading [rad], positive to the left; None without a turn.
    """
    angle = heading(motion.root_rotation, motion.fps)
    path = motion.root_translation[:, [0, 2]]
    best: tuple[float, int, int, float] | None = None
    for window in WINDOWS:
        for start in range(0, len(angle) - window, 5):
            change = float(angle[start + window - 1] - angle[start])
            if LEAST < abs(change) < MOST:
                moved = float(np.ptp(path[start : start + window], axis=0).max())
                cost = moved - 0.3 * abs(change)
                if moved < FARTHEST and (best is None or cost < best[0]):
                    best = (cost, start, start + window, change)
    return best and best[1:]


def add_turns(out: str | Path) -> list[str]:
    """Cut the turns out of the training clips that `build_motions` wrote and add them to the index.

    Args:
        out: Folder of the motions, with its `index.json`.

    Returns:
        Names of the new clips.

    Raises:
        FormatError: The index or a clip is missing or broken.
    """
    out = Path(out)
    clips = load_index(out)
    added = {}
    for name, entry in list(clips.items()):
        if name.startswith("turn_"):
            del clips[name]  # of an earlier run; made again below
            continue
        text = " ".join(entry["texts"]).lower()
        if (
            entry["split"] != "train"
            or not any(word in text for word in _WALKS)
            or any(word in text for word in _OTHERS)
        ):
            continue
        motion = load_clip(out / f"{name}.npz")
        found = find_turn(motion)
        if found is None:
            continue
        start, stop, change = found
        clip = motion.take(slice(max(start - MARGIN, 0), stop + MARGIN))
        write_clip(out / f"turn_{name}.npz", clip)
        caption = f"a person turns around to the {'left' if change > 0 else 'right'}"
        kept = {key: value for key, value in entry.items() if key != "stretches"}
        added[f"turn_{name}"] = kept | {"texts": [caption], "frames": len(clip)}
    write_index(out, clips | added)
    return list(added)
