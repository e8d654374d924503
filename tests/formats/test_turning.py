"""Characters turned by right angles, and the files that are written of them, seen by an independent player."""

import numpy as np
import pytest
import trimesh
from gltf_files import made_up_handles, made_up_motion, textured_glb
from gltf_player import Player
from test_validator import awkward_glb, errors, needs_validator

from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.errors import OptionError
from bunraku.formats.gltf.turning import scaled, turned
from bunraku.geometry.axes import ORIENTATIONS, upright_rotation
from bunraku.io import load_character, save_animation, save_character


@pytest.fixture
def thing(tmp_path):
    path = tmp_path / "thing.glb"
    path.write_bytes(textured_glb())
    return load_character(path)


def test_a_character_that_stands_is_left_alone(thing):
    assert turned(thing, "+y", "+z") is thing
    with pytest.raises(OptionError, match="right angle"):
        turned(thing, "+y", "-y")


@pytest.mark.parametrize(("up", "front"), ORIENTATIONS[::3])
def test_vertices_and_rig_turn_exactly(thing, up, front):
    rotation = upright_rotation(up, front)
    out = turned(thing, up, front)
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
    character = turned(thing, up, front)
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
    character = turned(thing, "+z", "-y")
    handles = made_up_handles(character)
    animation = Animation(character, handles, made_up_motion(character))
    player = Player(save_animation(animation, tmp_path / "out.glb"))
    top = Animation(character, handles.top(), animation.motion).vertices()
    for frame in (0, 7, 23):
        assert np.abs(player.vertices(frame / 20) - top[frame]).max() < 2e-5 * character.height


def test_a_character_of_arrays_turns_too(tmp_path):
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 2], [0, 1, 0]], np.float32)
    character = turned(Character("arrays", points, [[0, 1, 2], [0, 2, 3]]), "+z", "-y")
    assert character.height == 2
    assert np.abs(Player(save_character(character, tmp_path / "out.glb")).vertices(0) - character.vertices).max() < 1e-6


@needs_validator
def test_turned_files_are_valid(thing, tmp_path):
    (tmp_path / "awkward.glb").write_bytes(awkward_glb())
    paths = []
    for name, character in (("thing", thing), ("awkward", load_character(tmp_path / "awkward.glb"))):
        for up, front in (("+z", "-y"), ("-y", "+x")):
            out = turned(character, up, front)
            paths.append(save_character(out, tmp_path / f"{name}{up}{front}.glb", made_up_handles(out)))
            paths.append(save_character(out, tmp_path / f"{name}{up}{front}bare.glb"))
    assert errors(paths) == {}


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
    character = turned(scaled(load_character(path, unit="m"), 0.01), "+z", "-y")
    player = Player(save_character(character, tmp_path / "out.glb", made_up_handles(character)))
    raw = player.accessor(player.tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"])
    assert sorted(np.ptp(raw, axis=0)) == pytest.approx([0.5, 0.8, 1.7])
    assert np.ptp(player.vertices(0), axis=0) == pytest.approx([0.8, 0.5, 1.7], abs=1e-5)
    again = load_character(path, unit="m")
    assert np.ptp(again.vertices, axis=0) == pytest.approx([80, 170, 50])
