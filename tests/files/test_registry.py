"""The registry of formats, units and up axes, and presets for engines."""

import logging
import time
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from gltf_files import CUBE, CUBE_FACES, cube_glb, glb_bytes, made_up_handles, made_up_motion, textured_glb
from hostile import is_one_sentence

import bunraku
from bunraku.core.animation import Animation, RigAnimation
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Rig
from bunraku.core.geometry.axes import likely_unit
from bunraku.core.geometry.rotations import matrix_y
from bunraku.errors import BunrakuError, CharacterError, FormatError, OptionError
from bunraku.files import load_character, save_character
from bunraku.files.clips import clip_names, load_animation
from bunraku.files.presets import PRESETS, on_root_bone, on_the_spot, root_bone
from bunraku.files.registry import load_with_clips, read_motion, resolve_unit
from bunraku.files.samples import sample_character


@pytest.mark.parametrize("name", ["cube.glb", "cube.txt", "cube.obj", "cube", "cube.GLB", "cube.ply", "cube.vrm"])
def test_the_first_bytes_tell_a_glb(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(cube_glb())
    assert np.array_equal(load_character(path).vertices, CUBE)


def test_unknown_and_wrong_suffixes(tmp_path):
    path = tmp_path / "thing.xyz"
    path.write_text("1 2 3\n")
    with pytest.raises(
        FormatError,
        match=r"'\.xyz' is not a format for this; characters are read from \.glb, \.vrm, \.gltf, \.ply, \.obj, \.stl",
    ):
        load_character(path)
    with pytest.raises(FormatError, match="a file without a suffix"):
        load_character(path.rename(tmp_path / "thing"))
    for suffix in (".glb", ".ply"):
        path = tmp_path / f"thing{suffix}"
        path.write_text("1 2 3\n")
        with pytest.raises(FormatError, match=f"its contents are not those of a {suffix} file"):
            load_character(path)
    path = tmp_path / "thing.glb"
    path.write_bytes(cube_glb())
    with pytest.raises(FormatError, match="no handle motion of Bunraku"):
        read_motion(path)


def test_files_that_are_none(tmp_path):
    with pytest.raises(FormatError, match="there is no such file"):
        load_character(tmp_path / "none.glb")
    with pytest.raises(FormatError, match="this is a folder"):
        load_character(tmp_path)
    (tmp_path / "empty.glb").touch()
    with pytest.raises(FormatError, match="the file is empty"):
        load_character(tmp_path / "empty.glb")
    with pytest.raises(FormatError, match="not a plain file"):
        load_character("/dev/null")
    with pytest.raises(FormatError):
        load_character("a\0b.glb")


def test_a_file_of_3_gb_is_refused_unread(tmp_path):
    path = tmp_path / "huge.glb"
    with path.open("wb") as file:
        file.truncate(3 << 30)
    start = time.process_time()
    with pytest.raises(FormatError, match=r"3\.0 GiB but at most 2 GiB"):
        load_character(path)
    assert time.process_time() - start < 0.5


def test_hostile_json_values(tmp_path):
    """Any value of the tree replaced by one of another kind: a character or one sentence."""
    import copy
    import json
    import struct

    whole, path = textured_glb(), tmp_path / "hostile.glb"
    size = struct.unpack_from("<I", whole, 12)[0]
    tree, binary = json.loads(whole[20 : 20 + size]), whole[28 + size :]
    spots = []

    def collect(item, above):
        for key in item if isinstance(item, dict) else range(len(item)):
            spots.append((*above, key))
            if isinstance(item[key], dict | list):
                collect(item[key], (*above, key))

    collect(tree, ())
    values = [-1, 0, 1e9, 2**63, 1e308, "x", None, [], {}, True, [[]], "\ud800"]
    for number, spot in enumerate(spots):
        for value in values[number % 6 :: 6]:
            changed = copy.deepcopy(tree)
            item = changed
            for key in spot[:-1]:
                item = item[key]
            item[spot[-1]] = value
            path.write_bytes(glb_bytes(changed, binary))
            try:
                load_character(path)
            except BunrakuError as error:
                assert is_one_sentence(error, path)


def test_outputs_that_are_not_files(tmp_path):
    import os

    from gltf_files import CUBE_FACES

    from bunraku.core.character import Character
    from bunraku.files import save_character

    cube = Character("cube", CUBE, CUBE_FACES)
    os.mkfifo(tmp_path / "pipe.glb")
    with pytest.raises(FormatError, match="not a plain file"):
        save_character(cube, tmp_path / "pipe.glb")
    with pytest.raises(FormatError, match="zero byte"):
        save_character(cube, tmp_path / "a\0b.glb")
    with pytest.raises(FormatError, match=r"'\.stl' is not a format for this; characters are written to \.glb"):
        save_character(cube, tmp_path / "cube.stl")
    with pytest.raises(CharacterError, match="a VRM needs a skeleton with VRM's names"):
        save_character(cube, tmp_path / "cube.vrm")
    with pytest.raises(FormatError, match="cannot be written"):
        save_character(cube, tmp_path / f"{'x' * 300}.glb")
    assert [entry.name for entry in tmp_path.iterdir()] == ["pipe.glb"]


@pytest.mark.parametrize(
    ("suffix", "magic"), [("mp4", b"ftyp"), ("webp", b"RIFF"), ("gif", b"GIF8"), ("png", b"\x89PNG")]
)
def test_pictures_are_saved_by_their_suffix(tmp_path, suffix, magic):
    cube = Character("cube", CUBE, CUBE_FACES)
    animation = Animation(cube, made_up_handles(cube), made_up_motion(cube, frames=3))
    assert magic in animation.save(tmp_path / f"dance.{suffix}", fps=10, size=(64, 48)).read_bytes()[:12]


def test_saving_under_a_name_that_says_nothing(tmp_path):
    cube = Character("cube", CUBE, CUBE_FACES)
    animation = Animation(cube, made_up_handles(cube), made_up_motion(cube, frames=3))
    with pytest.raises(FormatError, match=r"animations are written to \.glb, .*\.bvh, \.vrma, .*\.mp4"):
        animation.save(tmp_path / "dance.xyz")
    with pytest.raises(FormatError, match=r"motions are written to .*\.npz, \.bvh, \.vrma"):
        animation.motion.save(tmp_path / "dance.glb")
    with pytest.raises(OptionError, match="have no option 'unit'"):
        animation.save(tmp_path / "dance.glb", unit="cm")
    assert not list(tmp_path.iterdir())


def box(path, size):
    """A box of this size, standing on the ground."""
    mesh = trimesh.creation.box(size)
    mesh.apply_translation([0, size[1] / 2, 0])
    mesh.export(path)
    return path


@pytest.mark.parametrize(
    ("height", "unit"), [(1780, "mm"), (400, "mm"), (399, "cm"), (145.9, "cm"), (10, "cm"), (9.9, "m"), (0.04, "m")]
)
def test_the_unit_that_makes_a_height_a_characters(height, unit):
    assert likely_unit(height) == unit and likely_unit(0.039) == ""


def test_only_formats_without_a_unit_are_scaled():
    dragon = resolve_unit(145.9, ".stl")
    assert dragon.unit == "cm" and dragon.note == "145.9 tall: probably centimetres; taken as 1.46 m"
    assert (
        resolve_unit(145.9, ".glb").unit == "m" and "against the unit of its format" in resolve_unit(145.9, ".glb").note
    )
    assert resolve_unit(145.9, ".stl", "in").unit == "in" and resolve_unit(1.7, ".obj").note == ""
    tiny = resolve_unit(0.0178, ".obj")
    assert tiny.unit == "m" and "left as it is" in tiny.note


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_a_file_in_centimetres_is_read_in_metres(tmp_path, suffix, caplog):
    path = box(tmp_path / f"box.{suffix}", (80, 170, 50))
    with caplog.at_level(logging.WARNING):
        character = bunraku.load_character(path)
    assert np.ptp(character.vertices, axis=0) == pytest.approx([0.8, 1.7, 0.5])
    assert 'probably centimetres; taken as 1.7 m; say unit="m" to keep its numbers' in caplog.text
    caplog.clear()
    for unit, factor in (("m", 1), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254)):
        sized = load_character(path, unit=unit)
        assert np.ptp(sized.vertices, axis=0) == pytest.approx(np.array([80, 170, 50]) * factor)
    assert caplog.text == ""
    again = load_character(save_character(character, tmp_path / "out.glb"))
    assert again.height == pytest.approx(1.7)


def test_the_height_is_that_of_the_up_axis(tmp_path):
    path = box(tmp_path / "flat.stl", (900, 30, 200))
    assert load_character(path, up="y").height == pytest.approx(0.3)
    assert load_character(path, up="z").height == pytest.approx(2.0)
    assert load_character(path, up="x").height == pytest.approx(0.9)


def test_a_lying_mesh_is_measured_as_it_would_stand(tmp_path):
    """A robot in millimetres that lies is 350 deep: read along its +Y, that would be centimetres."""
    robot = sample_character("robot")
    lying = robot.vertices[:, [0, 2, 1]] * np.float32([1000, -1000, 1000])
    path = tmp_path / "robot.stl"
    trimesh.Trimesh(lying, robot.faces, process=False).export(path)
    character = load_character(path)
    assert np.ptp(character.vertices, axis=0).max() == pytest.approx(np.ptp(robot.vertices, axis=0).max(), rel=1e-3)


def test_an_unknown_unit_is_one_sentence(tmp_path):
    path = box(tmp_path / "box.obj", (1, 2, 1))
    with pytest.raises(OptionError, match="'ft' is not a unit of characters; there are auto, m, cm, mm, in"):
        load_character(path, unit="ft")


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
