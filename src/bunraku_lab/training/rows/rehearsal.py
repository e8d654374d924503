"""The shipped examples as clips to train on beside others, so that a network keeps what it knows.

A network that goes on with few clips of one kind forgets all others (catastrophic forgetting, McCloskey & Cohen 1989);
rehearsal of what it learned before is the plainest remedy, and captured examples are there wherever Bunraku is.
"""

from __future__ import annotations

from bunraku.diffusion.examples.pack import ExamplePack
from bunraku_lab.training.rows.clip_data import MIN_FRAMES, ClipEntry

__all__ = ["rehearsal_clips"]


def rehearsal_clips(pack: ExamplePack) -> dict[str, ClipEntry]:
    """What is captured of a pack, with its sentences, by name.

    Args:
        pack: Examples; those made by code are left out, since they are played and not drawn.
    """
    return {
        f"rehearsed_{one.name}": ClipEntry(
            features=pack.features(index),
            frames=one.frames,
            split="train",
            texts=list(one.texts),
            watched=True,
            rehearsed=True,
        )
        for index, one in enumerate(pack.examples)
        if one.texts and not one.made and one.frames >= MIN_FRAMES
    }
