"""Ways to go, and to step on the spot."""

from __future__ import annotations

import math
from dataclasses import replace

from bunraku_lab.synthetic.gestures.flow import cycled, eased, foot_on, mixed
from bunraku_lab.synthetic.gestures.pose import DOWN, IN, Foot, Gesture, Hand, Pose

__all__ = ["STEPS"]


def _raised(phase: float, share: float, up: float, ahead: float, out: float = 0.11) -> Foot:
    """A foot of who steps on the spot: up for a share of the cycle, then down."""
    on = 1 - share
    if phase % 1.0 < on:
        return foot_on(out, 0.0)
    height = math.sin(math.pi * (phase % 1.0 - on) / share) ** 2
    return Foot((out, 0.081 + up * height, ahead * height), 26 * height, (0.05, 0.2, 1))


def _march() -> Gesture:
    ahead = Hand((0.20, 1.33, 0.48), (-0.15, 0.25, 1), IN, (0.5, -1, -0.2))
    behind = Hand((0.30, 0.98, -0.24), (0.1, -1, -0.5), IN, (0.3, 0, -1))

    def at(phase: float) -> Pose:
        swing = math.sin(2 * math.pi * (phase - 0.02))  # 1 where the left knee is up
        return Pose(
            mixed(behind, ahead, 0.5 + 0.5 * swing), mixed(behind, ahead, 0.5 - 0.5 * swing),
            (-2, 5 * swing, 0), (0, -5 * swing, 0), 0.0,
            (-0.025 * swing, -0.012, 0),
            right_foot=_raised(phase + 0.5, 0.46, 0.42, 0.34), left_foot=_raised(phase, 0.46, 0.42, 0.34),
        )  # fmt: skip

    # a left knee is up at the middle of its swing
    keys, cycle = cycled(lambda phase: at(phase + 0.52), 1.1, 5)
    texts = (
        "a person marches in place, lifting the knees high", "marches on the spot",
        "marches in place", "a person marches in place", "a soldier marches on the spot", "steps in place",
        "walks in place", "a person walks on the spot",
    )  # fmt: skip
    return Gesture("march in place", texts, keys, cycle, steps=True)


def _run_in_place() -> Gesture:
    ahead = Hand((0.16, 1.40, 0.34), (-0.3, 0.8, 0.6), IN, (0.5, -1, -0.6))
    behind = Hand((0.27, 1.12, -0.02), (-0.1, -0.2, 1), IN, (0.4, -0.1, -1))

    def at(phase: float) -> Pose:
        swing = math.sin(2 * math.pi * (phase - 0.05))
        return Pose(
            mixed(behind, ahead, 0.5 + 0.5 * swing), mixed(behind, ahead, 0.5 - 0.5 * swing),
            (6, 7 * swing, 0), (-2, -7 * swing, 0), 0.0, (-0.02 * swing, -0.02 - 0.03 * math.cos(4 * math.pi * phase),
                    0),
            right_foot=_raised(phase + 0.5, 0.6, 0.40, 0.22), left_foot=_raised(phase, 0.6, 0.40, 0.22),
        )  # fmt: skip

    keys, cycle = cycled(lambda phase: at(phase + 0.45), 0.7, 8)
    texts = (
        "a person runs in place, lifting the knees", "jogs on the spot", "runs in place", "jogs in place",
        "a person runs on the spot", "a person jogs in place",
    )  # fmt: skip
    return Gesture("run in place", texts, keys, cycle, steps=True)


def _walked(phase: float, stride: float, on: float, out: float, lift: float, rolls: tuple[float, float]) -> Foot:
    """A foot of who walks ahead so far a cycle, and is above its middle after half of the share that it is `on`.

    Args:
        phase: Cycles since it landed.
        stride: Way of a cycle [m].
        on: Share of the cycle in which it stands.
        out: Of the ankle from the middle [m].
        lift: Of the ankle on the way [m].
        rolls: Pitch with which it lands and with which it leaves [degrees].
    """
    whole, over = math.floor(phase), phase % 1.0
    there = (whole + on / 2) * stride
    if over < on:
        share = over / on
        landed, leaving = max(1 - share / 0.2, 0.0), max((share - 0.55) / 0.45, 0.0)
        return foot_on(out, there, rolls[0] * landed + rolls[1] * leaving**1.5)
    share = (over - on) / (1 - on)
    foot = foot_on(out, there + stride * eased(share), rolls[1] + (rolls[0] - rolls[1]) * eased(min(1.3 * share, 1)))
    x, y, z = foot.ankle
    return replace(foot, ankle=(x, y + lift * math.sin(math.pi * share) ** 2, z))


def _zombie() -> Gesture:
    def arm(up: float) -> Hand:
        return Hand((0.15, 1.45 + up, 0.60), (-0.15, -0.75, 0.8), DOWN, (0.8, -0.8, 0))

    def at(phase: float) -> Pose:
        roll, nod = math.sin(2 * math.pi * phase), math.cos(4 * math.pi * phase)
        return Pose(
            arm(0.05 + 0.035 * roll), arm(-0.03 - 0.035 * roll), (10, 5 * roll, 7 * roll), (-4 + 2 * nod, 0,
                    17 - 3 * roll), 0.25,
            (0.035 * roll, -0.05 + 0.008 * nod, 0.62 * phase), 0.0,
            _walked(phase, 0.62, 0.66, 0.15, 0.05, (-4, 26)),
            _walked(phase - 0.5, 0.62, 0.70, 0.15, 0.03, (0, 30)),
        )  # fmt: skip

    def carried(phase: float) -> Pose:  # the left foot is half a cycle later, at the same place
        pose = at(phase)
        x, y, z = pose.left_foot.ankle
        return replace(pose, left_foot=replace(pose.left_foot, ankle=(x, y, z + 0.31)))

    keys, cycle = cycled(carried, 1.6, 5)
    texts = (
        "a person walks like a zombie with the arms stretched out in front", "zombie walk",
        "walks like a zombie", "a zombie walks, arms out", "a zombie staggers forward", "shambles like the undead",
        "a person walks like a zombie",
    )  # fmt: skip
    return Gesture("zombie", texts, keys, cycle, steps=True)


def _skip() -> Gesture:
    ahead = Hand((0.20, 1.42, 0.42), (-0.1, 0.6, 0.8), IN, (0.6, -1, -0.2))
    behind = Hand((0.33, 1.02, -0.26), (0.1, -0.8, -0.6), IN, (0.4, 0, -1))
    period, way = 1.3, 2.0  # two steps with a hop each

    def leg(phase: float, out: float) -> Foot:
        """Of who lands at 0: stands, hops on, stands, and comes from behind with the knee up while the other hops."""
        whole, over = math.floor(phase), phase % 1.0
        first, second = (whole + 0.02) * way, (whole + 0.02) * way + 0.24 * way
        if over < 0.15:
            return foot_on(out, first, 30 * (over / 0.15) ** 2)
        if over < 0.30:
            share = (over - 0.15) / 0.15
            foot = foot_on(out, first + (second - first) * eased(share), 30 - 15 * share)
            return replace(foot, ankle=(out, foot.ankle[1] + 0.13 * math.sin(math.pi * share), foot.ankle[2]))
        if over < 0.46:
            return foot_on(out, second, 15 + 35 * (over - 0.30) / 0.16)
        share = (over - 0.46) / 0.54
        start, stop = foot_on(out, second, 50).ankle, foot_on(out, (whole + 1.02) * way, 0).ankle
        knee = math.sin(math.pi * share) ** 1.2 * (0.35 + 0.65 * share) / 0.75
        height = start[1] + (stop[1] - start[1]) * share + 0.40 * knee
        return Foot((out, height, start[2] + (stop[2] - start[2]) * eased(share) ** 0.85), 50 * (1 - share) ** 0.7)

    def at(phase: float) -> Pose:
        swing = math.cos(2 * math.pi * (phase - 0.22))  # 1 where the right foot hops
        beat = (2 * phase) % 1.0
        up = 0.12 * math.sin(math.pi * (beat - 0.26) / 0.40) if 0.26 < beat < 0.66 else -0.05
        if beat <= 0.26:
            up = -0.05 * math.sin(math.pi * beat / 0.26)
        elif beat >= 0.66:
            up = -0.05 * math.sin(math.pi * (beat - 0.66) / 0.34)
        left = leg(phase - 0.5, 0.09)
        x, y, z = left.ankle
        return Pose(
            mixed(ahead, behind, 0.5 - 0.5 * swing), mixed(ahead, behind, 0.5 + 0.5 * swing), (3, 9 * swing, 0),
            (-6, -9 * swing, 0), 0.0, (-0.02 * swing, up - 0.02, way * (phase - 0.12)), 0.0,
            leg(phase, 0.09), replace(left, ankle=(x, y, z + way / 2)),
        )  # fmt: skip

    keys, cycle = cycled(at, period, 4)
    texts = (
        "a person skips along cheerfully, hopping on each foot", "skips along", "a person skips forward", "skips",
        "a child skips happily", "a person skips", "skipping forward",
    )  # fmt: skip
    return Gesture("skip", texts, keys, cycle, steps=True)


STEPS: tuple[Gesture, ...] = (_march(), _run_in_place(), _zombie(), _skip())
