"""Heights of captured motion: what hovers or sinks is set on the ground, and what sits or lies in the air is named.

Markers, toy proportions and takes that were cut out of furniture leave bodies above the ground or in it. A jump is in
the air for less than a second, so whatever has nothing near the ground for longer hovers, unless it climbs, which is
far more than a hand's breadth.
"""

from __future__ import annotations

import re

import numpy as np
from scipy.ndimage import gaussian_filter1d, percentile_filter

__all__ = ["floor_height", "posture_fault"]

HAND = 0.15
"""Height [m] up to which a body that is off the ground means to stand on it."""
CLIMB = 0.2
"""Height [m] from which on a clip climbs."""
WINDOW = 2.4
"""Time [s] in which a body touches the ground at least once, however it jumps."""
_SITS = re.compile(r"\b(sits?|sitting|seated|seat|chair)\b", re.IGNORECASE)
_HIGH = re.compile(
    r"\b(stool|high|horse|ride|riding|motorcycle|swing|hop|table|ledge|climb\w*|cycl\w*)\b", re.IGNORECASE
)
_LIES = re.compile(r"\b(lies|lying|lie|crawl\w*|push-?ups?|sit-?ups?)\b", re.IGNORECASE)


def floor_height(lowest: np.ndarray, fps: float) -> np.ndarray:
    """Height of the ground under a clip, by what touches it.

    Args:
        lowest: Lowest point of what can carry the body, all but the arms, in each frame [m], shape (N,).
        fps: Frames a second [1/s].

    Returns:
        Height [m] to take off each frame, shape (N,): smooth where the clip hovers or sinks by less than `CLIMB` all
        along, else one number, 0 where even that is more than `HAND`.
    """
    whole = float(np.quantile(lowest, 0.05))
    whole = whole if abs(whole) < HAND else 0.0
    rest = np.asarray(lowest, float) - whole
    size = max(3, round(WINDOW * fps))
    local = gaussian_filter1d(percentile_filter(rest, 10, size=size, mode="nearest"), 0.4 * fps, mode="nearest")
    if np.abs(local).max(initial=0) > CLIMB:
        return np.full(len(rest), whole)
    return whole + local


def posture_fault(texts: list[str], height: np.ndarray, lowest: np.ndarray) -> str | None:
    """Why a stretch cannot be what its sentences say: it sits, lies or stands in the air; None where it can.

    Args:
        texts: Its sentences.
        height: Root over its standing height in each frame [m], shape (N,).
        lowest: Lowest point of the body over the ground in each frame [m], shape (N,).
    """
    words = " ".join(texts)
    if _SITS.search(words) and not _HIGH.search(words) and float(height.min()) > -0.18:
        return f"sits with the pelvis {-100 * float(height.min()):.0f} cm below standing, which is no seat"
    if _LIES.search(words) and not re.search(r"\bswim", words, re.IGNORECASE) and float(height.min()) > -0.3:
        return f"lies or creeps with the pelvis {-100 * float(height.min()):.0f} cm below standing"
    if not re.search(
        r"\b(climb\w*|hang\w*|swing\w*|swim\w*|ladder|fl(y|ies|ying)|levitat\w*|jump\w*|leap\w*|flip\w*|mid-?air)\b",
        words,
        re.IGNORECASE,
    ):
        share = float((lowest > 0.08).mean())
        if share > 0.6:
            return f"nothing is near the ground in {100 * share:.0f} % of the frames"
    return None
