"""Several frames drawn at once, and given in their order while the next ones are drawn."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from queue import SimpleQueue

import numpy as np

from bunraku.render.camera import Camera
from bunraku.render.software import SoftwareRenderer

__all__ = ["draw_side_by_side"]

MOST_THREADS = 8
Frame = tuple[np.ndarray, Camera, np.ndarray]
"""Posed vertices, the camera, and how far the floor has moved: what a renderer draws."""


def draw_side_by_side(opened: Callable[[], SoftwareRenderer], frames: Iterable[Frame]) -> Iterator[np.ndarray]:
    """Pictures of frames, in their order.

    They are drawn on as many threads as there are processors, and a few pictures ahead of the one that is asked for, so
    that a video is encoded meanwhile.

    Args:
        opened: Gives a new renderer; all draw the same.
        frames: What to draw.
    """
    first = opened()
    threads = min(
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, MOST_THREADS
    )
    if threads == 1:
        for frame in frames:
            yield first.draw(*frame)
        return
    free: SimpleQueue[SoftwareRenderer] = SimpleQueue()
    free.put(first)
    made = 1

    def draw(frame: Frame) -> np.ndarray:
        renderer = free.get()
        try:
            return renderer.draw(*frame)
        finally:
            free.put(renderer)

    source = iter(frames)
    ahead: deque[Future[np.ndarray]] = deque()
    pool = ThreadPoolExecutor(threads, "bunraku-preview")
    try:
        for frame in islice(source, 2 * threads):
            if made < threads and len(ahead) >= made:
                made += 1
                free.put(opened())
            ahead.append(pool.submit(draw, frame))
        while ahead:
            picture = ahead.popleft().result()
            for frame in islice(source, 1):
                ahead.append(pool.submit(draw, frame))
            yield picture
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
