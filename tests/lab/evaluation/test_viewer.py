"""What a viewer of a motion sees."""

from dataclasses import replace

import numpy as np
import pytest
from look import sliding_contacts

from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_y
from bunraku.core.motion import HandleMotion, SkeletalMotion
from bunraku.generation.features import body_handle_motion, decode, encode, mirror
from bunraku_lab.datasets.motions.clips import write_clip, write_index
from bunraku_lab.evaluation.motion.viewer import (
    DOERS,
    floating,
    heading_drift,
    kicking_side,
    lowest_points,
    moving_speed,
    punching_side,
    raised_side,
    sits,
    stepped_side,
    tremor,
    turned,
    wave_of,
    waving_side,
)
from bunraku_lab.evaluation.motion.viewer_prompts import Captured, captured_clips

FRAMES = 80
TIME = np.arange(FRAMES) / 20
REST = reference_body().handles.positions
SHOULDER, WRIST = (REST[HANDLE_NAMES.index(f"left_{part}")] for part in ("shoulder", "wrist"))


def moving(path=None, angle=None, frames=FRAMES, **parts):
    """The reference body in its rest pose, arms hanging, along a path (N, 3), turned about +Y [degrees]; parts go by an
    offset.
    """
    translations = np.zeros((frames, HANDLE_COUNT, 3))
    for side, out in (("left", 1), ("right", -1)):
        for name in ("elbow", "wrist", "fingers"):
            handle = HANDLE_NAMES.index(f"{side}_{name}")
            drop = abs(REST[handle, 0]) - SHOULDER[0]
            translations[:, handle] = [-out * drop, -drop, 0]
    for name, offset in parts.items():
        translations[:, HANDLE_NAMES.index(name)] += offset
    turn = matrix_y(np.radians(np.zeros(frames) if angle is None else angle))
    still = np.tile(np.eye(3), (frames, HANDLE_COUNT, 1, 1))
    return HandleMotion(translations, still, np.zeros((frames, 3)) if path is None else path, turn)


def mirrored(motion):
    return decode(mirror(encode(motion)))


def ramp(start, stop):
    """0 before one second, 1 after another, and straight between."""
    return np.clip((TIME - start) / (stop - start), 0, 1)


def along(axis, values):
    return np.eye(3)["xyz".index(axis)] * np.asarray(values, float)[:, None]


def waving(values, side="left"):
    """A hand held 30 cm over the shoulder that goes aside by some values [m] and ahead by half of them."""
    values = np.asarray(values, float)
    length = WRIST[0] - SHOULDER[0]
    there = np.stack([values, np.full(len(values), length + 0.3), values / 2], 1)
    return moving(frames=len(values), **{f"{side}_wrist": there})


def test_turns():
    assert turned(moving(angle=90 * ramp(1, 2.5))) == pytest.approx(90, abs=0.1)  # +Z to +X is the body's left
    assert turned(moving(angle=-90 * ramp(1, 2.5))) == pytest.approx(-90, abs=0.1)
    assert turned(moving(angle=540 * ramp(1, 3))) == pytest.approx(540, abs=0.1)
    there_and_back = moving(angle=-70 * (ramp(0.5, 1.5) - ramp(2.5, 3.5)))
    assert turned(there_and_back) == pytest.approx(0, abs=0.1)
    assert heading_drift(there_and_back) == pytest.approx(70, abs=0.1)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_wave_of_known_width_and_frequency(side):
    other = "left" if side == "right" else "right"
    wave = wave_of(waving(0.1 * np.sin(2 * np.pi * 2 * TIME + 0.3), side), side)
    whole = 2 * 10 * np.hypot(1, 0.5)
    assert wave.range == pytest.approx(whole * np.sin(0.45 * np.pi), rel=0.03)  # percentiles of a sine
    assert wave.fast < 1e-3
    assert wave_of(waving(0.01 * np.sin(2 * np.pi * 8 * TIME), side), side).fast > 0.999
    assert wave_of(waving(0 * TIME, side), other) is None
    assert waving_side(waving(0.1 * np.sin(12 * TIME), side)) == side
    assert waving_side(moving()) is None


def test_raising_a_hand_is_no_wave():
    lifted = ramp(0.5, 1.0)[:, None] * waving(0 * TIME).translations[0, HANDLE_NAMES.index("left_wrist")]
    hanging = moving().translations[0, HANDLE_NAMES.index("left_wrist")]
    motion = moving(left_wrist=lifted - ramp(0.5, 1.0)[:, None] * hanging)
    assert wave_of(motion, "left").range < 0.1
    assert raised_side(motion) == "left" and raised_side(mirrored(motion)) == "right"
    both = replace(motion, translations=motion.translations + mirrored(motion).translations - moving().translations)
    assert raised_side(both) is None and raised_side(moving()) is None


def test_the_leg_that_kicks():
    swing = np.sin(np.pi * ramp(1, 1.6))
    kick = along("y", 0.6 * swing) + along("z", 0.7 * swing)
    motion = moving(right_ankle=kick, right_foot=kick, right_knee=kick / 2, left_ankle=along("y", 0.1 * swing))
    assert kicking_side(motion) == "right" and kicking_side(mirrored(motion)) == "left"
    assert kicking_side(moving()) is None
    assert kicking_side(moving(left_ankle=along("y", 0.2 * swing))) is None  # a step


def test_the_hand_that_punches():
    thrust = np.sin(np.pi * ramp(1, 1.5))
    motion = moving(
        left_wrist=along("z", 0.5 * thrust), right_wrist=along("z", 0.1 * thrust), angle=np.full(FRAMES, 120.0)
    )
    assert punching_side(motion) == "left" and punching_side(mirrored(motion)) == "right"
    assert punching_side(moving(left_wrist=along("z", 0.5 * ramp(1, 3)))) is None  # too slow
    assert punching_side(moving(path=along("z", 5 * TIME))) is None  # the whole body goes


def test_the_side_of_a_step_is_that_of_the_first_heading():
    step = along("x", 0.4 * ramp(1, 2))
    assert stepped_side(moving(path=step)) == "left" and stepped_side(moving(path=-step)) == "right"
    assert stepped_side(moving(path=along("z", 0.4 * ramp(1, 2)), angle=np.full(FRAMES, 90.0))) == "right"
    assert stepped_side(moving(path=along("z", TIME))) is None
    assert set(DOERS) == {"kick", "punch", "raise", "wave", "step"}


def test_speed_counts_while_somebody_goes():
    assert moving_speed(moving(path=along("z", 1.3 * TIME))) == pytest.approx(1.3, rel=1e-3)
    assert moving_speed(moving(path=along("z", 1.3 * np.minimum(TIME, 3)))) == pytest.approx(1.3, rel=0.1)
    assert moving_speed(moving(path=along("z", 0.1 * TIME))) == 0


def test_tremor_of_a_sine():
    size, rate = 0.01, 0.7  # m, radians a frame
    frames = np.arange(2000)
    motion = moving(path=along("x", size * np.sin(rate * frames)), frames=len(frames))
    assert tremor(motion) == pytest.approx(100 * size * (2 * np.sin(rate / 2)) ** 3 * 2 / np.pi, rel=1e-2)
    assert tremor(moving(path=along("x", TIME))) == pytest.approx(0, abs=1e-3)
    assert tremor(moving(frames=3)) == 0


def test_a_foot_that_floats_by_a_known_height():
    points = lowest_points(moving(path=along("y", np.full(FRAMES, 0.12))))
    assert all(np.allclose(height, 0.12, atol=5e-3) for height in points.values())
    assert floating(moving(path=along("y", np.full(FRAMES, 0.12)))).all()
    assert not floating(moving(path=along("y", np.full(FRAMES, 0.03)))).any()
    lift = np.full(FRAMES, 0.3)
    leg = {f"left_{part}": along("y", lift) for part in ("knee", "ankle", "foot")}
    one = moving(**leg)
    assert lowest_points(one)["left"].min() == pytest.approx(0.3, abs=0.02) and not floating(one).any()
    assert floating(moving(path=along("y", 0.12 * ((TIME > 1) & (TIME < 2))))).sum() == 19  # hovers: no jump


def test_a_jump_is_no_floating():
    flight = np.clip(TIME - 1, 0, 0.8)
    thrown = 9.81 / 2 * flight * (0.8 - flight)
    assert lowest_points(moving(path=along("y", thrown)))["body"].max() == pytest.approx(9.81 * 0.8**2 / 8, abs=0.02)
    assert not floating(moving(path=along("y", thrown))).any()
    slow = np.sin(np.pi * np.clip((TIME - 1) / 2, 0, 1))
    assert floating(moving(path=along("y", slow))).any()  # two seconds up there
    assert floating(moving(path=along("y", thrown)).take(slice(24, None))).any()  # nothing tells how it came up


def test_sitting():
    low = along("y", -0.4 * ramp(1, 2))
    legs = {f"{side}_{part}": -low for side in ("left", "right") for part in ("ankle", "foot")}
    assert sits(moving(path=low, **legs))
    assert not sits(moving(path=low))  # the feet are in the ground
    assert not sits(moving())  # stands
    hovering = moving(path=low, **{name: offset + along("y", 0.3 * ramp(1, 2)) for name, offset in legs.items()})
    assert not sits(hovering)
    up_again = -0.4 * (ramp(0.5, 1) - ramp(2, 3))
    again = {name: along("y", -up_again) for name in legs}
    assert not sits(moving(path=along("y", up_again), **again))


def test_captured_clips_of_the_same_words(tmp_path):
    clip = moving(path=along("x", TIME))
    index = {}

    def add(name, text, split, **more):
        write_clip(tmp_path / f"{name}.npz", clip)
        index[name] = {"texts": [text], "split": split, "frames": FRAMES} | more

    for number in range(8):
        add(f"walk{number}", "a person walks forward", "test" if number % 2 else "val")
    add("more", "a person walks forward", "train")
    add("slow", "a person walks slowly", "test")
    add("both", "a person walks and waves", "test")
    add("dog", "a dog walks", "test", species="dog")
    parts = [
        {"start": 0, "stop": 30, "texts": ["a person kicks"]},
        {"start": 30, "stop": 80, "texts": ["a person kicks"], "fault": "jitters"},
    ]
    add("kicks", "a person kicks", "train", stretches=parts)
    write_index(tmp_path, index)
    wanted = {
        "walk": Captured("", "walk", r"\bwalk", r"\bslow"), "slow walk": Captured("", "walk", r"\bslow"),
        "kick": Captured("", "kick"), "run": Captured("", "run"),
    }  # fmt: skip
    found = captured_clips(tmp_path, wanted)
    assert {name: len(clips) for name, clips in found.items()} == {"walk": 8, "slow walk": 1, "kick": 1, "run": 0}
    assert len(found["kick"][0]) == 30 and moving_speed(found["walk"][0]) == pytest.approx(1, rel=1e-3)


def standing(speed, frames=20):
    """The reference body at rest, carried along z [m/s]."""
    body = reference_body()
    root = np.tile(body.joints[0].astype(float), (frames, 1))
    root[:, 2] += speed * np.arange(frames) / 20
    return body_handle_motion(SkeletalMotion(body.skeleton, np.tile(np.eye(3), (frames, 22, 1, 1)), root, 20.0))


def test_who_stands_slides_nowhere_and_who_is_carried_does_in_all_frames():
    still, slow, fast = (sliding_contacts(standing(speed)) for speed in (0.0, 0.19, 0.5))
    assert still == (0, 0, 2 * 19)
    assert slow.fast == 0 and slow.far == slow.contacts - 2 * 3  # 3 cm are passed in the fourth frame
    assert fast.fast == fast.contacts
