"""Files for engines: what stands in them is what the rows say."""

from dataclasses import replace

import numpy as np
import pytest

import bunraku
from bunraku.body.reference import reference_body
from bunraku.cli.options.skeleton import ProgramOption
from bunraku.core.animation import Animation
from bunraku.core.character import Rig
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import OptionError
from bunraku.geometry.rotations import matrix_y
from bunraku.io.play import clip_names, load_animation
from bunraku.io.presets import PRESETS, preset_named, preset_rows, save_for
from bunraku.io.registry import load_with_clips
from bunraku.io.root_motion import on_root_bone, on_the_spot, root_bone
from bunraku.skeletons.engine_names import SKELETONS


@pytest.fixture(scope="module")
def walking():
    """A person on a root bone, who goes a circle and sways."""
    person = reference_body().character()
    own = person.rig
    transforms = np.concatenate([np.eye(4)[None], own.transforms])
    rig = Rig(("root", *own.names), np.concatenate([[-1], own.parents + 1]), transforms, own.indices + 1, own.weights)
    still = RigAnimation(replace(person, rig=rig), np.tile(np.eye(3), (60, 23, 1, 1)), np.zeros((60, 23, 3)))
    turns, positions = still.world()
    angle = np.linspace(0, 2, 60)
    turned = matrix_y(angle)
    path = np.stack([np.sin(angle), 0.02 * np.sin(20 * angle), 2 * angle], axis=-1)
    positions[:, 1:] = np.einsum("nij,kj->nki", turned, rig.positions[1:]) + path[:, None]
    turns[:, 1:] = turned[:, None]
    return RigAnimation.of_world(still.character, turns, positions)


def test_the_travel_moves_to_the_root_bone_and_no_vertex_moves(walking):
    moved = on_root_bone(walking)
    assert root_bone(walking) == 0
    assert np.abs(moved.vertices() - walking.vertices()).max() < 1e-5
    turns, positions = moved.world()
    assert np.abs(positions[:, 0, 1]).max() < 1e-6 and positions[-1, 0, 2] == pytest.approx(4, abs=0.05)
    assert np.abs(turns[-1, 0] @ turns[0, 0].T - matrix_y(np.array(2.0))).max() < 0.05


def test_on_the_spot_nothing_travels_and_poses_stay(walking):
    spot = on_the_spot(walking)
    _, positions = spot.world()
    pelvis = positions[:, 1, [0, 2]]
    assert np.ptp(pelvis, axis=0).max() < 0.3 < np.ptp(walking.world()[1][:, 1, 2])
    assert np.abs(spot.rotations - walking.rotations).max() < 1e-5
    handles = Animation(walking.character, walking.handles, walking.motion)
    assert on_the_spot(handles).motion.rotations.shape == handles.motion.rotations.shape


def test_a_body_without_a_root_bone_stays_as_it_is(walking):
    handles = walking.animation()
    assert root_bone(handles) is None and on_root_bone(handles) is handles


@pytest.mark.parametrize("row", PRESETS, ids=lambda row: row.name)
def test_each_program_gets_its_files(walking, tmp_path, row):
    other = RigAnimation(walking.character, walking.rotations, walking.translations, walking.fps)
    written = bunraku.save_for(row.name, {"walk": walking, "run/fast": other}, tmp_path / "knight.glb")
    names = [path.name for path in written]
    assert names == ([f"knight{row.suffix}"] if row.one_file else ["knight-walk.fbx", "knight-run-fast.fbx"])
    document = load_with_clips(written[0], row.fps).source.document
    assert clip_names(document)[0] == "walk"
    played = load_animation(written[0], 0, row.fps)
    assert len(played.motion) == int(59 / 20 * row.fps + 1e-6) + 1
    assert played.character.height == pytest.approx(walking.character.height, rel=1e-5)
    if row.root != "none":
        want = walking.at(row.fps).vertices()
        assert np.linalg.norm(played.vertices() - want, axis=-1).max() < 1e-3


def test_the_rows_are_data(walking, tmp_path):
    assert {row["skeleton"] for row in preset_rows()} <= set(SKELETONS)
    options = ProgramOption.__args__[0].__args__
    assert {name for option in options for name in getattr(option, "__args__", ())} == {row.name for row in PRESETS}
    with pytest.raises(OptionError, match="there are unity, unreal"):
        save_for("maya", {"walk": walking}, tmp_path / "a.fbx")
    files = preset_named("unreal").files("a.fbx", ["x/y", "x y"])
    assert [path.name for path in files] == ["a-x-y.fbx", "a-x-y-1.fbx"]
