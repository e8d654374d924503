"""GLBs as three.js, Blender and Godot show them; each is skipped where it is not there (see tools/check_viewers)."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "tools" / "check_viewers"))
from check import waving
from viewers import blender_missing, blender_vertices, godot_missing, godot_vertices, three_missing, three_vertices

from bunraku.core.animation import Animation, PointAnimation, RigAnimation
from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.files import load_character
from bunraku.files.presets import save_clips
from bunraku.retarget.to_reference import handle_animation

FPS, FRAMES = 20.0, [3, 7, 11]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A person who bows and turns an arm: the own rig, 30 handles, and handles with vertices that move on their own, by
    morph targets and by bones.
    """
    folder, body = tmp_path_factory.mktemp("viewers"), reference_body()
    turns, moves = np.zeros((12, 22, 3)), np.zeros((12, 22, 3))
    turns[:, JOINT_NAMES.index("left_shoulder")] = np.linspace(0, 1, 12)[:, None] * [0.9, 0.2, -1.3]
    turns[:, JOINT_NAMES.index("spine1"), 0] = np.linspace(0, 0.8, 12)
    turns[:, 0, 1] = np.linspace(0, 2.5, 12)
    moves[:, 0] = np.linspace(0, 1, 12)[:, None] * [0.3, 0.1, 1.5]
    still = RigAnimation(body.character(), matrix_from_axis_angle(0 * turns), moves, FPS)
    character = load_character(still.save(folder / "person.glb"))
    rig = RigAnimation(character, matrix_from_axis_angle(turns), moves, FPS)
    handles = handle_animation(rig)
    made = {"rig": rig, "handles": Animation(character, handles.handles, handles.motion), "points": waving(handles)}
    out = {
        kind: (animation.save(folder / f"{kind}.glb"), animation.vertices(FRAMES)) for kind, animation in made.items()
    }
    vertices, head = made["handles"].vertices(), character.vertices[:, 1] > 1.45
    nod = matrix_from_axis_angle(np.linspace(0, 0.7, 12)[:, None] * [1.0, 0.3, 0])
    vertices[:, head] = np.einsum("nab,mb->nma", nod, character.vertices[head])
    nodding = PointAnimation.of_vertices(made["handles"], vertices)
    out["bones"] = nodding.save(folder / "bones.glb", shapes="bones", tolerance=1e-3), nodding.vertices(FRAMES)
    return out


def compare(made, shown):
    height = reference_body().character().height
    for (kind, (_, known)), found in zip(made.items(), shown, strict=True):
        assert found.shape == known.shape, kind
        assert np.isfinite(found).mean() > 0.99
        assert np.nanmax(np.linalg.norm(found - known, axis=-1)) < 0.001 * height, kind


@pytest.fixture(scope="module")
def several(made, tmp_path_factory):
    """A file of four clips of one rig, and what each shows."""
    character = load_character(made["rig"][0])
    bones = len(character.rig.names)
    clips = {}
    for number, name in enumerate(("idle", "walk", "run", "attack")):
        swing = np.linspace(0, 1, 12)[:, None, None]
        turns = matrix_from_axis_angle(swing * np.random.default_rng(number).normal(size=(1, bones, 3)))
        clips[name] = RigAnimation(character, turns, np.zeros((12, bones, 3)), FPS)
    path = save_clips(clips, tmp_path_factory.mktemp("clips") / "four.glb")
    return path, [clip.vertices(FRAMES) for clip in clips.values()]


@pytest.mark.skipif(bool(three_missing()), reason=three_missing())
def test_three_js_shows_each_clip_of_a_file(several):
    for number, known in enumerate(several[1]):
        compare({number: (several[0], known)}, three_vertices([(several[0], np.array(FRAMES) / FPS)], number))


@pytest.mark.skipif(bool(blender_missing()), reason=blender_missing())
def test_blender_shows_each_clip_of_a_file(several):
    for number, known in enumerate(several[1]):
        compare({number: (several[0], known)}, blender_vertices([(several[0], np.array(FRAMES) / FPS)], FPS, number))


@pytest.mark.skipif(bool(godot_missing()), reason=godot_missing())
def test_godot_shows_each_clip_of_a_file(several):
    for number, known in enumerate(several[1]):
        compare({number: (several[0], known)}, godot_vertices([(several[0], np.array(FRAMES) / FPS)], FPS, number))


@pytest.mark.skipif(bool(three_missing()), reason=three_missing())
def test_three_js_shows_what_was_written(made):
    compare(made, three_vertices([(file, np.array(FRAMES) / FPS) for file, _ in made.values()]))


@pytest.mark.skipif(bool(blender_missing()), reason=blender_missing())
def test_blender_shows_what_was_written(made):
    compare(made, blender_vertices([(file, np.array(FRAMES) / FPS) for file, _ in made.values()], FPS))


@pytest.mark.skipif(bool(godot_missing()), reason=godot_missing())
def test_godot_shows_what_was_written(made):
    compare(made, godot_vertices([(file, np.array(FRAMES) / FPS) for file, _ in made.values()], FPS))
