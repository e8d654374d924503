"""FBX: read as Blender reads it, and files that are broken or mean harm."""

import base64
import gzip
import json
import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from fbx_files import HEAD, Scene, binary, node, text
from hostile import refused
from scipy.spatial.transform import Rotation

from bunraku import BunrakuError, Handles, load_character
from bunraku.files import save_character
from bunraku.files.clips import load_animation
from bunraku.files.fbx.nodes import Allowance, FbxArray, read_tree
from bunraku.files.fbx.scene import default_world, euler_matrices, read_scene

DATA = Path(__file__).parent / "data"
BOXMEN = ("boxman_z_up_cm", "boxman_y_up_m")
SQUARE = [[-1.0, 0, 0], [1, 0, 0], [1, 2, 0], [-1, 2, 0]]


def unpacked(name: str, folder: Path) -> Path:
    path = folder / f"{name}.fbx"
    path.write_bytes(gzip.decompress((DATA / f"{name}.fbx.gz").read_bytes()))
    return path


def from_blender(points: np.ndarray) -> np.ndarray:
    """+Z up, -Y forward as +Y up, +Z forward."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def saved(scene: Scene, folder: Path, **how) -> Path:
    path = folder / "made.fbx"
    path.write_bytes(binary(scene.nodes(), **how))
    return path


@pytest.fixture(scope="module")
def blender():
    return np.load(DATA / "boxman.npz")


@pytest.mark.parametrize("name", BOXMEN)
def test_the_bind_pose_is_where_blender_has_it(name, tmp_path, blender):
    character = load_character(unpacked(name, tmp_path))
    assert np.abs(character.vertices - from_blender(blender["rest"])).max() < 1e-6
    assert len(character.faces) == 180
    assert character.rig is not None and character.rig.names[0] == "mixamorig:Hips" and len(character.rig.names) == 15
    assert np.allclose(character.rig.weights.sum(axis=1), 1)
    shared = character.rig.weights.max(axis=1) < 0.9
    assert np.allclose(
        np.sort(character.rig.weights[shared])[:, -2:], [0.4, 0.6], atol=1e-6
    )  # as the script gives them


@pytest.mark.parametrize("name", BOXMEN)
def test_the_clip_moves_the_vertices_as_blender_does(name, tmp_path, blender):
    animation = load_animation(unpacked(name, tmp_path), "Wave", fps=24)
    frames = np.round(blender["times"] * 24).astype(int)
    assert len(animation.motion) == 13
    assert np.abs(animation.vertices(frames) - from_blender(blender["posed"])).max() < 3e-6


def test_materials_uvs_and_the_texture_inside_reach_the_document(tmp_path):
    character = load_character(unpacked(BOXMEN[0], tmp_path))
    document = character.source.document
    skin, cloth = document.items("materials")
    assert [skin["name"], cloth["name"]] == ["Skin", "Cloth"]
    assert np.allclose(skin["pbrMetallicRoughness"]["baseColorFactor"], [0.8, 0.5, 0.3, 1])
    assert "baseColorTexture" in cloth["pbrMetallicRoughness"] and len(document.items("images")) == 1
    assert character.colors[0].tolist() == [231, 188, 149]  # 0.8, 0.5, 0.3 of linear light
    primitive = document.items("meshes")[0]["primitives"][0]
    assert {"POSITION", "NORMAL", "TEXCOORD_0", "JOINTS_0", "WEIGHTS_0"} == set(primitive["attributes"])
    normals = document.accessor(primitive["attributes"]["NORMAL"], ("VEC3",))
    corners = character.vertices[character.source.index]
    faces = document.accessor(primitive["indices"], ("SCALAR",), raw=True).reshape(-1, 3).astype(int)
    flat = np.cross(corners[faces[:, 1]] - corners[faces[:, 0]], corners[faces[:, 2]] - corners[faces[:, 0]])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert np.abs(normals[faces[:, 0]] - flat).max() < 1e-3


def test_a_texture_beside_the_file_is_found_and_one_outside_is_not(tmp_path):
    inner = tmp_path / "inner"
    inner.mkdir()
    png = gzip.decompress((DATA / "boxman_z_up_cm.fbx.gz").read_bytes())
    start = png.index(b"\x89PNG")
    png = png[start : png.index(b"IEND", start) + 8]
    (tmp_path / "secret.png").write_bytes(png)
    scene = Scene()
    mesh = scene.model("Square", "Mesh")
    scene.mesh(mesh, SQUARE, [[0, 1, 2, 3]])
    texture = scene.add(
        "Texture", "T", "", node("FileName", "C:\\art\\..\\secret.png"), node("RelativeFilename", "..\\secret.png")
    )
    scene.link(texture, scene.add("Material", "M", "", below=mesh), "DiffuseColor")
    path = saved(scene, inner)
    assert not load_character(path).source.document.items("images")
    (inner / "made.fbm").mkdir()
    (inner / "made.fbm" / "secret.png").write_bytes(png)
    assert len(load_character(path).source.document.items("images")) == 1


def test_transforms_are_those_of_another_reader(tmp_path):
    path = unpacked("transforms", tmp_path)  # 14 models with every pivot, order, offset and inheritance
    scene = read_scene(read_tree(path, path.read_bytes()))
    expected = json.loads((DATA / "fbx_expected.json").read_text())["world"]
    for model, world in zip(scene.models, default_world(scene), strict=True):
        assert np.abs(world[:3] - expected[model.name]).max() < 2e-5, model.name


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YZX", "YXZ", "ZXY", "ZYX"])
def test_euler_angles(order):
    degrees = np.random.default_rng(1).uniform(-180, 180, (5, 3))
    expected = Rotation.from_euler(
        order.lower(), degrees[:, ["XYZ".index(axis) for axis in order]], degrees=True
    ).as_matrix()
    assert np.allclose(euler_matrices(degrees, order), expected)


def test_pre_rotation_counts_only_where_it_is_active(tmp_path):
    scene = Scene()
    for active in (0, 1):
        model = scene.model(f"m{active}", "Mesh", PreRotation=(0.0, 0.0, 90.0), RotationActive=active)
        scene.mesh(model, SQUARE, [[0, 1, 2, 3]])
    character = load_character(saved(scene, tmp_path))
    assert np.allclose(character.vertices[:4], np.array(SQUARE) / 100)
    assert np.allclose(character.vertices[4:, :2], np.array(SQUARE)[:, [1, 0]] * [-1, 1] / 100)


@pytest.mark.parametrize(("axes", "expected"), [
    ({}, [0.01, 0.02, 0.03]),
    ({"UpAxis": 2, "FrontAxis": 1, "FrontAxisSign": -1, "CoordAxis": 0, "UnitScaleFactor": 100.0}, [1, 3, -2]),
    ({"UpAxis": 2, "FrontAxis": 0, "CoordAxis": 1, "UnitScaleFactor": 2.54}, [0.0508, 0.0762, 0.0254]),
    ({"UpAxis": 0, "UpAxisSign": -1, "FrontAxis": 2, "CoordAxis": 1, "UnitScaleFactor": 100.0}, [2, -1, 3]),
    # nonsense counts as nothing said
    ({"UpAxis": 1, "FrontAxis": 1, "CoordAxis": 0, "UnitScaleFactor": -3.0}, [0.01, 0.02, 0.03]),
])  # fmt: skip
def test_axes_and_units(tmp_path, axes, expected):
    scene = Scene(**axes)
    scene.mesh(scene.model("m", "Mesh"), [[0, 0, 0], [1, 2, 3], [0, 1, 0]], [[0, 1, 2]])
    assert np.allclose(load_character(saved(scene, tmp_path)).vertices[1], expected)


def test_a_left_handed_file_is_mirrored_with_its_faces(tmp_path):
    scene = Scene(UpAxis=1, FrontAxis=2, CoordAxis=0, CoordAxisSign=-1, UnitScaleFactor=100.0)
    joint = scene.model("Root", Lcl_Translation=(1.0, 0.0, 0.0))
    mesh = scene.model("m", "Mesh")
    geometry = scene.mesh(mesh, [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    bind = np.eye(4)
    bind[0, 3] = 1
    scene.cluster(scene.skin(geometry), joint, [0, 1, 2], [1, 1, 1], np.linalg.inv(bind), bind)
    character = load_character(saved(scene, tmp_path))
    a, b, c = character.vertices[character.faces[0]]
    assert np.allclose(sorted(character.vertices[:, 0]), [-1, 0, 0])
    assert np.cross(b - a, c - a)[2] > 0  # it still looks at +Z
    assert np.allclose(character.rig.positions, [[-1, 0, 0]])


def test_geometric_transform_moves_the_mesh_and_not_its_children(tmp_path):
    scene = Scene(UnitScaleFactor=100.0)
    parent = scene.model(
        "p",
        "Mesh",
        GeometricTranslation=(0.0, 5.0, 0.0),
        GeometricScaling=(2.0, 2.0, 2.0),
        Lcl_Translation=(1.0, 0.0, 0.0),
    )
    scene.mesh(parent, SQUARE, [[0, 1, 2, 3]])
    scene.mesh(scene.model("c", "Mesh", below=parent), SQUARE, [[0, 1, 2, 3]])
    vertices = load_character(saved(scene, tmp_path)).vertices
    assert np.allclose(vertices[:4], np.array(SQUARE) * 2 + [1, 5, 0])
    assert np.allclose(vertices[4:], np.array(SQUARE) + [1, 0, 0])


@pytest.mark.parametrize("version", [7100, 7400, 7500, 7700])
@pytest.mark.parametrize("packed", [True, False])
def test_binary_versions(tmp_path, version, packed):
    scene = Scene()
    scene.mesh(scene.model("m", "Mesh"), SQUARE, [[0, 1, 2, 3]])
    character = load_character(saved(scene, tmp_path, version=version, packed=packed))
    assert len(character.vertices) == 4 and character.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_text_says_the_same_as_binary(tmp_path):
    path = unpacked("transforms", tmp_path)
    scene = Scene(UpAxis=2, FrontAxis=1, FrontAxisSign=-1, CoordAxis=0)
    mesh = scene.model('Body part "A"'.replace('"', "'"), "Mesh", Lcl_Rotation=(10.0, -20.5, 30.0))
    uvs = node(
        "LayerElementUV", 0,
        children=[
            node("MappingInformationType", "ByPolygonVertex"), node("ReferenceInformationType", "IndexToDirect"),
            node("UV", np.array([0, 0, 1, 0, 1, 1, 0, 1.0])), node("UVIndex", np.array([0, 1, 2, 3], np.int32)),
        ],
    )  # fmt: skip
    scene.mesh(mesh, SQUARE, [[0, 1, 2, 3]], uvs)
    path.write_bytes(text(scene.nodes()))
    written, read = load_character(saved(scene, tmp_path)), load_character(path)
    assert np.array_equal(written.vertices, read.vertices) and np.array_equal(written.faces, read.faces)
    nodes = [character.source.document.items("nodes") for character in (written, read)]
    assert nodes[0] == nodes[1]


def test_corners_with_other_uvs_are_split_and_vertices_keep_their_order(tmp_path):
    scene = Scene(UnitScaleFactor=100.0)
    uvs = node(
        "LayerElementUV", 0,
        children=[node("MappingInformationType", "ByPolygonVertex"), node("ReferenceInformationType", "Direct"),
                  node("UV", np.array([0, 0, 1, 0, 1, 1, 0.5, 0.5, 1, 1, 0, 1]))],
    )  # fmt: skip
    scene.mesh(scene.model("m", "Mesh"), [*SQUARE, [9, 9, 9]], [[0, 1, 2], [0, 2, 3]], uvs)
    character = load_character(saved(scene, tmp_path))
    assert np.allclose(character.vertices, [*SQUARE, [9, 9, 9]])
    assert character.source.index.tolist() == [0, 1, 2, 3, 4, 0]
    assert character.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_a_rigid_piece_on_a_bone_follows_it(tmp_path):
    scene = Scene(UnitScaleFactor=100.0)
    bone = scene.model("Hips", Lcl_Translation=(0.0, 1.0, 0.0))
    hand = scene.model("Hand", below=bone, Lcl_Translation=(1.0, 0.0, 0.0))
    scene.mesh(scene.model("body", "Mesh", below=bone), SQUARE, [[0, 1, 2, 3]])
    scene.mesh(scene.model("sword", "Mesh", below=hand), SQUARE, [[0, 1, 2, 3]])
    scene.track(scene.clip(), hand, "Lcl Rotation", Z=([0, 1], [0, 90]))
    path = saved(scene, tmp_path)
    rig = load_character(path).rig
    assert rig.names == ("Hips", "Hand") and rig.indices[:, 0].tolist() == [0] * 4 + [1] * 4
    end = load_animation(path, fps=10).vertices()[-1]
    assert np.allclose(end[:4], np.array(SQUARE) + [0, 1, 0], atol=1e-6)
    assert np.allclose(end[4:], np.array(SQUARE)[:, [1, 0, 2]] * [-1, 1, 1] + [1, 1, 0], atol=1e-6)


def test_what_is_written_as_glb_has_the_uvs_materials_and_texture(tmp_path):
    character = load_character(unpacked(BOXMEN[0], tmp_path))
    handles = Handles(np.array([[0, 1, 0], [0, 1.5, 0]], np.float32), np.tile([0.25, 0.75], (120, 1)))
    back = load_character(save_character(character, tmp_path / "out.glb", handles))
    document, before = back.source.document, character.source.document
    assert np.abs(back.vertices - character.vertices[character.source.index]).max() < 1e-6
    assert document.items("materials") == before.items("materials") and len(document.items("images")) == 1
    uvs = [
        some.accessor(some.items("meshes")[0]["primitives"][0]["attributes"]["TEXCOORD_0"], ("VEC2",))
        for some in (document, before)
    ]
    assert np.array_equal(*uvs)
    assert np.allclose(uvs[0][:4], [[0, 1], [0.5, 1], [0.5, 0], [0, 0]])  # v downwards; the first face of the script


def test_a_texture_in_lines_of_base64(tmp_path):
    whole = gzip.decompress((DATA / "boxman_z_up_cm.fbx.gz").read_bytes())
    start = whole.index(b"\x89PNG")
    code = base64.b64encode(whole[start : whole.index(b"IEND", start) + 8]).decode()
    scene = Scene()
    mesh = scene.model("ns::Square", "Mesh")
    scene.mesh(mesh, SQUARE, [[0, 1, 2, 3]])
    texture = scene.add("Texture", "T", "", node("RelativeFilename", "gone.png"))
    scene.add("Video", "V", "Clip", node("Content", code[:40], code[40:]), below=texture)
    scene.link(texture, scene.add("Material", "M", "", below=mesh), "DiffuseColor")
    (tmp_path / "made.fbx").write_bytes(text(scene.nodes()))
    document = load_character(tmp_path / "made.fbx").source.document
    assert len(document.items("images")) == 1 and document.items("nodes")[0]["name"] == "ns::Square"


def square(**settings) -> Scene:
    scene = Scene(**settings)
    scene.mesh(scene.model("m", "Mesh"), SQUARE, [[0, 1, 2, 3]])
    return scene


def test_other_versions_are_named(tmp_path):
    refused(tmp_path / "bad.fbx", HEAD + struct.pack("<I", 6100) + bytes(20), "FBX 6.1, which is not read")
    refused(tmp_path / "bad.fbx", HEAD + struct.pack("<I", 9000) + bytes(20), "FBX 9.0, which is not read")
    refused(
        tmp_path / "bad.fbx",
        b"; FBX 6.1.0 project file\nFBXHeaderExtension:  {\n\tFBXVersion: 6100\n}\n",
        "FBX 6.1, which is not read",
    )
    refused(tmp_path / "bad.fbx", b"; FBX project file\nHello: 1\n", "not an FBX file, or its header is missing")


def test_a_packed_bomb_is_refused_in_little_memory(tmp_path):
    scene = square()
    geometry = next(entry for entry in scene.objects if entry[0] == "Geometry")
    geometry[2][0] = node("Vertices", np.arange(3.0))
    data = binary(scene.nodes())
    real, bomb = zlib.compress(np.arange(3.0).tobytes()), zlib.compress(bytes(100_000_000))
    at = data.index(real)
    tracemalloc.start()
    # 100 MB where three numbers are said to be, in a node that ends where it did, and numbers that no so short an array
    # can hold
    swapped = bytearray(
        data[: at - 12] + struct.pack("<III", 3, 1, len(real)) + bomb[: len(real)] + data[at + len(real) :]
    )
    refused(tmp_path / "bad.fbx", bytes(swapped), "broken")
    swapped[at - 12 : at - 8] = struct.pack("<I", 134_000_000)
    refused(tmp_path / "bad.fbx", bytes(swapped), "longer than the file")
    array = FbxArray(Allowance(tmp_path), np.dtype("<f8"), 3, True, memoryview(bomb))
    assert array.numbers().tolist() == [0, 0, 0]  # no more is unpacked than was asked for
    assert tracemalloc.get_traced_memory()[1] < 30_000_000
    tracemalloc.stop()


def test_deep_nesting_and_loops(tmp_path):
    deep = node("Deep")
    for _ in range(200):
        deep = node("Deep", children=[deep])
    refused(tmp_path / "bad.fbx", binary([deep]), "nested more than 64 deep")
    refused(tmp_path / "bad.fbx", b"; FBX\nFBXVersion: 7400\n" + b"Deep: {\n" * 100_000, "nested more than 64 deep")
    scene = square()
    first = scene.model("a", "Null")
    scene.link(first, scene.model("b", "Null", below=first))
    scene.links = [link for link in scene.links if link[1][1:] != [first, 0]]
    refused(tmp_path / "bad.fbx", binary(scene.nodes()), "form a cycle")


def test_meshes_and_skins_that_point_nowhere(tmp_path):
    scene = Scene()
    scene.mesh(scene.model("m", "Mesh"), SQUARE, [[0, 1, 7]])
    refused(tmp_path / "bad.fbx", binary(scene.nodes()), "uses vertex 7 but there are 4")
    scene = square()
    scene.cluster(scene.skin(scene.next), scene.model("j"), [0, 99], [1, 1], np.eye(4), np.eye(4))
    refused(tmp_path / "bad.fbx", binary(scene.nodes()), "moves vertex 99 but there are 4")
    scene = Scene()
    scene.model("only", "Null")
    refused(tmp_path / "bad.fbx", binary(scene.nodes()), "holds no mesh")
    refused(tmp_path / "bad.fbx", binary([]), "holds no mesh")


def test_numbers_that_are_none_are_refused_or_passed_over(tmp_path):
    scene = Scene(UnitScaleFactor=float("nan"))
    scene.mesh(scene.model("m", "Mesh", Lcl_Translation=(float("inf"), 0.0, 0.0)), SQUARE, [[0, 1, 2, 3]])
    path = tmp_path / "nan.fbx"
    path.write_bytes(binary(scene.nodes()))
    assert np.allclose(load_character(path).vertices, np.array(SQUARE) / 100)
    scene.objects[-1] = (*scene.objects[-1][:2], [node("Vertices", np.full(12, np.nan)), *scene.objects[-1][2][1:]])
    path.write_bytes(binary(scene.nodes()))
    with pytest.raises(BunrakuError, match="not numbers"):
        load_character(path)
