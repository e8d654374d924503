"""GLB files against an independent player: playing, turned axes, and writing in a stream."""

import json
import struct

import numpy as np
import pytest
import trimesh
from gltf_files import made_up_handles, made_up_motion, textured_glb
from gltf_player import Player
from scipy.spatial.transform import Rotation

from bunraku import Animation, Character, FormatError, HandleMotion, Handles, OptionError
from bunraku.core.animation import RigAnimation
from bunraku.core.geometry.axes import ORIENTATIONS, upright_rotation
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.files import holds_character, load_character, load_skeleton_clip, save, save_character
from bunraku.files.clips import load_animation
from bunraku.files.gltf.clips import write_stretches
from bunraku.files.gltf.read import rotated, scaled
from bunraku_lab.synthetic.samples import make_sample


def random_animation(seed: int = 0, frames: int = 12, count: int = 5) -> Animation:
    rng = np.random.default_rng(seed)
    character = make_sample("mushroom", 0.3)
    positions = character.vertices[rng.integers(len(character.vertices), size=count)]
    weights = rng.dirichlet(np.ones(count), len(character.vertices)).astype(np.float32)
    rotations = (
        Rotation.from_rotvec(0.4 * rng.normal(size=(frames * count, 3))).as_matrix().reshape(frames, count, 3, 3)
    )
    translations = 0.1 * rng.normal(size=(frames, count, 3))
    rotations[:, 0], translations[:, 0] = np.eye(3), 0
    turns = Rotation.from_rotvec(rng.normal(size=(frames, 3))).as_matrix()
    return Animation(
        character,
        Handles(positions, weights).top(4),
        HandleMotion(translations, rotations, rng.normal(size=(frames, 3)), turns, 20.0),
    )


def test_what_is_written_plays_the_same(tmp_path):
    animation = random_animation()
    path = save(animation, tmp_path / "a.glb", fps=20.0)
    played = load_animation(path, fps=20.0)
    assert len(played.motion) == len(animation.motion)
    expected, got = animation.vertices(), played.vertices()
    assert np.abs(got - expected).max() < 1e-3 * animation.character.height


def hand_made(how: str, kind: str, times: list[float], values: np.ndarray) -> bytes:
    """A triangle of one joint whose `kind` is animated by `values`, written without the library."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
    blocks = [
        corners,
        np.zeros((3, 4), "u1"),
        np.tile(np.array([1, 0, 0, 0], "<f4"), (3, 1)),
        np.array(times, "<f4"),
        np.asarray(values, "<f4"),
    ]
    kinds = [
        (5126, "VEC3"),
        (5121, "VEC4"),
        (5126, "VEC4"),
        (5126, "SCALAR"),
        (5126, "VEC4" if kind == "rotation" else "VEC3"),
    ]
    views, accessors, data = [], [], b""
    for index, (block, (component, shape)) in enumerate(zip(blocks, kinds, strict=True)):
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": block.nbytes})
        accessors.append({"bufferView": index, "componentType": component, "count": len(block), "type": shape})
        data += block.tobytes()
    accessors[0] |= {"min": [0, 0, 0], "max": [1, 1, 0]}
    tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0, "skin": 0}, {"name": "bone"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}}]}],
        "skins": [{"joints": [1]}],
        "animations": [
            {
                "name": "Armature|Move",
                "samplers": [{"input": 3, "output": 4, "interpolation": how}],
                "channels": [{"sampler": 0, "target": {"node": 1, "path": kind}}],
            }
        ],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def play(tmp_path, *made, fps=10.0) -> np.ndarray:
    path = tmp_path / "made.glb"
    path.write_bytes(hand_made(*made))
    return load_animation(path, "Move", fps=fps).vertices()


def test_step_holds_each_key_and_the_last_stays(tmp_path):
    got = play(tmp_path, "STEP", "translation", [0.2, 0.5, 1], np.array([[1, 0, 0], [2, 0, 0], [3, 0, 0]]))
    np.testing.assert_allclose(got[:, 0, 0], [1] * 5 + [2] * 5 + [3])


def test_cubic_spline_is_hermite(tmp_path):
    from scipy.interpolate import CubicHermiteSpline

    keys = np.array([[0, 1], [2, -1], [-1, 0.5]])  # value and slope of x
    values = np.zeros((9, 3))
    values[0::3, 0], values[1::3, 0], values[2::3, 0] = keys[:, 1], keys[:, 0], keys[:, 1]
    times = [0, 0.7, 1]
    got = play(tmp_path, "CUBICSPLINE", "translation", times, values)
    np.testing.assert_allclose(
        got[:, 0, 0], CubicHermiteSpline(times, keys[:, 0], keys[:, 1])(np.arange(11) / 10), atol=1e-5
    )


def test_rotation_is_slerp(tmp_path):
    quarter = Rotation.from_euler("z", 90, degrees=True).as_quat()
    got = play(
        tmp_path, "LINEAR", "rotation", [0, 1], np.stack([[0, 0, 0, 1], -quarter])
    )  # the long sign of the same turn
    angle = np.radians(90) * np.arange(11) / 10
    np.testing.assert_allclose(got[:, 1, :2], np.stack([np.cos(angle), np.sin(angle)], axis=1), atol=1e-5)


def test_what_cannot_be_played(tmp_path):
    path = save_character(Character("t", np.eye(3), [[0, 1, 2]]), tmp_path / "still.glb")
    with pytest.raises(FormatError, match="no animation"):
        load_animation(path)
    with pytest.raises(OptionError, match="has no clip 'Fly'; it has Armature|Move"):
        (tmp_path / "m.glb").write_bytes(hand_made("LINEAR", "scale", [0, 1], np.ones((2, 3))))
        load_animation(tmp_path / "m.glb", "Fly")
    for times, values in (
        ([1, 0], np.ones((2, 3))),
        ([0, 1], np.ones((3, 3))),
        ([0, 1e9], np.ones((2, 3))),
        ([0, 1], np.full((2, 3), np.nan)),
    ):
        with pytest.raises(FormatError):
            play(tmp_path, "LINEAR", "translation", times, values)


@pytest.mark.parametrize(("up", "front"), ORIENTATIONS[::3])
def test_vertices_and_rig_turn_exactly(thing, up, front):
    rotation = upright_rotation(up, front)
    out = rotated(thing, up, front)
    assert np.array_equal(out.vertices, thing.vertices @ rotation.T.astype(np.float32))
    assert np.array_equal(out.faces, thing.faces) and np.array_equal(out.colors, thing.colors)
    if thing.rig is not None:
        assert np.allclose(out.rig.positions, thing.rig.positions @ rotation.T)


def surface(player):
    """Normals of all meshes where the skin or the node puts them at rest, by accessor."""
    out = []
    for node in player.tree["nodes"]:
        if "mesh" not in node:
            continue
        if "skin" in node:
            skin = player.tree["skins"][node["skin"]]
            inverse = player.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
            linear = inverse[0, :3, :3].astype(float)
        else:
            linear = np.array(node.get("matrix", np.eye(4).reshape(-1)), float).reshape(4, 4).T[:3, :3]
        for primitive in player.tree["meshes"][node["mesh"]]["primitives"]:
            if "NORMAL" in primitive["attributes"]:
                normals = player.accessor(primitive["attributes"]["NORMAL"]) @ np.linalg.inv(linear)
                out.append(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    return np.concatenate(out)


@pytest.mark.parametrize(("up", "front"), [("+z", "-y"), ("-x", "+y"), ("+y", "-z")])
@pytest.mark.parametrize("rigged", [True, False])
def test_a_turned_character_is_written_upright_with_all_that_it_wears(thing, tmp_path, up, front, rigged):
    rotation = upright_rotation(up, front)
    plain, out = tmp_path / "plain.glb", tmp_path / "turned.glb"
    character = rotated(thing, up, front)
    save_character(thing, plain, made_up_handles(thing) if rigged else None)
    save_character(character, out, made_up_handles(character) if rigged else None)
    before, after = Player(plain), Player(out)
    assert np.abs(after.vertices(0) - before.vertices(0) @ rotation.T).max() < 1e-5
    assert np.abs(surface(after) - surface(before) @ rotation.T).max() < 1e-5
    for key in ("materials", "textures", "samplers"):
        assert after.tree.get(key) == before.tree.get(key)
    for old, new in zip(before.tree["meshes"], after.tree["meshes"], strict=True):
        for one, other in zip(old["primitives"], new["primitives"], strict=True):
            kept = [name for name in one["attributes"] if name.startswith(("TEXCOORD", "COLOR"))]
            assert all(
                np.array_equal(before.accessor(one["attributes"][n]), after.accessor(other["attributes"][n]))
                for n in kept
            )


def test_the_player_sees_the_animation_of_a_turned_character(thing, tmp_path):
    character = rotated(thing, "+z", "-y")
    handles = made_up_handles(character)
    animation = Animation(character, handles, made_up_motion(character))
    player = Player(save(animation, tmp_path / "out.glb"))
    top = Animation(character, handles.top(), animation.motion).vertices()
    for frame in (0, 7, 23):
        assert np.abs(player.vertices(frame / 20) - top[frame]).max() < 2e-5 * character.height


@pytest.mark.parametrize("rigged", [True, False])
def test_a_scaled_character_is_written_smaller_with_all_that_it_wears(thing, tmp_path, rigged):
    plain, out = tmp_path / "plain.glb", tmp_path / "scaled.glb"
    character = scaled(thing, 0.01)
    assert scaled(thing, 1) is thing and character.height == pytest.approx(0.01 * thing.height)
    save_character(thing, plain, made_up_handles(thing) if rigged else None)
    save_character(character, out, made_up_handles(character) if rigged else None)
    before, after = Player(plain), Player(out)
    assert np.abs(after.vertices(0) - 0.01 * before.vertices(0)).max() < 1e-6
    assert np.abs(surface(after) - surface(before)).max() < 1e-5
    assert after.tree.get("materials") == before.tree.get("materials")
    if thing.rig is not None:
        assert np.allclose(character.rig.positions, 0.01 * thing.rig.positions)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_positions_of_a_format_without_a_unit_are_scaled_themselves(tmp_path, suffix):
    """So readers that see neither nodes nor skins see metres too."""
    path, box = tmp_path / f"box.{suffix}", trimesh.creation.box((80, 170, 50))
    box.export(path)
    character = rotated(scaled(load_character(path, unit="m"), 0.01), "+z", "-y")
    player = Player(save_character(character, tmp_path / "out.glb", made_up_handles(character)))
    raw = player.accessor(player.tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"])
    assert sorted(np.ptp(raw, axis=0)) == pytest.approx([0.5, 0.8, 1.7])
    assert np.ptp(player.vertices(0), axis=0) == pytest.approx([0.8, 0.5, 1.7], abs=1e-5)
    again = load_character(path, unit="m")
    assert np.ptp(again.vertices, axis=0) == pytest.approx([80, 170, 50])


@pytest.fixture
def textured(tmp_path):
    path = tmp_path / "textured.glb"
    path.write_bytes(textured_glb())
    return load_character(path)


def whole(character, kind, frames=41):
    if kind == "handles":
        handles = made_up_handles(character).top(4)
        return Animation(character, handles, made_up_motion(character, frames=frames))
    bones, share = len(character.rig.names), np.linspace(0, 3, frames)[:, None, None]
    turns = matrix_from_axis_angle(np.sin(share) * np.random.default_rng(0).normal(size=(1, bones, 3)))
    return RigAnimation(character, turns, 0.1 * np.sin(share) * np.ones((1, bones, 3)), 20.0)


def cut(animation, at):
    """Stretches of which each begins with the last frame of the one before."""
    bounds = [0, *at, 40]
    return [animation.take(slice(low, high + 1)) for low, high in zip(bounds, bounds[1:], strict=False)]


@pytest.mark.parametrize("kind", ["handles", "bones"])
@pytest.mark.parametrize("fps", [20.0, 30.0, 12.0])
def test_stretches_play_as_the_whole_does(textured, tmp_path, kind, fps):
    animation = whole(textured, kind)
    one = write_stretches([animation], tmp_path / "one.glb", fps=fps)
    some = write_stretches(iter(cut(animation, [7, 8, 29])), tmp_path / "some.glb", fps=fps)
    known = load_animation(animation.save(tmp_path / "known.glb", fps=fps), 0, fps)
    for path in (one, some):
        played = load_animation(path, 0, fps)
        assert len(played.motion) == len(known.motion)
        assert np.abs(played.vertices() - known.vertices()).max() < 1e-4 * textured.height
    assert not list(tmp_path.glob(".*"))


def test_a_skeleton_without_a_mesh_plays_as_it_does_with_one(textured, tmp_path):
    """In mesh-less files, as libraries of motions have them, joints are where they were."""
    animation = whole(textured, "bones")
    kept = RigAnimation(textured, animation.rotations, np.zeros_like(animation.translations), animation.fps)
    data = kept.save(tmp_path / "whole.glb", name="moves").read_bytes()
    size = struct.unpack("<I", data[12:16])[0]
    tree = json.loads(data[20 : 20 + size])
    del tree["meshes"], tree["skins"]
    for node in tree["nodes"]:
        node.pop("mesh", None)
        node.pop("skin", None)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I", len(text)) + b"JSON" + text + data[20 + size :]
    bare = tmp_path / "bare.glb"
    bare.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    motion = load_skeleton_clip(bare, "moves", animation.fps)
    names, positions = motion.skeleton.names, motion.world()[1]
    assert set(animation.rig.names) <= set(names) and len(motion) == len(animation) and not holds_character(bare)
    known = kept.world()[1]
    for bone, name in enumerate(animation.rig.names):
        assert np.abs(positions[:, names.index(name)] - known[:, bone]).max() < 1e-4 * textured.height
    assert load_skeleton_clip(tmp_path / "whole.glb") is None
