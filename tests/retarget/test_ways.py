"""What bodies need to fly, swim and slither, on motions in which a generator did nothing of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.animation import Animation
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.geometry.rotations import axis_angle_from_matrix, matrix_from_axis_angle, matrix_y
from bunraku.retarget.creatures.ways import BEATS, HOVER, TILT, in_air, moved_so, wing_swing, wings_carry
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.rig_parts import RigParts
from bunraku_lab.synthetic.families import EVALUATION_SEED, code_made_character
from bunraku_lab.synthetic.samples import make_sample

FRAMES = 60
EVERY = slice(0, FRAMES)


def still() -> HandleMotion:
    turns = np.tile(np.eye(3), (FRAMES, 30, 1, 1))
    return HandleMotion(np.zeros((FRAMES, 30, 3)), turns, np.zeros((FRAMES, 3)), turns[:, 0], 20.0).of_own_body()


@pytest.fixture(scope="module")
def dragon():
    return RigParts.of(make_sample("dragon", rigged=True))


@pytest.fixture(scope="module")
def snake():
    return RigParts.of(code_made_character("snake", EVALUATION_SEED))


def part(parts, motion: HandleMotion, name: str) -> np.ndarray:
    """Where a part's middle is in each frame [m], shape (N, 3)."""
    weight = parts.handles.weights[:, HANDLE_NAMES.index(name)]
    held = weight > 0.5 * weight.max()
    world = motion.transforms(parts.handles.positions)
    return skin(parts.character.vertices[held], parts.handles.weights[held], world).mean(axis=1)


def test_what_flies_is_lifted_and_beats_its_wings_together(dragon):
    assert dragon.anatomy.plan.wings
    flown = moved_so(still(), "fly", EVERY, Anatomy.of(dragon.character, dragon.handles))
    root = float(reference_body().handles.positions[0, 1])
    assert flown.root_translation[:, 1].mean() == pytest.approx(HOVER * root, rel=0.1)
    assert wing_swing(still()) == 0 and wing_swing(flown) > BEATS
    fitted = fit_motion(flown, Anatomy.of(dragon.character, dragon.handles), Stages(smooth=False))
    heights = dragon.character.vertices[:, 1].min(), fitted.root_translation[:, 1].min()
    assert heights[1] > 0.2 * dragon.character.height
    left, right = (part(dragon, fitted, f"{side}_wing")[:, 1] for side in ("left", "right"))
    trunk = part(dragon, fitted, "spine3")[:, 1]
    assert np.ptp(left - trunk) > 0.1 * dragon.character.height
    assert np.corrcoef(left - trunk, right - trunk)[0, 1] > 0.95


def test_wings_that_beat_already_beat_as_they_do(dragon):
    beating = moved_so(still(), "fly", EVERY, Anatomy.of(dragon.character, dragon.handles))
    again = moved_so(beating, "fly", EVERY, Anatomy.of(dragon.character, dragon.handles))
    np.testing.assert_array_equal(again.rotations, beating.rotations)


@pytest.mark.parametrize("angle, rate", [(0.5, 0.5), (0.12, 5.0)], ids=["slow", "small"])
def test_wings_that_swing_slowly_or_little_do_not_carry_a_body(dragon, angle, rate):
    drawn = turned(matrix_from_axis_angle(swings(angle, rate)), "left_wing")
    assert not wings_carry(drawn)
    flown = moved_so(drawn, "fly", EVERY, Anatomy.of(dragon.character, dragon.handles))
    wings = axis_angle_from_matrix(flown.rotations[:, HANDLE_NAMES.index("left_wing")].astype(float))
    beats = np.abs(np.fft.rfft(wings[:, 2] - wings[:, 2].mean()))[1:].argmax() + 1
    assert beats / (FRAMES / 20) == pytest.approx(2.2, abs=0.3)  # a second


@pytest.mark.parametrize(
    "angle, rate, carries", [(0.6, 2.2, True), (0.6, 0.6, False), (0.6, 1.5, True), (0.2, 4.0, False)]
)
def test_a_sine_carries_by_its_angle_and_by_its_speed(angle, rate, carries):
    """A sine of an angle swings through twice that, at four times its angle and its rate a second."""
    assert wings_carry(turned(matrix_from_axis_angle(swings(angle, rate)), "left_wing")) == carries


def swings(angle, rate):
    """Turns about the front, as a sine [rad], shape (FRAMES, 3)."""
    return angle * np.sin(2 * np.pi * rate * np.arange(FRAMES) / 20)[:, None] * np.array([0, 0, 1.0])


def test_what_flies_does_not_fall_over(dragon):
    falls = np.linspace(0, 2.5, FRAMES)[:, None] * np.array([0, 0, 1.0])
    motion = replace(turned(matrix_from_axis_angle(falls), "left_wing"), root_rotation=matrix_from_axis_angle(falls))
    flown = moved_so(motion, "fly", EVERY, Anatomy.of(dragon.character, dragon.handles))
    up = flown.root_rotation[:, 1, 1]  # of the body's own up
    assert np.degrees(np.arccos(up.min())) == pytest.approx(np.degrees(TILT), abs=1)
    assert not wings_carry(motion) and wings_carry(flown)  # a wing that is moved once does not beat


def test_flight_ends_where_a_clause_ends(dragon):
    part_of_it = moved_so(still(), "fly", slice(0, 30), Anatomy.of(dragon.character, dragon.handles))
    heights = part_of_it.root_translation[:, 1]
    assert heights[:20].min() > 0.3 and heights[-10:].max() < 1e-6
    np.testing.assert_allclose(part_of_it.rotations[-5:], still().rotations[-5:], atol=1e-6)


def test_loops_stay_loops(dragon):
    flown = moved_so(still(), "fly", EVERY, Anatomy.of(dragon.character, dragon.handles), loop=True)
    np.testing.assert_allclose(flown.rotations[-1], flown.rotations[0], atol=1e-5)


def test_a_wave_runs_along_what_slithers_and_it_gets_ahead(snake):
    moved = moved_so(still(), "slither", EVERY, Anatomy.of(snake.character, snake.handles))
    assert moved.root_translation[-1, 2] > 0.5 and np.abs(moved.root_translation[:, :2]).max() < 1e-6
    fitted = fit_motion(moved, Anatomy.of(snake.character, snake.handles), Stages(smooth=False))
    tail = part(snake, fitted, "tail")
    length = np.ptp(snake.character.vertices[:, 2])
    assert np.ptp(tail[:, 0]) > 0.03 * length and np.ptp(tail[:, 1]) < 0.02 * length


def test_what_travels_far_enough_keeps_its_way(snake):
    turned = replace(still(), root_rotation=np.tile(matrix_y(np.array(np.pi / 2)), (FRAMES, 1, 1)))
    path = np.linspace([0, 0, 0], [6.0, 0, 0], FRAMES)
    moved = moved_so(
        replace(turned, root_translation=path), "slither", EVERY, Anatomy.of(snake.character, snake.handles)
    )
    np.testing.assert_allclose(moved.root_translation, path, atol=1e-6)


def lows(parts, motion: HandleMotion) -> np.ndarray:
    """Height of the lowest vertex over that at rest, over the height, shape (N,)."""
    animation = Animation(parts.character, parts.handles, motion)
    return (animation.vertices()[..., 1].min(axis=1) - parts.character.vertices[:, 1].min()) / parts.character.height


def lifted(height: float, where: slice) -> HandleMotion:
    """The whole body higher in some frames, in heights of the root."""
    path = np.zeros((FRAMES, 3))
    path[where, 1] = height * reference_body().handles.positions[0, 1]
    return replace(still(), root_translation=path)


def turned(turn: np.ndarray, *names: str) -> HandleMotion:
    """Parts turned in all frames."""
    rotations = still().rotations.copy()
    rotations[:, [HANDLE_NAMES.index(name) for name in names]] = turn[..., None, :, :]
    return replace(still(), rotations=rotations)


def test_who_stays_on_the_ground_does_not_hover(dragon):
    hovers = lifted(0.8, EVERY)
    assert lows(dragon, fit_motion(hovers, Anatomy.of(dragon.character, dragon.handles))).min() > 0.2  # it could fly
    grounded = moved_so(hovers, "stay", EVERY, Anatomy.of(dragon.character, dragon.handles))
    assert np.abs(lows(dragon, fit_motion(grounded, Anatomy.of(dragon.character, dragon.handles)))).max() < 0.01


@pytest.mark.parametrize(("way", "kept"), [("stay", True), ("run", False), ("step", False)])
def test_a_jump_stays_a_jump_and_a_walk_has_none(dragon, way, kept):
    jump = lifted(0.5, slice(20, 34))  # 0.7 s
    moved = moved_so(jump, way, EVERY, Anatomy.of(dragon.character, dragon.handles))
    high = lows(dragon, fit_motion(moved, Anatomy.of(dragon.character, dragon.handles), Stages(smooth=False))).max()
    assert (high > 0.15) == kept


def test_a_tail_that_a_tilted_trunk_holds_up_is_lowered(dragon):
    tilt = matrix_from_axis_angle(np.array([np.radians(50), 0, 0]))
    leans = replace(still(), root_rotation=np.tile(tilt, (FRAMES, 1, 1)))
    moved = moved_so(leans, "step", EVERY, Anatomy.of(dragon.character, dragon.handles))
    tips = [
        part(dragon, fit_motion(one, Anatomy.of(dragon.character, dragon.handles)), "tail_tip")[:, 1].mean()
        for one in (leans, moved)
    ]
    assert tips[1] < tips[0] - 0.03 * dragon.character.height


def test_a_snake_lies_on_the_ground_whatever_was_drawn(snake):
    bow = matrix_from_axis_angle(np.sin(np.linspace(0, np.pi, FRAMES))[:, None] * np.array([1.0, 0, 0]))
    motion = turned(bow, "spine1", "spine2", "spine3", "neck", "head", "face", "head_top")
    motion = replace(motion, root_rotation=matrix_from_axis_angle(np.tile([0.4, 0, 0.2], (FRAMES, 1))))
    fitted = fit_motion(motion, Anatomy.of(snake.character, snake.handles))
    tail = part(snake, fitted, "tail")[:, 1]
    moved = fit_motion(
        moved_so(motion, "lie", EVERY, Anatomy.of(snake.character, snake.handles)),
        Anatomy.of(snake.character, snake.handles),
    )
    lies = part(snake, moved, "tail")[:, 1]
    height = snake.character.height
    assert np.ptp(tail) > 0.2 * height and np.ptp(lies) < 0.2 * np.ptp(tail)
    assert np.abs(lows(snake, moved)).max() < 0.02


def test_a_snake_raises_its_head(snake):
    up = matrix_from_axis_angle(np.array([-0.6, 0, 0]))
    motion = turned(up, "neck", "head", "face", "head_top")
    moved = moved_so(motion, "lie", EVERY, Anatomy.of(snake.character, snake.handles))
    np.testing.assert_allclose(moved.rotations, motion.rotations, atol=1e-6)


def test_other_ways_change_nothing(dragon):
    motion = still()
    assert moved_so(motion, "walk", EVERY, Anatomy.of(dragon.character, dragon.handles)) is motion
    assert moved_so(motion, "", EVERY, Anatomy.of(dragon.character, dragon.handles)) is motion
    assert in_air(motion).root_translation[:, 1].min() > 0
