"""What apparel data are like, so that they can be held beside real files: how much of a character is apparel, in how
many parts, how stiff, how far and how fast it moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bunraku_lab.datasets.apparel.push_out import unclothed
from bunraku_lab.datasets.apparel.reader import ApparelData
from bunraku_lab.datasets.apparel.standing_out import standing_out

__all__ = ["ApparelFacts", "apparel_facts", "facts_table", "sway_frequency"]

SOME = 200  # vertices of a character that are looked at


@dataclass(frozen=True)
class ApparelFacts:
    """A character of a data set, in its first clip.

    Args:
        name: Of the character.
        share: Of its vertices that is apparel.
        parts: Parts of its apparel.
        offset: Root mean square of how far apparel is from rigid motion [cm].
        frequency: Centroid of the spectrum of that [1/s].
        spring: Median stiffness of the parts' joints [N m / rad].
        stands_out: Share of the frames with calm legs in which its hem stands out.
    """

    name: str
    share: float
    parts: float
    offset: float
    frequency: float
    spring: float
    stands_out: float


def apparel_facts(data: ApparelData) -> list[ApparelFacts]:
    """The facts of every character of a data set.

    Raises:
        FormatError: A shard is damaged.
    """
    out = []
    for clip in {clip.character: clip for clip in reversed(data.clips)}.values():
        character, shard = data.character(clip), data.shard(clip.shard)
        cloth = np.flatnonzero(character.apparel[character.loose])
        some = cloth[np.linspace(0, len(cloth) - 1, min(SOME, len(cloth))).astype(np.int64)]
        span = clip.first, clip.first + clip.frames
        loose = shard.frames("offsets", *span)
        away = loose[:, some].astype(np.float64)
        clothed = unclothed(
            character.rest, character.faces, character.joints, character.weights, character.apparel, character.part
        )
        out.append(
            ApparelFacts(
                character.name, float(character.apparel.mean()), float(len(character.spring)),
                100 * float(np.sqrt(np.square(away).sum(axis=-1).mean())) if len(some) else 0.0,
                sway_frequency(away, data.fps), float(np.median(character.spring)),
                standing_out(clothed, shard.frames("transforms", *span), character.loose, loose, data.fps),
            )
        )  # fmt: skip
    return out


def sway_frequency(offsets: np.ndarray, fps: float) -> float:
    """Centroid of the power spectrum of offsets about their means [1/s], shape (N, V, 3); 0 where nothing moves."""
    power = np.square(np.abs(np.fft.rfft(offsets - offsets.mean(axis=0), axis=0))).sum(axis=(1, 2))
    rates = np.fft.rfftfreq(len(offsets), 1 / fps)
    return float(power @ rates / power.sum()) if power.sum() > 0 else 0.0


def facts_table(facts: Sequence[ApparelFacts]) -> str:
    """Lines of the 5th, 25th, 50th, 75th and 95th percentile of each fact."""
    columns = {
        "share of vertices [%]": [100 * one.share for one in facts], "parts": [one.parts for one in facts],
        "offset, RMS [cm]": [one.offset for one in facts], "frequency [1/s]": [one.frequency for one in facts],
        "spring [N m / rad]": [one.spring for one in facts],
        "hem stands out [%]": [100 * one.stands_out for one in facts],
    }  # fmt: skip
    lines = [f"{len(facts)} characters{'':<14}" + "".join(f"{f'{percent} %':>9}" for percent in (5, 25, 50, 75, 95))]
    for name, values in columns.items():
        lines.append(f"{name:<25}" + "".join(f"{value:9.3g}" for value in np.percentile(values, (5, 25, 50, 75, 95))))
    return "\n".join(lines)
