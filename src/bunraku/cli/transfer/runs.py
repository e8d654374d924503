"""Many pairs of `bunraku transfer`: one after the other, on several processes, or on a Ray cluster."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from bunraku.cli.transfer.jobs import Pair, Settings, transfer_pair
from bunraku.nn.spread import spread

__all__ = ["run_pairs"]

_AT_ONCE = 4
"""Pairs of one character that a worker does at most before it reports them."""


def run_pairs(pairs: list[Pair], settings: Settings, jobs: int | str) -> Iterator[tuple[Pair, str]]:
    """Do all pairs; give each with what went wrong, "" for nothing, as it is done.

    Args:
        pairs: What to do; pairs of one character follow each other.
        settings: For all.
        jobs: How many processes, or "ray" for a cluster of the package ray, whose machines must see the same files.

    Raises:
        MissingExtraError: ray is not installed.
    """
    if jobs == 1 or (len(pairs) <= 1 and jobs != "ray"):
        for pair in pairs:
            yield pair, transfer_pair(pair, settings)
        return
    own = {_resolved(pair) if jobs == "ray" else pair: pair for pair in pairs}
    size = _AT_ONCE if jobs == "ray" else max(1, min(_AT_ONCE, len(pairs) // (2 * int(jobs))))
    for pair, reason in spread(partial(_run_batch, settings), _batches(list(own), size), jobs, str):
        yield own[pair], reason


def _resolved(pair: Pair) -> Pair:
    """The same for workers that run in folders of their own."""
    return Pair(pair.character.resolve(), pair.motion.resolve(), pair.output.resolve())


def _batches(pairs: list[Pair], size: int) -> list[list[Pair]]:
    """Pairs of one character together, a few at once, so that progress is seen."""
    out: list[list[Pair]] = []
    for pair in pairs:
        if out and len(out[-1]) < size and out[-1][0].character == pair.character:
            out[-1].append(pair)
        else:
            out.append([pair])
    return out


def _run_batch(settings: Settings, batch: list[Pair]) -> list[str]:
    return [transfer_pair(pair, settings) for pair in batch]
