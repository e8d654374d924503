"""What bodies need to fly, swim and slither, on motions in which a generator did nothing of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.motion import HandleMotion
from bunraku.core.skinning import skin
from bunraku.geometry.rotations import matrix_y
from bunraku.retarget.creatures.plan import plan_of
from bunraku.retarget.creatures.ways import BEATS, HOVER, in_air, moved_so, wing_swing
from bunraku.retarget.fit import Stages, fit_motion
from bunraku.retarget.rig_parts import RigParts
from bunraku.synthetic.families import EVALUATION_SEED, code_made_character
from bunraku.synthetic.samples import sample_character

FRAMES = 60
EVERY = slice(0, FRAMES)


def still() -> HandleMotion:
    turns = np.tile(np.eye(3), (FRAMES, 30, 1, 1))
    return HandleMotion(np.zeros((FRAMES, 30, 3)), turns, np.zeros((FRAMES, 3)), turns[:, 0], 20.0, native=True)


@pytest.fixture(scope="module")
def dragon():
    return RigParts.of(sample_character("dragon", rigged=True))


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
    assert plan_of(dragon.character, dragon.handles, dragon.joints).wings
    flown = moved_so(still(), "fly", EVERY, dragon.character, dragon.handles)
    root = float(reference_body().handles.positions[0, 1])
    assert flown.root_translation[:, 1].mean() == pytest.approx(HOVER * root, rel=0.1)
    assert wing_swing(still()) == 0 and wing_swing(flown) > BEATS
    fitted = fit_motion(flown, dragon.character, dragon.handles, Stages(smooth=False))
    heights = dragon.character.vertices[:, 1].min(), fitted.root_translation[:, 1].min()
    assert heights[1] > 0.2 * dragon.character.height
    left, right = (part(dragon, fitted, f"{side}_wing")[:, 1] for side in ("left", "right"))
    trunk = part(dragon, fitted, "spine3")[:, 1]
    assert np.ptp(left - trunk) > 0.1 * dragon.character.height
    assert np.corrcoef(left - trunk, right - trunk)[0, 1] > 0.95


def test_wings_that_beat_already_beat_as_they_do(dragon):
    beating = moved_so(still(), "fly", EVERY, dragon.character, dragon.handles)
    again = moved_so(beating, "fly", EVERY, dragon.character, dragon.handles)
    np.testing.assert_array_equal(again.rotations, beating.rotations)


def test_flight_ends_where_a_clause_ends(dragon):
    part_of_it = moved_so(still(), "fly", slice(0, 30), dragon.character, dragon.handles)
    heights = part_of_it.root_translation[:, 1]
    assert heights[:20].min() > 0.3 and heights[-10:].max() < 1e-6
    np.testing.assert_allclose(part_of_it.rotations[-5:], still().rotations[-5:], atol=1e-6)


def test_loops_stay_loops(dragon):
    flown = moved_so(still(), "fly", EVERY, dragon.character, dragon.handles, loop=True)
    np.testing.assert_allclose(flown.rotations[-1], flown.rotations[0], atol=1e-5)


def test_a_wave_runs_along_what_slithers_and_it_gets_ahead(snake):
    moved = moved_so(still(), "slither", EVERY, snake.character, snake.handles)
    assert moved.root_translation[-1, 2] > 0.5 and np.abs(moved.root_translation[:, :2]).max() < 1e-6
    fitted = fit_motion(moved, snake.character, snake.handles, Stages(smooth=False))
    tail = part(snake, fitted, "tail")
    length = np.ptp(snake.character.vertices[:, 2])
    assert np.ptp(tail[:, 0]) > 0.03 * length and np.ptp(tail[:, 1]) < 0.02 * length


def test_what_travels_far_enough_keeps_its_way(snake):
    turned = replace(still(), root_rotation=np.tile(matrix_y(np.array(np.pi / 2)), (FRAMES, 1, 1)))
    path = np.linspace([0, 0, 0], [6.0, 0, 0], FRAMES)
    moved = moved_so(replace(turned, root_translation=path), "slither", EVERY, snake.character, snake.handles)
    np.testing.assert_allclose(moved.root_translation, path, atol=1e-6)


def test_other_ways_change_nothing(dragon):
    motion = still()
    assert moved_so(motion, "walk", EVERY, dragon.character, dragon.handles) is motion
    assert moved_so(motion, "", EVERY, dragon.character, dragon.handles) is motion
    assert in_air(motion).root_translation[:, 1].min() > 0
