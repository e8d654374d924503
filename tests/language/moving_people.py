"""People whose paths, turns, hands and feet are made with known numbers."""

import numpy as np

from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_y
from bunraku.core.motion import HandleMotion

FPS = 20
REST = reference_body().handles.positions
HANG = {"wrist": (-0.5, -0.7, 0.0), "elbow": (-0.35, -0.35, 0.0)}  # from the T-pose, for the left side


def number(name):
    return HANDLE_NAMES.index(name)


def person(frames, speed=0.0, course=0.0, heading=None, height=None, steps=0.0, lift=None, hands=None, feet=None):
    """A body with hanging arms.

    Args:
        frames: Length.
        speed: Over the ground [m/s], a number or one a frame.
        course: Direction of the path to the left of the heading [rad].
        heading: [rad] a frame, 0 throughout without.
        height: Of the root over its rest [m] a frame; the feet stay on the ground.
        steps: Length of half a stride [m]; a step each 0.45 s.
        lift: Of everything off the ground [m] a frame.
        hands, feet: {"left": offsets (N, 3) from rest}, in place of hanging and standing.
    """
    time = np.arange(frames) / FPS
    heading = np.zeros(frames) if heading is None else np.asarray(heading, float)
    height = np.zeros(frames) if height is None else np.asarray(height, float)
    lift = np.zeros(frames) if lift is None else np.asarray(lift, float)
    way = heading + course
    step = np.broadcast_to(speed, frames) / FPS
    position = np.cumsum(np.stack([step * np.sin(way), 0 * way, step * np.cos(way)], 1), axis=0)
    position[:, 1] = height + lift
    local = np.zeros((frames, HANDLE_COUNT, 3))
    for side, sign in (("left", 1), ("right", -1)):
        for part, offset in HANG.items():
            local[:, number(f"{side}_{part}")] = np.array(offset) * [sign, 1, 1]
        phase = 2 * np.pi * time / 0.9 + (0 if sign > 0 else np.pi)
        for part in ("ankle", "foot"):
            local[:, number(f"{side}_{part}"), 1] = -height + (0.08 * np.clip(np.cos(phase), 0, 1) if steps else 0)
            local[:, number(f"{side}_{part}"), 2] = steps * np.sin(phase)
    for side, offsets in (hands or {}).items():
        local[:, number(f"{side}_wrist")] = offsets
    for side, offsets in (feet or {}).items():
        for part in ("ankle", "foot"):
            local[:, number(f"{side}_{part}")] = offsets
    turns = np.broadcast_to(np.eye(3), (frames, HANDLE_COUNT, 3, 3))
    return HandleMotion(local, turns, position, matrix_y(heading), FPS)


def ramp(frames, start, stop, amount):
    return amount * np.clip((np.arange(frames) - start) / (stop - start), 0, 1)


def kick(frames, start, side, high=0.7):
    """Offsets of a foot that swings forward and up within 0.6 s."""
    offsets = np.zeros((frames, 3))
    swing = np.sin(np.pi * np.clip((np.arange(frames) - start) / 12, 0, 1))
    offsets[:, 1], offsets[:, 2] = high * swing, 0.75 * swing
    return {side: offsets}
