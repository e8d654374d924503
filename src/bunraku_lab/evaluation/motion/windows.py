"""Windows of captioned clips: what the feature extractor is trained and the motion table is measured on.

Few clips are held out, so each gives many windows: cuts of its own length or less, and their mirror images with the
words mirrored too. A window's meaning is the group of its caption (see `captions`), mirrored where the window is, so
that "turns left" and the mirror image of "turns right" are the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bunraku.diffusion.features import mirror
from bunraku.errors import OptionError
from bunraku.language.captions.phrases import caption_group, caption_variants, mirror_words, normalise_label
from bunraku_lab.training.rows.clip_data import ClipEntry

__all__ = ["LENGTHS", "SHORTEST", "Window", "candidate_sentences", "draw_windows", "window_features", "window_meaning"]

SHORTEST = 40
"""Frames: HumanML3D leaves out clips of less than 2 s, and so do we."""
LENGTHS = (40, 50, 60, 70, 80, 100, 120, 140, 160, 180, 196)
"""Frames a window may have: few lengths, so that motions of one length can be made in one batch."""
_ENOUGH = 400  # frames after which a clip is not drawn more often for being longer


@dataclass(frozen=True)
class Window:
    """A cut of a clip with its sentence.

    Args:
        clip: Name of the clip.
        start: First frame.
        frames: Length N.
        mirrored: Whether left and right are exchanged.
        label: The clip's caption as the archive has it.
        sentence: A rewording of it, mirrored where the window is.
        meaning: The caption's group, mirrored where the window is.
    """

    clip: str
    start: int
    frames: int
    mirrored: bool
    label: str
    sentence: str
    meaning: str


def window_meaning(label: str, mirrored: bool = False) -> str:
    """The name of a caption's group; for a mirror image, that of the caption with left and right exchanged."""
    return caption_group(mirror_words(normalise_label(label)) if mirrored else label).name


def _shares(clips: Mapping[str, ClipEntry], names: list[str]) -> np.ndarray:
    """How often each clip is drawn: by the root of its length, and less where many clips mean the same."""
    meanings = [window_meaning(clips[name]["texts"][0]) for name in names]
    count = Counter(meanings)
    frames = np.array([min(len(clips[name]["features"]), _ENOUGH) for name in names], float)
    share = np.sqrt(frames) / np.sqrt([count[meaning] for meaning in meanings])
    return share / share.sum()


def draw_windows(
    clips: Mapping[str, ClipEntry],
    count: int,
    random: np.random.Generator,
    shortest: int = SHORTEST,
    longest: int = 196,
) -> list[Window]:
    """Windows at random places, half of them mirrored.

    A clip of at most `longest` frames gives windows of three fifths of its length or more; a longer one of three fifths
    of `longest` or more. Lengths are rounded down to one of `LENGTHS` where that is not under `shortest`.

    Args:
        clips: What `load_clips` returned.
        count: How many.
        random: Draws them.
        shortest: Clips with fewer frames are left out.
        longest: Frames of the longest window.

    Raises:
        OptionError: No clip is long enough.
    """
    names = sorted(name for name, entry in clips.items() if len(entry["features"]) >= shortest)
    if not names:
        raise OptionError(f"no clip has the {shortest} frames that a window needs")
    found = []
    for index in random.choice(len(names), size=count, p=_shares(clips, names)):
        entry = clips[names[index]]
        whole = len(entry["features"])
        most = min(whole, longest)
        frames = int(random.integers(max(shortest, int(0.6 * most)), most + 1))
        frames = max((length for length in LENGTHS if shortest <= length <= frames), default=frames)
        mirrored = bool(random.random() < 0.5)
        label = entry["texts"][int(random.integers(len(entry["texts"])))]
        variants = caption_variants(label, mirrored)
        sentence = variants[int(random.integers(len(variants)))]
        start = int(random.integers(0, whole - frames + 1))
        found.append(Window(names[index], start, frames, mirrored, label, sentence, window_meaning(label, mirrored)))
    return found


def window_features(clips: Mapping[str, ClipEntry], window: Window) -> np.ndarray:
    """The window's motion features, shape (N, 271), in the data's units."""
    features = clips[window.clip]["features"][window.start : window.start + window.frames]
    return mirror(features) if window.mirrored else features


def candidate_sentences(
    windows: list[Window], clips: Mapping[str, ClipEntry], count: int, random: np.random.Generator
) -> list[list[str]]:
    """For each window its own sentence, then `count` - 1 sentences of other windows, each of another meaning.

    No candidate means the same as any caption of the window's clip, or as another candidate.

    Args:
        windows: The pool that sentences are drawn from.
        clips: What `load_clips` returned.
        count: Candidates in all.
        random: Draws them.

    Raises:
        OptionError: The windows have too few meanings.
    """
    by_meaning: dict[str, list[str]] = {}
    for window in windows:
        by_meaning.setdefault(window.meaning, []).append(window.sentence)
    meanings = sorted(by_meaning)
    rows = []
    for window in windows:
        own = {window_meaning(text, window.mirrored) for text in clips[window.clip]["texts"]} | {window.meaning}
        others = [meaning for meaning in meanings if meaning not in own]
        if len(others) < count - 1:
            raise OptionError(
                f"the held-out clips have captions of {len(others) + 1} meanings, fewer than the {count} candidates "
                "asked for"
            )
        drawn = [others[index] for index in random.permutation(len(others))[: count - 1]]
        rows.append(
            [
                window.sentence,
                *(by_meaning[meaning][int(random.integers(len(by_meaning[meaning])))] for meaning in drawn),
            ]
        )
    return rows
