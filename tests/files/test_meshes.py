"""OBJ, PLY and STL, and folders of meshes as moving meshes."""

import struct

import numpy as np
import pytest
import trimesh
from gltf_files import CUBE, CUBE_FACES, made_up_handles, made_up_motion, png
from gltf_player import Player

from bunraku.core import files
from bunraku.core.animation import Animation
from bunraku.core.character import Character
from bunraku.errors import BunrakuError, CharacterError, FormatError, OptionError
from bunraku.files import load_character, save_character

OBJ = """mtllib cube.mtl
o cube
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0.5 0.5 1 # the tip
v 9 9 9
vt 0.1 0.1
vt 0.9 0.1
vt 0.9 0.9
vt 0.1 0.9
vn 0 0 -2
vn 0 1 1
usemtl red
f 4/4/1 3/3/1 2/2/1 1/1/1
usemtl blue
f 1/1/2 2/2/2 5/3/2
f -5/2/2 3/3/2 \\
 5/4/2
f 3//2 4//2 5//2
"""
MTL = "newmtl red\nKd 1 1 1\nmap_Kd -s 1 1 1 C:\\work\\tex ture.png\nnewmtl blue\nKd 0 0 1\nd 0.5\n"


@pytest.fixture
def pyramid(tmp_path):
    (tmp_path / "cube.obj").write_text(OBJ)
    (tmp_path / "cube.mtl").write_text(MTL)
    (tmp_path / "tex ture.png").write_bytes(png((10, 200, 30)))
    return tmp_path / "cube.obj"


def test_obj_keeps_its_vertices_and_fans_its_polygons(pyramid):
    character = load_character(pyramid)
    assert character.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 1], [9, 9, 9]]
    assert character.faces.tolist() == [[3, 2, 1], [3, 1, 0], [0, 1, 4], [1, 2, 4], [2, 3, 4]]
    assert character.colors[0].tolist() == [10, 200, 30] and character.colors[1].tolist() == [255] * 3
    assert character.colors[4].tolist() == [0, 0, 255]


def test_obj_seams_are_appended_and_follow_their_vertex(pyramid, tmp_path):
    character = load_character(pyramid)
    handles = made_up_handles(character, 6)
    player = Player(save_character(character, tmp_path / "out.glb", handles))
    index = character.source.index
    assert index[:6].tolist() == list(range(6)) and len(index) == 13
    assert np.allclose(player.vertices(0), character.vertices[index], atol=1e-6)
    red, blue = player.tree["meshes"][0]["primitives"]
    assert red["attributes"] == blue["attributes"]
    uv = player.accessor(red["attributes"]["TEXCOORD_0"])
    corners = player.accessor(red["indices"])[:, 0]
    assert np.allclose(uv[corners], [[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.1], [0.9, 0.9], [0.1, 0.9]])
    normals = player.accessor(red["attributes"]["NORMAL"])
    assert np.allclose(normals[corners], [0, 0, -1]) and np.allclose(np.linalg.norm(normals, axis=1), 1)
    corners = player.accessor(blue["indices"])[:, 0]
    assert index[corners].tolist() == [0, 1, 4, 1, 2, 4, 2, 3, 4]
    assert np.allclose(uv[corners[:6]], [[0.1, 0.9], [0.9, 0.9], [0.9, 0.1], [0.9, 0.9], [0.9, 0.1], [0.1, 0.1]])
    weights = player.accessor(red["attributes"]["WEIGHTS_0"])
    assert np.array_equal(weights[6:], weights[index[6:]])
    names = [material["name"] for material in player.tree["materials"]]
    assert names == ["red", "blue"] and player.tree["materials"][1]["pbrMetallicRoughness"]["baseColorFactor"] == [
        0,
        0,
        1,
        0.5,
    ]
    view = player.tree["bufferViews"][player.tree["images"][0]["bufferView"]]
    assert player.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]] == png((10, 200, 30))


def test_obj_without_its_materials_is_still_a_mesh(pyramid):
    (pyramid.parent / "cube.mtl").write_text("newmtl red\nmap_Kd " + "x" * 5000 + ".png\n")
    assert len(load_character(pyramid).faces) == 5
    (pyramid.parent / "cube.mtl").write_text(MTL.replace("C:\\work\\", "../../"))
    assert len(load_character(pyramid).faces) == 5
    (pyramid.parent / "cube.mtl").unlink()
    assert len(load_character(pyramid).faces) == 5


@pytest.mark.parametrize(
    "text",
    [
        "v 0 0\nf 1 1 1\n", "v a b c\n", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "v 0 0 0\nf 1 2 x\n",
        "v 0 0 0\nf 0 0 0\n", "v 0 0 0\nf -2 -1 -1\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1 2/1 3/1\n", "v 0 0 0\nf 99999999999999999999999 1 1\n",
        "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "hello\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "\0\0\0\n",
    ],
)  # fmt: skip
def test_broken_obj_files(tmp_path, text):
    path = tmp_path / "broken.obj"
    path.write_text(text)
    with pytest.raises(BunrakuError, match=r"broken\.obj: "):
        load_character(path)


@pytest.mark.parametrize("kind", ["ascii", "binary"])
def test_ply_as_trimesh_writes_it(tmp_path, kind):
    shades = np.random.default_rng(0).integers(0, 256, (8, 4)).astype(np.uint8)
    mesh = trimesh.Trimesh(CUBE, CUBE_FACES, process=False, vertex_colors=shades)
    mesh.export(tmp_path / "cube.ply", encoding=kind)
    character = load_character(tmp_path / "cube.ply")
    assert np.array_equal(character.vertices, CUBE) and np.array_equal(character.faces, CUBE_FACES)
    assert np.array_equal(character.colors, shades[:, :3])
    again = load_character(save_character(character, tmp_path / "out.glb"))
    assert np.array_equal(again.vertices, CUBE) and np.array_equal(again.colors, character.colors)


def ply(order, faces):
    """A binary PLY with polygons of any size, doubles, an element before the vertices and one after the faces."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1]])
    head = (
        f"ply\nformat binary_{'little' if order == '<' else 'big'}_endian 1.0\nelement camera 1\nproperty "
        f"float f\nelement vertex 5\n"
    )
    head += "property double x\nproperty double y\nproperty double z\nproperty uchar quality\n"
    head += (
        f"element face {len(faces)}\nproperty uchar flag\nproperty list uchar int vertex_indices\nproperty "
        f"list uchar float texcoord\n"
    )
    head += "element edge 1\nproperty int a\nproperty int b\nend_header\n"
    body = struct.pack(order + "f", 2.5) + b"".join(struct.pack(order + "dddB", *point, 7) for point in points)
    for face in faces:
        body += struct.pack(
            f"{order}BB{len(face)}iB{2 * len(face)}f", 1, len(face), *face, 2 * len(face), *[0.5] * 2 * len(face)
        )
    return head.encode() + body + struct.pack(order + "ii", 0, 1)


@pytest.mark.parametrize("order", ["<", ">"])
def test_ply_with_all_that_it_may_have(tmp_path, order):
    path = tmp_path / "odd.ply"
    for faces, triangles in (
        ([[0, 1, 2, 3], [0, 1, 4]], [[0, 1, 2], [0, 2, 3], [0, 1, 4]]),
        ([[0, 1, 2], [2, 3, 4]], [[0, 1, 2], [2, 3, 4]]),
    ):
        path.write_bytes(ply(order, faces))
        character = load_character(path)
        assert character.vertices[2].tolist() == [1, 1, 0] and character.faces.tolist() == triangles


def test_ply_points_and_broken_ones(tmp_path):
    path = tmp_path / "cloud.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 "
        "0 0\n1 1 1\n"
    )
    with pytest.raises(CharacterError, match=r"cloud\.ply: these are points without faces"):
        load_character(path)
    good = ply("<", [[0, 1, 2], [2, 3, 4]])
    swaps = (
        "vertex 5=vertex 4000000000",
        "face 2=face 99999999",
        "property double x=property quad x",
        "end_header=",
        "y_little=y_middle",
        "vertex 5=vertex -5",
    )
    for bad in (*(good.replace(*swap.encode().split(b"=")) for swap in swaps), ply("<", [[0, 1, 9]])):
        path.write_bytes(bad)
        with pytest.raises(FormatError, match=r"cloud\.ply: "):
            load_character(path)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_stl_is_welded(tmp_path, kind):
    path = tmp_path / "cube.stl"
    trimesh.Trimesh(CUBE, CUBE_FACES, process=False).export(path, file_type=kind)
    character = load_character(path)
    assert len(character.vertices) == 8 and character.faces.max() == 7
    assert np.array_equal(character.vertices[character.faces], CUBE[CUBE_FACES])  # the same triangles in the same order
    first = [vertex for n, vertex in enumerate(character.faces.ravel()) if vertex not in character.faces.ravel()[:n]]
    assert first == list(range(8))  # numbered as they come


def test_stl_drops_triangles_without_a_surface_and_joins_both_zeros(tmp_path):
    triangles = np.array(
        [
            [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
            [[1, 0, 0], [1, 0, 0], [0, 1, 0]],
            [[2, 2, 2], [2, 2, 2], [2, 2, 2]],
            [[1, 0, -0.0], [1, 1, 0], [-0.0, 1, 0]],
        ],
        "<f4",
    )
    records = b"".join(np.zeros(3, "<f4").tobytes() + t.tobytes() + b"\0\0" for t in triangles)
    path = tmp_path / "odd.stl"
    path.write_bytes(bytes(80) + (4).to_bytes(4, "little") + records)
    character = load_character(path)
    assert character.faces.tolist() == [[0, 1, 2], [1, 3, 2]] and len(character.vertices) == 4
    assert np.array_equal(character.vertices[character.faces], triangles[[0, 3]])


def test_broken_stl_files(tmp_path):
    path = tmp_path / "cube.stl"
    trimesh.Trimesh(CUBE, CUBE_FACES, process=False).export(path)
    good = path.read_bytes()
    text = trimesh.Trimesh(CUBE, CUBE_FACES, process=False).export(file_type="stl_ascii").encode()
    for bad in (
        good[:-10],
        good[:50],
        good[:80] + b"\xff" * 4 + good[84:],
        text[: len(text) // 2],
        b"solid nothing\nendsolid\n",
        text.replace(b"vertex", b"vertex x", 1),
    ):
        path.write_bytes(bad)
        with pytest.raises(BunrakuError, match=r"cube\.stl: "):
            load_character(path)


@pytest.mark.parametrize(("name", "text"), [("big.obj", "v 0 0 0\n"), ("big.stl", "solid x\nfacet normal 0 0 1\n")])
def test_text_that_would_not_fit_in_memory_is_refused(tmp_path, name, text, monkeypatch):
    monkeypatch.setattr(files, "MAX_TEXT_BYTES", 1000)
    path = tmp_path / name
    path.write_text(text + "# more\n" * 400)
    with pytest.raises(FormatError, match="of text are too many"):
        load_character(path)


def test_a_binary_stl_whose_header_says_solid_and_that_has_a_tail(tmp_path):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
    record = np.zeros(3, "<f4").tobytes() + corners.tobytes() + b"\0\0"
    path = tmp_path / "tail.stl"
    path.write_bytes(b"solid made by a tool".ljust(80) + (1).to_bytes(4, "little") + record + b"trailing")
    np.testing.assert_array_equal(load_character(path).vertices, corners)


@pytest.fixture
def animation():
    cube = Character("cube", CUBE, CUBE_FACES, colors=np.arange(24).reshape(8, 3))
    return Animation(cube, made_up_handles(cube), made_up_motion(cube, frames=21))


@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_each_frame_is_a_mesh(animation, tmp_path, suffix):
    folder = animation.save(tmp_path / f"dance.{suffix}")
    assert folder == tmp_path / "dance"
    files = sorted(folder.iterdir())
    assert [file.name for file in files[::20]] == [f"dance_0000.{suffix}", f"dance_0020.{suffix}"] and len(files) == 21
    expected = animation.vertices()
    for frame in (0, 7, 20):
        mesh = trimesh.load(files[frame], process=False)
        assert np.allclose(mesh.vertices, expected[frame], atol=1e-6) and np.array_equal(mesh.faces, CUBE_FACES)
    if suffix == "ply":
        assert np.array_equal(mesh.visual.vertex_colors[:, :3], animation.character.colors)


def test_another_frame_rate_and_an_earlier_sequence(animation, tmp_path):
    assert len(list(animation.save(tmp_path / "dance.ply").iterdir())) == 21
    assert len(list(animation.save(tmp_path / "dance.ply", fps=10).iterdir())) == 11
    (tmp_path / "dance" / "thesis.txt").write_text("precious")
    with pytest.raises(FormatError, match="holds other files"):
        animation.save(tmp_path / "dance.ply")
    assert (tmp_path / "dance" / "thesis.txt").exists() and [entry.name for entry in tmp_path.iterdir()] == ["dance"]


def test_axis_and_unit(animation, tmp_path):
    folder = animation.save(tmp_path / "dance.obj", up="+z", unit="cm")
    mesh = trimesh.load(folder / "dance_0007.obj", process=False)
    x, y, z = animation.vertices()[7].T
    assert np.allclose(mesh.vertices, 100 * np.stack([x, -z, y], axis=1), atol=1e-4)
    for options in ({"up": "+x"}, {"unit": "league"}):
        with pytest.raises(OptionError):
            animation.save(tmp_path / "dance.ply", **options)
