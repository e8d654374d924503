"""Exercises on the floor, to crawl, and to swim."""

from __future__ import annotations

import math
from dataclasses import replace

from bunraku_lab.synthetic.gestures.flow import cycled, eased, foot_on, round_of
from bunraku_lab.synthetic.gestures.pose import DOWN, Foot, Gesture, Hand, Pose

__all__ = ["FLOOR"]

_HIP = 1.016
"""Height of the pelvis of who stands [m]."""


def _back_and_forth(phase: float, rest: float = 0.12) -> float:
    """From 0 to 1 and back in a cycle, slow at both ends, with a short rest at each."""
    over = phase % 1.0
    share = min(over / (0.5 - rest), 1.0) if over < 0.5 else 1 - min((over - 0.5) / (0.5 - rest), 1.0)
    return eased(share)


def _sit_ups() -> Gesture:
    def at(phase: float) -> Pose:
        up = _back_and_forth(phase)
        hand = Hand((0.105, 1.72, -0.05), (-0.6, 0.5, -0.4), (-0.3, 0, 1), (1, -0.1, 0.25 + 0.3 * up), "head")
        foot = Foot((0.13, 0.081, 0.52), 0, (0.1, 1, 0.3), 6)
        # the pelvis rolls on the buttocks, and the back rounds before it leaves the floor
        return Pose(
            hand, hand, (6 + 50 * up, 0, 0), (16 - 4 * up, 0, 0), 0.0, (0, 0.125 - _HIP + 0.01 * up, 0.0), 0.0,
            foot, foot, -88 + 62 * up**1.3,
        )  # fmt: skip

    keys, cycle = cycled(at, 2.2, 4)
    texts = (
        "a person lies on the back and does sit-ups with the hands behind the head", "does sit-ups", "does crunches",
        "a person does sit-ups", "a person does crunches", "a person does a sit-up", "trains the abs with sit-ups",
    )  # fmt: skip
    return Gesture("sit-up", texts, keys, cycle, steps=True)


def _push_ups() -> Gesture:
    toes, back, spine = 72.0, 0.902, 0.493  # legs and trunk are straight
    foot = foot_on(0.10, -back, toes)
    foot = Foot(foot.ankle, toes, (0.05, -1, 0.1), 0)

    def at(phase: float) -> Pose:
        low = _back_and_forth(phase, 0.08)
        shoulder = 0.53 - 0.29 * low
        slope = math.asin((shoulder - foot.ankle[1]) / (back + spine))
        hip = foot.ankle[1] + back * math.sin(slope), foot.ankle[2] + back * math.cos(slope)
        hand = Hand((0.25, 0.035, 0.44), (-0.1, 0, 1), DOWN, (0.75, 0.25, -0.65), "ground")
        return Pose(
            hand, hand, (0, 0, 0), (-22, 0, 0), 0.0, (0, hip[0] + 0.02 - _HIP, hip[1]), 0.0, foot, foot,
            90 - math.degrees(slope),
        )  # fmt: skip

    keys, cycle = cycled(at, 1.8, 5)
    texts = (
        "a person does push-ups", "does push-ups", "does press-ups", "a person does several push-ups",
        "does push-ups on the floor",
    )  # fmt: skip
    return Gesture("push-up", texts, keys, cycle, steps=True)


def _crawl() -> Gesture:
    stride, on = 0.50, 0.62

    def place(phase: float) -> tuple[float, float]:
        """Way ahead of what is on the ground, and how far it is off it, of 1."""
        whole, over = math.floor(phase), phase % 1.0
        if over < on:
            return (whole + on / 2) * stride, 0.0
        share = (over - on) / (1 - on)
        return (whole + on / 2 + eased(share)) * stride, math.sin(math.pi * share) ** 2

    def hand(phase: float, shift: float) -> Hand:
        z, off = place(phase)
        return Hand(
            (0.18, 0.035 + 0.10 * off, z + shift + 0.47), (-0.15, -0.8 * off, 1), DOWN, (0.8, 0.3, -0.5), "ground"
        )

    def foot(phase: float, shift: float) -> Foot:
        z, off = place(phase)
        return Foot((0.12, 0.105 + 0.04 * off, z + shift - 0.43), 150 - 10 * off, (0.1, -1, 0.35), 0)

    def at(phase: float) -> Pose:
        sway = math.sin(2 * math.pi * phase)
        return Pose(
            hand(phase, 0.0), hand(phase - 0.5, stride / 2), (2, 4 * sway, 0), (-48, -4 * sway, 0), 0.0,
            (0.02 * sway, 0.515 - _HIP, stride * phase), 4 * sway,
            foot(phase - 0.5, stride / 2), foot(phase, 0.0), 88.0,
        )  # fmt: skip

    keys, cycle = cycled(at, 1.3, 6)
    texts = (
        "a person crawls forward on hands and knees", "crawls on all fours", "crawls", "a person crawls",
        "crawls forward on the hands and knees", "a baby crawls", "a person is crawling on the floor",
    )  # fmt: skip
    return Gesture("crawl", texts, keys, cycle, steps=True)


_HEIGHT = 0.75
"""Of the pelvis of who swims, over the floor that is no floor [m]."""


def _front_crawl() -> Gesture:
    # the right hand goes in, pulls under the body, comes out at the hip and goes ahead over the water
    way = (
        ((0.16, 2.06, 0.06), (0, 1, 0.1), (0, -0.1, 1), (0.9, -0.2, -0.5)),
        ((0.17, 1.98, 0.26), (0, 0.9, 0.5), (0, -0.6, 0.8), (0.9, 0.2, -0.4)),
        ((0.15, 1.66, 0.50), (-0.2, 0.2, 1), (0, -1, 0.2), (1, 0.3, 0)),
        ((0.14, 1.28, 0.46), (-0.2, -0.3, 1), (0, -1, -0.2), (1, 0, -0.2)),
        ((0.24, 0.92, 0.14), (0, -1, 0.2), (-0.6, -0.2, -0.8), (0.8, 0.2, -0.6)),
        ((0.40, 1.02, -0.24), (0.1, -0.9, 0), (-0.2, 0, -1), (0.7, 0.3, -1)),
        ((0.50, 1.44, -0.22), (0.1, 0.3, 0.5), (0, -0.3, 1), (0.6, 0.4, -1)),
        ((0.34, 1.84, -0.04), (-0.1, 1, 0.3), (0, -0.2, 1), (0.9, 0.2, -0.7)),
    )
    arm = round_of([Pose(right=Hand(*hand)) for hand in way])

    def at(phase: float) -> Pose:
        roll = math.sin(2 * math.pi * (phase - 0.16))

        def leg(side: float) -> Foot:
            beat = math.sin(2 * math.pi * 3 * phase) * side
            return Foot(
                (0.10, _HEIGHT - 0.02 + 0.13 * beat, 0.95 * phase * 1.3 - 0.88 + 0.02 * beat), 150, (0, -1, 0.1), 0
            )

        return Pose(
            arm(phase).right, arm(phase + 0.5).right, (-6, -14 * roll, 0), (-22, -26 * max(-roll, 0.0), 0), 0.0,
            (0, _HEIGHT - _HIP, 0.95 * phase * 1.3), 0.0, leg(1.0), leg(-1.0), 88.0,
        )  # fmt: skip

    keys, cycle = cycled(at, 1.3, 6)
    texts = (
        "a person swims front crawl, one arm after the other", "swims freestyle", "swims", "a person swims",
        "swims through the water", "a person is swimming", "swims forward",
    )  # fmt: skip
    return Gesture("swim", texts, keys, cycle, steps=True)


def _breaststroke() -> Gesture:
    glide = Hand((0.05, 2.08, 0.04), (-0.1, 1, 0), (0.3, 0, 1), (0.9, -0.2, -0.4))
    catch = Hand((0.46, 1.88, 0.18), (0.5, 0.8, 0.2), (0.6, -0.4, 0.6), (0.8, 0.3, -0.4))
    pull = Hand((0.44, 1.52, 0.42), (0.0, 0.5, 0.9), (-0.2, -1, 0.1), (1, 0.2, -0.1))
    chest = Hand((0.07, 1.50, 0.32), (-0.3, 1, 0.2), (-0.8, 0, 0.3), (0.8, -0.8, 0.1))

    def leg(out: float, up: float, back: float, turn: float = 0.0) -> Foot:
        return Foot((out, _HEIGHT + up, -back), 150 - turn, (0.6 + 0.02 * turn, -1, 0.3), 0.5 * turn)

    straight, drawn, out = leg(0.09, -0.02, 0.88), leg(0.20, 0.14, 0.42, 40), leg(0.46, 0.04, 0.66, 40)
    plan = (
        (glide, straight, 0.0), (glide, straight, 0.0), (catch, straight, 4.0), (pull, straight, 14.0),
        (chest, drawn, 18.0), (glide, drawn, 6.0), (glide, out, 0.0),
    )  # fmt: skip
    poses = [
        Pose(hand, hand, (-rise, 0, 0), (-14 - rise, 0, 0), 0.0, (0, _HEIGHT - _HIP, 0), 0.0, foot, foot, 88.0)
        for hand, foot, rise in plan
    ]
    around = round_of(poses)

    def at(phase: float) -> Pose:
        pose, way = around(phase), 1.5 * phase
        (x, y, z), feet = pose.hips, []
        for foot in (pose.right_foot, pose.left_foot):
            side, up, along = foot.ankle
            feet.append(replace(foot, ankle=(side, up, along + way)))
        return replace(pose, hips=(x, y, z + way), right_foot=feet[0], left_foot=feet[1])

    keys, cycle = cycled(at, 2.1, 4)
    texts = (
        "a person swims breaststroke with both arms and legs at once", "swims breaststroke",
        "a person swims breaststroke", "swimming breaststroke", "does the breaststroke",
    )  # fmt: skip
    return Gesture("breaststroke", texts, keys, cycle, steps=True)


FLOOR: tuple[Gesture, ...] = (_sit_ups(), _push_ups(), _crawl(), _front_crawl(), _breaststroke())
