"""Writing GLB: played by an independent player, and compared with the file that came in."""

import dataclasses
import hashlib
import resource
import sys
import time

import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, Maker, made_up_handles, made_up_motion, textured_glb
from gltf_player import Player

from bunraku.core.animation import Animation
from bunraku.core.character import Character, Handles
from bunraku.core.motion import HandleMotion
from bunraku.errors import CharacterError, FormatError, OptionError
from bunraku.formats.gltf.write import joint_attributes
from bunraku.io import load_character, save_animation, save_character


def animate(character, count=30, **options):
    handles = made_up_handles(character, count)
    return Animation(character, handles, made_up_motion(character, count=count, **options))


@pytest.fixture
def thing(tmp_path):
    path = tmp_path / "thing.glb"
    path.write_bytes(textured_glb())
    return load_character(path)


@pytest.fixture
def ball():
    """A character of arrays alone: a sphere of 1,200 vertices."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 40), np.linspace(0, np.pi, 30))
    points = np.stack([np.sin(v) * np.cos(u), 1 + np.cos(v), np.sin(v) * np.sin(u)], -1).reshape(-1, 3)
    i = np.arange(1200).reshape(30, 40)[:-1, :-1].reshape(-1)
    faces = np.concatenate([np.stack([i, i + 1, i + 40], 1), np.stack([i + 1, i + 41, i + 40], 1)])
    return Character("ball", points, faces, colors=np.random.default_rng(0).integers(0, 256, (1200, 3)))


def test_the_player_sees_what_the_library_computes(thing, ball, tmp_path):
    for character in (thing, ball):
        animation = animate(character)
        player = Player(save_animation(animation, tmp_path / "out.glb"))
        top = Animation(character, animation.handles.top(), animation.motion).vertices()
        for frame in (0, 7, 23):
            played = player.vertices(frame / 20)
            assert np.abs(played - top[frame]).max() < 2e-5 * character.height
            mean = np.linalg.norm(played - animation.vertices([frame])[0], axis=1).mean()
            assert mean < 1e-3 * character.height


def test_the_default_pose_is_the_rest_pose(thing, ball, tmp_path):
    for character in (thing, ball):
        for handles in (made_up_handles(character), None):
            path = save_character(character, tmp_path / "rig.glb", handles)
            assert np.abs(Player(path).vertices(0) - character.vertices).max() < 1e-5
            again = load_character(path)
            assert np.abs(again.vertices - character.vertices).max() < 1e-5 and np.array_equal(
                again.faces, character.faces
            )
            assert np.abs(again.colors.astype(int) - character.colors).max() <= 1
            assert "animations" not in Player(path).tree and ("skins" in Player(path).tree) == (handles is not None)


def fingerprint(player, node):
    """What must not change of a mesh: everything but its positions, normals and skin."""
    out = []
    for primitive in player.tree["meshes"][node["mesh"]]["primitives"]:
        hashes = {
            name: hashlib.sha256(player.accessor(index).tobytes()).hexdigest()
            for name, index in primitive["attributes"].items()
            if name.startswith(("TEXCOORD", "COLOR"))
        }
        out.append(
            (player.tree["accessors"][primitive["attributes"]["POSITION"]]["count"], hashes, primitive.get("material"))
        )
    return out


def test_meshes_materials_textures_and_extras_are_the_same(thing, tmp_path):
    before, after = Player(tmp_path / "thing.glb"), Player(save_animation(animate(thing), tmp_path / "out.glb"))
    meshes = [[node for node in player.nodes if "mesh" in node] for player in (before, after)]
    assert [node["name"] for node in meshes[1]] == ["body", "hat", "mirrored hat"]
    for old, new in zip(*meshes, strict=True):
        assert fingerprint(before, old) == fingerprint(after, new)
        assert old.get("extras") == new.get("extras") and "skin" in new
    for key in ("materials", "textures", "samplers"):
        assert before.tree[key] == after.tree[key]
    assert after.tree["meshes"][0]["extras"] == {"maker": "us"} and after.tree["scenes"][0]["name"] == "stage"
    images = []
    for player in (before, after):
        view = player.tree["bufferViews"][player.tree["images"][0]["bufferView"]]
        images.append(player.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])
    assert images[0] == images[1]
    hat = [
        player.tree["meshes"][nodes[1]["mesh"]]["primitives"][0]
        for player, nodes in zip((before, after), meshes, strict=True)
    ]
    for name in ("POSITION",):  # a mesh that its node only places keeps its raw positions
        assert np.array_equal(before.accessor(hat[0]["attributes"][name]), after.accessor(hat[1]["attributes"][name]))
    assert np.array_equal(before.accessor(hat[0]["indices"]), after.accessor(hat[1]["indices"]))


def test_normals_of_a_bent_rest_pose_bend_with_it(thing, tmp_path):
    thing = load_character(thing.source.document.path, rest="default")
    after = Player(save_character(thing, tmp_path / "out.glb"))
    primitive = after.tree["meshes"][0]["primitives"][0]
    normals = after.accessor(primitive["attributes"]["NORMAL"])
    angle = 2 * np.arcsin(0.1736482)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    high = CUBE[:, 1] > 0
    raw = (CUBE - [0, 1, 0]) / np.sqrt(3)
    assert np.allclose(normals[~high], raw[~high], atol=1e-6) and np.allclose(
        normals[high], raw[high] @ turn.T, atol=1e-6
    )


def test_a_mirrored_mesh_is_turned_outwards(thing, tmp_path):
    again = load_character(save_character(thing, tmp_path / "out.glb", made_up_handles(thing)))
    corners = again.vertices[again.faces[24:]].astype(float) - again.vertices[again.faces[24:]].mean(axis=(0, 1))
    original = CUBE[CUBE_FACES] - CUBE.mean(axis=0)
    signs = [np.sign(np.einsum("ij,ij->i", c[:, 0], np.cross(c[:, 1], c[:, 2]))) for c in (corners, original)]
    assert np.array_equal(*signs)


def test_morph_targets_stay(tmp_path):
    maker = Maker()
    attributes = {"POSITION": maker.add(CUBE), "JOINTS_0": maker.add(np.tile([0, 1, 0, 0], (8, 1)).astype(np.uint8))}
    attributes["WEIGHTS_0"] = maker.add(np.c_[CUBE[:, 1] / 2, 1 - CUBE[:, 1] / 2, 0 * CUBE[:, :2]].astype(np.float32))
    primitive = {
        "attributes": attributes,
        "targets": [{"POSITION": maker.add(np.full_like(CUBE, 0.5))}],
        "indices": maker.add(CUBE_FACES.reshape(-1).astype(np.uint8)),
    }
    nodes = [{"mesh": 0, "skin": 0, "children": [1, 2]}, {"rotation": [0, 0.6, 0, 0.8]}, {"scale": [1, 2, 1]}]
    (tmp_path / "in.glb").write_bytes(
        maker.glb(nodes=nodes, meshes=[{"primitives": [primitive], "weights": [1]}], skins=[{"joints": [1, 2]}])
    )
    character = load_character(tmp_path / "in.glb")
    for handles in (None, made_up_handles(character)):
        path = save_character(character, tmp_path / "out.glb", handles)
        assert Player(path).tree["meshes"][0]["weights"] == [1]
        assert np.abs(load_character(path).vertices - character.vertices).max() < 1e-5


def test_the_skin_is_what_viewers_read(thing, tmp_path):
    player = Player(save_animation(animate(thing), tmp_path / "out.glb"))
    names = [player.nodes[joint]["name"] for joint in player.tree["skins"][0]["joints"]]
    assert len(names) == 30 and names[0] == "pelvis" and names[29] == "tail_tip"
    assert all(len(skin["joints"]) == 30 for skin in player.tree["skins"])
    assert player.nodes[0]["children"] == list(range(1, 30))
    for mesh in player.tree["meshes"]:
        for primitive in mesh["primitives"]:
            weights, joints = (player.accessor(primitive["attributes"][name]) for name in ("WEIGHTS_0", "JOINTS_0"))
            assert (
                np.abs(weights.astype(float).sum(axis=1) - 1).max() < 2e-7
                and (weights >= 0).all()
                and joints.max() < 30
            )
            assert not joints[weights == 0].any()
    assert player.tree["asset"]["generator"] == "bunraku"


def test_weights_in_float32_sum_to_one():
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.full(30, 0.05), 5000).astype(np.float32)
    joints, stored = joint_attributes(weights / weights.sum(axis=1, keepdims=True))
    assert np.abs(stored.sum(axis=1, dtype=np.float64) - 1).max() < 1e-7
    assert (stored[:, :-1] >= stored[:, 1:] - 1e-6).all() and joints.dtype == np.uint8
    assert joint_attributes(np.eye(3, dtype=np.float32))[1].shape == (3, 4)
    assert joint_attributes(np.eye(300, dtype=np.float32))[0].dtype == np.uint16


def test_channels_are_lean_and_quaternions_keep_their_sign(thing, tmp_path):
    animation = animate(thing, frames=60)
    player = Player(save_animation(animation, tmp_path / "out.glb", name="dance"))
    clip = player.tree["animations"][0]
    assert clip["name"] == "dance" and len(clip["channels"]) == 60
    keys = {}
    for channel in clip["channels"]:
        sampler = clip["samplers"][channel["sampler"]]
        values = player.accessor(sampler["output"])
        keys[channel["target"]["node"], channel["target"]["path"]] = len(values)
        if channel["target"]["path"] == "rotation":
            assert np.allclose(np.linalg.norm(values, axis=1), 1, atol=1e-6)
            assert ((values[1:] * values[:-1]).sum(axis=1) > 0).all()
        times = player.tree["accessors"][sampler["input"]]
        assert times["min"] == [0] and times["count"] == len(values)
    assert keys[5, "rotation"] == keys[5, "translation"] == 1 and keys[0, "rotation"] == keys[6, "translation"] == 60


def test_another_frame_rate_follows_the_same_motion(thing, tmp_path):
    animation = animate(thing, frames=21)
    slow = Player(save_animation(animation, tmp_path / "slow.glb"))
    fast = Player(save_animation(animation, tmp_path / "fast.glb", fps=60))
    assert (
        max(
            entry["count"]
            for entry in fast.tree["accessors"]
            if entry.get("max") == [1.0] and entry["type"] == "SCALAR"
        )
        == 61
    )
    for at in (0.0, 0.1, 1 / 3, 0.5167, 1.0):
        assert np.abs(slow.vertices(at) - fast.vertices(at)).max() < 3e-3
    for at in (0.0, 0.5, 1.0):
        assert np.abs(slow.vertices(at) - fast.vertices(at)).max() < 1e-5


def test_a_motion_that_stands_still_keeps_its_length(thing, tmp_path):
    frames = 41
    still = HandleMotion(
        np.zeros((frames, 30, 3)),
        np.tile(np.eye(3), (frames, 30, 1, 1)),
        np.zeros((frames, 3)),
        np.tile(np.eye(3), (frames, 1, 1)),
    )
    player = Player(save_animation(Animation(thing, made_up_handles(thing), still), tmp_path / "out.glb"))
    assert (
        max(entry["max"][0] for entry in player.tree["accessors"] if entry["type"] == "SCALAR" and "max" in entry) == 2
    )


def test_a_character_with_moved_vertices_is_written_as_it_is(thing, tmp_path):
    moved = dataclasses.replace(thing, vertices=thing.vertices * [1, 1.5, 1])
    path = save_character(moved, tmp_path / "out.glb", made_up_handles(moved))
    assert np.abs(Player(path).vertices(0) - moved.vertices).max() < 1e-5
    assert Player(path).tree["materials"] == Player(tmp_path / "thing.glb").tree["materials"]


def test_failures_leave_nothing_behind(thing, tmp_path, monkeypatch):
    animation = animate(thing)
    with pytest.raises(FormatError, match="does not exist"):
        save_animation(animation, tmp_path / "a" / "b" / "out.glb")
    assert save_animation(animation, tmp_path / "a" / "out.glb").is_file()
    with pytest.raises(FormatError, match="this is a folder"):
        save_animation(animation, tmp_path / "a")
    with pytest.raises(FormatError, match="are written to .glb"):
        save_animation(animation, tmp_path / "out.xyz")
    with pytest.raises(OptionError, match="no option 'speed'"):
        save_animation(animation, tmp_path / "out.glb", speed=2)
    for fps in (0, -1, float("nan"), "fast", 1e9):
        with pytest.raises(OptionError, match="fps must be"):
            save_animation(animation, tmp_path / "out.glb", fps=fps)
    with pytest.raises(CharacterError, match="handles weigh 3 vertices"):
        save_character(thing, tmp_path / "out.glb", Handles(np.zeros((1, 3)), np.ones((3, 1))))
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a", "thing.glb"]


def test_a_full_disk_leaves_the_old_file(thing, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # modules imported meanwhile would be cut off, for good
    animation = animate(thing)
    (tmp_path / "full").mkdir()
    path = save_animation(animation, tmp_path / "full" / "out.glb")
    old, limits = path.read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200, limits[1]))
    try:
        for name in ("out.glb", "out.npz", "out.obj"):
            with pytest.raises(FormatError, match="cannot be written"):
                save_animation(animation, path.with_name(name))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == old and [entry.name for entry in path.parent.iterdir()] == ["out.glb"]


def test_big_meshes_are_read_and_written_in_a_moment(tmp_path):
    n = 450
    u, v = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    i = np.arange(n * n).reshape(n, n)[:-1, :-1].reshape(-1)
    faces = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)])
    sheet = Character("sheet", np.stack([u, v, np.sin(9 * u)], -1).reshape(-1, 3), faces)
    animation = animate(sheet, count=8)
    start = time.perf_counter()
    path = save_animation(animation, tmp_path / "sheet.glb")
    written = time.perf_counter()
    load_character(path)
    assert written - start < 5 and time.perf_counter() - written < 5  # 0.1 s each on the machine this was written on
