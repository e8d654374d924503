"""Motions of any other method in the table of generated motion: the sentences go out as a CSV, the motions come back as
files.

A window's number is its file's name, `0001.bvh` or any other kind that holds a motion. What comes back is taken to the
reference body as any motion is, so skeletons may differ.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from bunraku.diffusion.features import encode
from bunraku.errors import FormatError
from bunraku_lab.datasets.takes.takes import Take, take_motion
from bunraku_lab.evaluation.asked import write_asked
from bunraku_lab.evaluation.motion.windows import Window

__all__ = ["read_results", "write_prompts"]


def write_prompts(path: str | Path, windows: Sequence[Window]) -> Path:
    """Write what another method is to make: columns file, text and seconds.

    Raises:
        FormatError: The file cannot be written.
    """
    rows = ([_name(at), window.sentence, f"{window.frames / 20:.2f}"] for at, window in enumerate(windows))
    return write_asked(path, ("file", "text", "seconds"), rows)


def read_results(
    folder: str | Path, windows: Sequence[Window], progress: Callable[[float], None] | None = None
) -> list[np.ndarray]:
    """Features (N, 271) of the motions that another method made of the windows' sentences, each at most as long as its
    window.

    Args:
        folder: A file for each window.
        windows: Those that `write_prompts` wrote.
        progress: Called with the share done.

    Raises:
        FormatError: A file is missing, cannot be read, or is too short.
        MotionError: A skeleton is nobody's that goes on two legs.
    """
    folder = Path(folder)
    files = {file.stem: file for file in sorted(folder.iterdir()) if file.is_file() and file.suffix != ".csv"}
    missing = [_name(number) for number in range(len(windows)) if _name(number) not in files]
    if missing:
        raise FormatError(
            folder,
            f"{len(missing)} of {len(windows)} motions are missing, first {missing[0]}; make one for each row of "
            "the CSV that --prompts-to writes",
        )
    out = []
    for number, window in enumerate(windows):
        name = _name(number)
        motion = take_motion(Take(name, files[name], (window.sentence,), "test", "another method"))
        out.append(encode(motion)[: window.frames])
        if progress is not None:
            progress((number + 1) / len(windows))
    return out


def _name(number: int) -> str:
    return f"{number:04d}"
