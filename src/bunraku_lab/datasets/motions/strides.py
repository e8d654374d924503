"""What engines do to the clips of games: play loops on, and move characters that walk on the spot.

While a foot stands, the body passes over it: the ground speed is how fast the standing points move backwards.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bunraku.core.motion import HandleMotion

__all__ = ["forward_speed", "played_on", "with_travel"]

NEAR = (
    0.04,
    0.015,
    # what is this near to the lowest point, as a share of the height, stands; the second where the first takes in
    # swinging
    # feet
)
IN_PLACE = 0.25  # clips that come farther than this share of the way that their feet make do move already
SLOWEST, FASTEST = 0.03, 6.0  # in body heights a second


def forward_speed(vertices: np.ndarray, surface: np.ndarray, height: float, fps: float) -> float:
    """Speed along +Z at which the feet would not slide [m/s], not negative; 0 where none can be told.

    Args:
        vertices: Of each frame [m], shape (N, V, 3), of a body that faces +Z.
        surface: Which vertices count, shape (V,), bool.
        height: Of the body [m].
        fps: Frames a second [1/s].
    """
    points = vertices[:, surface].astype(np.float64)
    if len(points) < 3:
        return 0.0
    for near in NEAR:
        down = points[..., 1] < points[..., 1].min(axis=1, keepdims=True) + near * height
        down &= points[..., 1] < points[..., 1].min() + 2 * near * height  # nobody stands in the air
        both = down[:-1] & down[1:]
        if both.any():
            speed = float(np.median(-np.diff(points[..., 2], axis=0)[both]) * fps)
            if SLOWEST * height < speed < FASTEST * height:
                return speed
    return 0.0


def with_travel(motion: HandleMotion, speed: float) -> HandleMotion:
    """The motion with a steady way along +Z added, unless it comes forward by itself.

    Args:
        motion: Of a body on the spot that faces +Z.
        speed: What `forward_speed` found [m/s].
    """
    moments = np.arange(len(motion)) / motion.fps
    own = float(motion.root_translation[-1, 2] - motion.root_translation[0, 2])
    if speed == 0 or abs(own) > IN_PLACE * speed * moments[-1]:
        return motion
    return replace(
        motion, root_translation=motion.root_translation + np.outer(moments, [0, 0, speed]).astype(np.float32)
    )


def played_on(motion: HandleMotion, least: int) -> HandleMotion:
    """A loop played on, in whole rounds, until it has at least `least` frames; the motion as it is where it does not
    end as it began.

    Loops of a few frames, such as one bound of a gallop, are too short to be cut, joined or told from a single step.
    """
    frames = len(motion)
    if frames < 3 or frames >= least:
        return motion
    flat = np.concatenate([motion.rotations.reshape(frames, -1), motion.root_rotation.reshape(frames, -1)], axis=1)
    step, gap = np.linalg.norm(np.diff(flat, axis=0), axis=1).max(), float(np.linalg.norm(flat[-1] - flat[0]))
    if gap > 1.2 * step:
        return motion
    period = frames - 1 if gap < 0.5 * step else frames  # the last frame is the first again, or the one before it
    rounds = -(-least // period)
    order = np.arange(rounds * period) % period
    path = motion.root_translation.astype(np.float64)
    course = (path[-1] - path[0]) * period / (frames - 1)
    path = path[order] + np.outer(np.arange(rounds * period) // period, [course[0], 0, course[2]])
    return replace(motion.take(order), root_translation=path)
