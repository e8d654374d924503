"""FBX by the own writer: read again by the own reader, which shares nothing with it, and by Blender and three.js where
they are there.
"""

import io
import json
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, Maker, glb_bytes, made_up_handles, made_up_motion
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[2] / "tools" / "check_viewers"))
from check import waving
from check_fbx import TIMES, clips_on_handles, clips_on_rig, gaps
from fbx_viewers import READERS

from bunraku.core.animation import Animation, PointAnimation, RigAnimation
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character, Rig
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.errors import OptionError
from bunraku.files import load_character
from bunraku.files.clips import load_animation
from bunraku.files.fbx.nodes import read_tree
from bunraku.files.fbx.write_motion import euler_degrees
from bunraku.files.fbx.write_objects import element, write_elements
from bunraku.files.presets import save_clips
from bunraku.files.registry import save_character
from bunraku.pipelines.animate import with_skeleton


@pytest.fixture
def animation():
    cube = Character("cube", CUBE, CUBE_FACES)
    return Animation(cube, made_up_handles(cube), made_up_motion(cube, frames=11))


@pytest.fixture(scope="module")
def person():
    """The reference body, turned and moved as its joints stand in a file."""
    return reference_body().character()


@pytest.mark.parametrize("options", [{}, {"up": "+z", "unit": "m", "name": "wave", "fps": 40}, {"unit": "in"}])
def test_handles_come_back(animation, tmp_path, options):
    path = animation.save(tmp_path / "dance.fbx", **options)
    read = load_animation(path, options.get("name", "dance"), options.get("fps", 20))
    want = Animation(animation.character, animation.handles.top(4), animation.motion).vertices()
    got = read.vertices()[:: 2 if "fps" in options else 1]
    assert len(got) == 11 and load_character(path).height == pytest.approx(2, rel=1e-6)
    nearest = np.linalg.norm(want[:, :, None] - got[:, None], axis=-1).min(axis=2)  # the reader splits edges
    assert nearest.max() < 1e-5 * animation.character.height
    assert [entry.name for entry in tmp_path.iterdir()] == ["dance.fbx"]


def test_a_rig_comes_back_with_its_tree_and_weights(person, tmp_path):
    moved = clips_on_rig(person)["Attack"]
    path = moved.save(tmp_path / "person.fbx")
    read = load_character(path)
    assert read.rig.names == person.rig.names
    assert np.array_equal(read.rig.parents, person.rig.parents)
    assert np.abs(read.rig.transforms - person.rig.transforms).max() < 1e-6
    assert np.abs(read.rig.dense_weights() - person.rig.dense_weights()).max() < 1e-6
    assert np.abs(load_animation(path, 0, moved.fps).vertices() - moved.vertices()).max() < 2e-5


def test_bones_that_are_turned_and_scaled_in_their_file(person, tmp_path):
    """The axes of the file's bones stay, their scale goes."""
    turns = matrix_from_axis_angle(np.random.default_rng(2).normal(size=(len(person.rig.names), 3)))
    transforms = person.rig.transforms.copy()
    transforms[:, :3, :3] = turns * 100
    rig = Rig(person.rig.names, person.rig.parents, transforms, person.rig.indices, person.rig.weights)
    moved = clips_on_rig(Character("turned", person.vertices, person.faces, rig))["walk"]
    path = moved.save(tmp_path / "turned.fbx")
    assert np.abs(load_character(path).rig.transforms[:, :3, :3] - turns).max() < 1e-6
    assert np.abs(load_animation(path, 0, moved.fps).vertices() - moved.vertices()).max() < 2e-5


def test_several_clips(person, tmp_path):
    clips = clips_on_rig(person)
    path = save_clips(clips, tmp_path / "clips.fbx")
    for name, clip in clips.items():
        assert np.abs(load_animation(path, name, 30).vertices() - clip.vertices()).max() < 2e-5
    with pytest.raises(OptionError, match="write all clips at once"):
        save_clips(clips, path, add=True)
    with pytest.raises(OptionError, match="no option up"):
        save_clips(clips, tmp_path / "clips.glb", up="+z")


@pytest.mark.parametrize("shapes", ["bones", "mixed"])
def test_vertices_that_move_on_their_own(person, tmp_path, shapes):
    still = RigAnimation(person, np.tile(np.eye(3), (8, 22, 1, 1)), np.zeros((8, 22, 3)))
    moved = waving(still.animation())
    path = moved.save(tmp_path / "wave.fbx", shapes=shapes, tolerance=2e-3)
    tree = read_tree(path, path.read_bytes())
    kinds = [node.values[2] for node in tree.root.child("Objects").children]
    assert ("Shape" in kinds) == (shapes == "mixed")
    if shapes == "bones":
        assert np.linalg.norm(load_animation(path, 0, 20).vertices() - moved.vertices(), axis=-1).max() < 2e-3


def test_what_bones_cannot_say_becomes_shapes(person, tmp_path):
    still = RigAnimation(person, np.tile(np.eye(3), (8, 22, 1, 1)), np.zeros((8, 22, 3))).animation()
    noise = np.random.default_rng(0).normal(0, 0.05, (8, len(person.vertices), 3))
    path = PointAnimation(still, noise).save(tmp_path / "noise.fbx", tolerance=1e-5)
    tree = read_tree(path, path.read_bytes())
    assert "Shape" in [node.values[2] for node in tree.root.child("Objects").children]


def test_a_character_without_motion(person, tmp_path):
    plain = load_character(save_character(person, tmp_path / "plain.fbx"))
    assert plain.rig is None and np.abs(plain.vertices - person.vertices).max() < 1e-6
    rigged = load_character(save_character(person, tmp_path / "rigged.fbx", rig=True))
    assert rigged.rig.names == person.rig.names


def test_names_that_no_text_can_hold_are_repaired_where_they_are_read(person, tmp_path):
    path = save_character(person, tmp_path / "person.glb", rig=True)
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    tree = json.loads(data[20 : 20 + size])
    tree["nodes"][tree["skins"][0]["joints"][0]]["name"] = "bone\ud800"
    path.write_bytes(glb_bytes(tree, data[28 + size :]))
    written = save_character(load_character(path), tmp_path / "person.fbx", rig=True)
    assert load_character(written).rig.names[0] == "bone\ufffd"


def test_engine_skeletons(tmp_path):
    from bunraku.files.samples import sample_character

    mixamo = with_skeleton(sample_character("person"), "mixamo")
    read = load_character(save_character(mixamo, tmp_path / "mixamo.fbx", rig=True))
    assert read.rig.names == mixamo.rig.names and "mixamorig:Hips" in read.rig.names


def textured(path):
    """A GLB of two quads: one with a red texture and UVs, one of a colour that can be seen through, and a smile."""
    maker, image = Maker(), io.BytesIO()
    Image.new("RGB", (2, 2), (255, 0, 0)).save(image, "PNG")
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    position, triangles = maker.add(square, bounds=True), maker.add(np.array([0, 1, 2, 0, 2, 3], np.uint16))
    uv = maker.add(np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32))
    smile = maker.add(np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0.5], [0, 0, 0]], np.float32), bounds=True)
    other = maker.add(square + np.array([0, 0, 1], np.float32), bounds=True)
    primitives = [
        {"attributes": {"POSITION": position, "TEXCOORD_0": uv}, "indices": triangles, "material": 0,
         "targets": [{"POSITION": smile}]},
        {"attributes": {"POSITION": other}, "indices": triangles, "material": 1, "targets": [{"POSITION": smile}]},
    ]  # fmt: skip
    view = maker.view(image.getvalue())
    path.write_bytes(maker.glb(
        nodes=[{"mesh": 0, "name": "quads"}], scenes=[{"nodes": [0]}],
        meshes=[{"primitives": primitives, "extras": {"targetNames": ["smile"]}}],
        images=[{"bufferView": view, "mimeType": "image/png"}], textures=[{"source": 0}],
        materials=[
            {"name": "red", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}},
            {"name": "glass", "alphaMode": "BLEND", "pbrMetallicRoughness": {"baseColorFactor": [0.2, 0.4, 0.6, 0.5]}},
        ],
    ))  # fmt: skip
    return path


def test_materials_textures_and_shapes(tmp_path):
    character = load_character(textured(tmp_path / "quads.glb"))
    path = save_character(character, tmp_path / "quads.fbx")
    read = load_character(path).source.document
    red, glass = read.items("materials")
    assert (red["name"], glass["name"]) == ("red", "glass")
    assert glass["pbrMetallicRoughness"]["baseColorFactor"] == pytest.approx([0.2, 0.4, 0.6, 0.5])
    image = read.items("images")[read.items("textures")[0]["source"]]
    assert Image.open(io.BytesIO(read.view(image["bufferView"]))).getpixel((0, 0)) == (255, 0, 0)
    primitive = next(one for one in read.items("meshes")[0]["primitives"] if one["material"] == 0)
    corners = read.accessor(primitive["attributes"]["POSITION"], ("VEC3",))
    uv = read.accessor(primitive["attributes"]["TEXCOORD_0"], ("VEC2",))
    front = np.abs(corners[:, 2]) < 1e-6
    assert np.abs(uv[front] - np.stack([corners[front, 0], 1 - corners[front, 1]], axis=1)).max() < 1e-6
    objects = read_tree(path, path.read_bytes()).root.child("Objects").children
    shape = next(node for node in objects if node.values[2] == "Shape")
    assert shape.values[1].startswith("smile\x00")
    assert shape.child("Indexes").values[0].numbers().tolist() == [2, 6]
    assert np.allclose(shape.child("Vertices").values[0].numbers(), [0, 0, 50, 0, 0, 50])  # centimetres


def test_the_file_ends_as_autodesk_asks():
    """Each element names where it ends, and the footer stands on a multiple of 16."""
    out = io.BytesIO()
    write_elements(out, [element("A", 1, "text", children=[element("B", np.arange(100.0))]), element("C")])
    data = out.getvalue()
    assert data[:23] == b"Kaydara FBX Binary  \x00\x1a\x00" and data[-16:].hex() == "f85a8c6adef5d97eece90ce3758f290b"
    assert (len(data) - 16 - 120 - 4) % 16 == 0
    tree = read_tree(Path("a.fbx"), data)
    assert [node.name for node in tree.root.children] == ["A", "C"]
    assert np.array_equal(tree.root.children[0].children[0].values[0].numbers(), np.arange(100.0))


def test_angles_say_the_rotations_and_do_not_jump():
    rng = np.random.default_rng(1)
    turns = matrix_from_axis_angle(np.linspace(0, 9, 400)[:, None, None] * rng.normal(size=(5, 3)))
    turns = np.concatenate([turns, matrix_from_axis_angle(np.linspace(0, 3, 400)[:, None] * [0, 1.0, 0])[:, None]], 1)
    degrees = np.radians(euler_degrees(turns))
    x, y, z = (matrix_from_axis_angle(degrees[..., k, None] * np.eye(3)[k]) for k in range(3))
    assert np.abs(z @ y @ x - turns).max() < 1e-7
    level = euler_degrees(turns[:, 5:])  # straight through the pole
    assert np.abs(np.diff(level[:, 0, 1], axis=0)).max() < 1 and np.ptp(level[:, 0, ::2]) < 1e-3


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("moved", ["rig", "handles"])
def test_other_programs_read_it_alike(person, tmp_path, reader, moved):
    shows, missing = READERS[reader]
    if missing():
        pytest.skip(missing())
    from bunraku.retarget.to_reference import handle_animation

    clips = clips_on_rig(person)
    if moved == "handles":
        clips = clips_on_handles(person, handle_animation(clips["idle"]).handles)
    for options in ({}, {"up": "+z", "unit": "m"}):
        shown = shows(save_clips(clips, tmp_path / "clips.fbx", **options), TIMES)
        assert max(gaps(shown, clips, reader == "three.js").values()) < 1e-4
