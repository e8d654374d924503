"""Reading GLB: meshes, colours, rigs, and bind poses that are no rest poses."""

import base64
import json

import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, Maker, cube_glb, glb_bytes, png, textured_glb
from gltf_player import Player
from scipy.spatial.transform import Rotation

from bunraku.errors import CharacterError, FormatError
from bunraku.files import load_character, save, save_character
from bunraku.files.clips import load_animation


@pytest.fixture
def load(tmp_path):
    def load(data, name="thing.glb", **options):
        path = tmp_path / name
        path.write_bytes(data)
        return load_character(path, **options)

    return load


def test_a_cube_is_read_as_it_is(load):
    cube = load(cube_glb())
    assert cube.name == "thing" and cube.rig is None
    assert np.array_equal(cube.vertices, CUBE) and np.array_equal(cube.faces, CUBE_FACES)
    assert cube.colors.shape == (8, 3)


@pytest.mark.parametrize(
    "node",
    [
        {"translation": [1, 2, 3], "rotation": [0, 0.6, 0, 0.8], "scale": [1, 2, 3]},
        {"matrix": [0.28, 0, -0.96, 0, 0, 2, 0, 0, 2.88, 0, 0.84, 0, 1, 2, 3, 1]},
    ],
)
def test_a_node_places_its_mesh(load, node):
    cube = load(cube_glb(node))
    turn = np.array([[0.28, 0, 0.96], [0, 1, 0], [-0.96, 0, 0.28]])  # 2 asin 0.6 about +Y
    assert np.allclose(cube.vertices, (CUBE * [1, 2, 3]) @ turn.T + [1, 2, 3], atol=1e-6)


def test_a_mirroring_node_keeps_the_triangles_facing_outwards(load):
    cube = load(cube_glb({"scale": [-1, 1, 1]}))
    corners = cube.vertices[cube.faces].astype(float)
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    plain = CUBE[CUBE_FACES].astype(float)
    assert np.isclose(volume, np.einsum("ij,ij->i", plain[:, 0], np.cross(plain[:, 1], plain[:, 2])).sum() / 6)


def test_strips_and_fans_and_meshes_without_indices(load):
    grid = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0]], np.float32)
    for mode, expected in (
        (5, [[0, 1, 2], [1, 3, 2], [2, 3, 4]]),
        (6, [[1, 2, 0], [2, 3, 0], [3, 4, 0]]),
        (4, [[0, 1, 2]]),
    ):
        maker = Maker()
        data = maker.glb(
            nodes=[{"mesh": 0}], meshes=[{"primitives": [{"attributes": {"POSITION": maker.add(grid)}, "mode": mode}]}]
        )
        assert load(data).faces.tolist() == expected


def test_sparse_quantised_and_interleaved_accessors(load):
    maker = Maker()
    whole = np.round(CUBE * 100).astype(np.int16)
    rows = np.zeros((8, 8), np.int16)
    rows[:, :3] = whole
    rows[3, :3] = 0
    view = maker.view(rows.tobytes(), byteStride=16)
    sparse = {
        "count": 1,
        "indices": {"bufferView": maker.view(np.array([3], np.uint8).tobytes()), "componentType": 5121},
        "values": {"bufferView": maker.view(whole[3].tobytes())},
    }
    maker.accessors.append(
        {"bufferView": view, "componentType": 5122, "count": 8, "type": "VEC3", "normalized": True, "sparse": sparse}
    )
    attributes = {"POSITION": 0}
    data = maker.glb(
        nodes=[{"mesh": 0, "scale": [327.67] * 3}],
        meshes=[{"primitives": [maker.cube(np.uint32, attributes)]}],
        extensionsUsed=["KHR_mesh_quantization"],
        extensionsRequired=["KHR_mesh_quantization"],
    )
    assert np.allclose(load(data).vertices, CUBE, atol=1e-4)


def test_the_default_scene_is_the_character(load):
    maker = Maker()
    primitive = maker.cube()
    scenes = [{"nodes": [0]}, {"nodes": [1]}]
    cube = load(
        maker.glb(
            nodes=[{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}],
            meshes=[{"primitives": [primitive]}],
            scenes=scenes,
            scene=1,
        )
    )
    assert np.allclose(cube.vertices, CUBE + [5, 0, 0])


def test_skins_pose_their_meshes_and_the_rest_hangs_on_joints(load):
    thing = load(textured_glb(), rest="default")
    assert len(thing.vertices) == 24 and len(thing.faces) == 36
    assert thing.rig.names == ("hip", "spine") and thing.rig.parents.tolist() == [-1, 0]
    angle = 2 * np.arcsin(0.1736482)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    low = CUBE[:, 1] == 0
    assert np.allclose(thing.vertices[:8][low], CUBE[low] + [0, 0.2, 0], atol=1e-6)
    assert np.allclose(thing.vertices[:8][~low], (CUBE[~low] - [0, 1, 0]) @ turn.T + [0, 1.2, 0], atol=1e-6)
    assert np.allclose(thing.vertices[8:16], (0.3 * CUBE * [1, 2, 1] + [0, 1.5, 0]) @ turn.T + [0, 1.2, 0], atol=1e-6)
    assert np.allclose(thing.rig.dense_weights()[8:], [0, 1])
    assert np.allclose(thing.rig.dense_weights()[:8], np.c_[low, ~low])
    assert np.allclose(thing.rig.transforms[1][:3, :3], turn, atol=1e-6)


def test_broken_weights_are_mended(load):
    maker = Maker()
    weights = np.c_[np.full(8, 2.0), np.zeros((8, 3))].astype(np.float32)
    weights[0], weights[1] = np.nan, 0
    joints = np.zeros((8, 4), np.uint8)
    joints[:, 0] = CUBE[:, 1] > 0
    joints[2:4, 0] = 1
    joints[0] = 9  # a joint that does not exist, but without weight
    attributes = {"POSITION": maker.add(CUBE), "JOINTS_0": maker.add(joints), "WEIGHTS_0": maker.add(weights)}
    primitive = maker.cube(attributes=attributes)
    thing = load(
        maker.glb(
            nodes=[{"mesh": 0, "skin": 0, "children": [1, 2]}, {}, {}],
            meshes=[{"primitives": [primitive]}],
            skins=[{"joints": [1, 2]}],
        )
    )
    dense = thing.rig.dense_weights()
    assert np.allclose(dense.sum(axis=1), 1) and np.isfinite(dense).all()
    assert np.allclose(thing.vertices, CUBE)
    neighbours = [np.flatnonzero(np.linalg.norm(CUBE - CUBE[v], axis=1) == 2) for v in (0, 1)]
    for v, near in enumerate(neighbours):
        assert dense[v].tolist() in dense[near].tolist()


def bound(maker: Maker, rows, moved: bool = False) -> bytes:
    """Cubes on a joint each: 0 with 1 below it, and 2 apart from them, which a clip may move."""
    weights = np.eye(1, 4, dtype=np.float32).repeat(8, axis=0)
    primitives = [
        maker.cube(
            attributes={
                "POSITION": maker.add(points),
                "JOINTS_0": maker.add(np.full((8, 4), joint, np.uint8)),
                "WEIGHTS_0": maker.add(weights),
            }
        )
        for points, joint in rows
    ]
    times, path = maker.add(np.float32([[0], [1]]), bounds=True), maker.add(np.zeros((2, 3), np.float32))
    clip = {
        "channels": [{"sampler": 0, "target": {"node": 3 if moved else 1, "path": "translation"}}],
        "samplers": [{"input": times, "output": path}],
    }
    return maker.glb(
        nodes=[{"mesh": 0, "skin": 0}, {"children": [2]}, {}, {}],
        scenes=[{"nodes": [0, 1, 3]}],
        meshes=[{"primitives": primitives}],
        skins=[{"joints": [1, 2, 3]}],
        animations=[clip],
    )


@pytest.mark.parametrize("moved", [False, True])
def test_what_only_an_idle_joint_holds_goes_with_what_is_nearest(load, moved):
    """Blender binds vertices without weights to a joint of its own; one that a clip moves is a joint like others."""
    rows = [(CUBE, 1), (CUBE + np.float32([0, 6, 0]), 0), (0.1 * CUBE + np.float32([0, 4.5, 0]), 2)]
    thing = load(bound(Maker(), rows, moved))
    assert thing.rig.dense_weights()[-8:].tolist() == [[0, 0, 1] if moved else [1, 0, 0]] * 8


def test_a_belt_goes_with_the_trunk_though_a_hand_is_nearest_and_a_barrel_with_its_gun(load):
    hand, belt = 0.2 * CUBE + np.float32([1.6, 0, 1.3]), CUBE * np.float32([1.3, 0.1, 1.3])
    gun, barrel = CUBE * np.float32([0.1, 0.5, 0.1]) + [2, 0.5, 1.3], 0.02 * CUBE + [2, 1.3, 1.3]
    rows = [(CUBE, 0), (hand, 1), *((points.astype(np.float32), 2) for points in (belt, gun, barrel))]
    held = load(bound(Maker(), rows)).rig.dense_weights()[16:].argmax(axis=1).reshape(3, 8)
    assert held.tolist() == [[0] * 8, [1] * 8, [1] * 8]


def test_eight_influences(load):
    maker = Maker()
    quarter = np.full((8, 4), 32, np.uint8)
    quarter[:, 0] = 31
    attributes = {"POSITION": maker.add(CUBE)}
    for name, first in (("0", 0), ("1", 4)):
        attributes[f"JOINTS_{name}"] = maker.add(np.tile(np.arange(first, first + 4), (8, 1)).astype(np.uint16))
        attributes[f"WEIGHTS_{name}"] = maker.add(quarter, normalized=True)
    primitive = maker.cube(attributes=attributes)
    nodes = [{"mesh": 0, "skin": 0}, *({"translation": [k, 0, 0]} for k in range(8))]
    scenes = [{"nodes": list(range(9))}]
    thing = load(
        maker.glb(
            nodes=nodes, meshes=[{"primitives": [primitive]}], skins=[{"joints": list(range(1, 9))}], scenes=scenes
        )
    )
    assert thing.rig.weights.shape == (8, 8) and np.allclose(thing.rig.weights.sum(axis=1), 1)
    assert np.allclose(thing.vertices, CUBE + [3.5, 0, 0], atol=0.03)


def test_default_weights_of_morph_targets_count(load):
    maker = Maker()
    primitive = {
        "attributes": {"POSITION": maker.add(CUBE)},
        "targets": [{"POSITION": maker.add(np.ones_like(CUBE))}],
        "indices": maker.add(CUBE_FACES.reshape(-1).astype(np.uint8)),
    }
    assert np.allclose(
        load(maker.glb(nodes=[{"mesh": 0}], meshes=[{"primitives": [primitive], "weights": [0.5]}])).vertices,
        CUBE + 0.5,
    )
    assert np.allclose(load(maker.glb(nodes=[{"mesh": 0}], meshes=[{"primitives": [primitive]}])).vertices, CUBE)


def test_primitives_that_share_vertices_share_them_in_the_character(load):
    maker = Maker()
    position = maker.add(CUBE)
    halves = [
        {"attributes": {"POSITION": position}, "indices": maker.add(half.reshape(-1).astype(np.uint8)), "material": k}
        for k, half in enumerate(np.split(CUBE_FACES, 2))
    ]
    materials = [{"pbrMetallicRoughness": {"baseColorFactor": [k, 0, 0, 1]}} for k in range(2)]
    cube = load(maker.glb(nodes=[{"mesh": 0}], meshes=[{"primitives": halves}], materials=materials))
    assert len(cube.vertices) == 8 and np.array_equal(cube.faces, CUBE_FACES)


def test_colours_are_texture_times_factor_times_vertex_colour(load):
    maker = Maker()
    uv = np.array([[0.1, 0.5], [0.9, 0.5], [1.1, 0.5], [-0.1, 0.5]], np.float32)
    quad = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    attributes = {"POSITION": maker.add(quad), "TEXCOORD_0": maker.add(uv)}
    primitive = {"attributes": attributes, "indices": maker.add(np.array([0, 1, 2, 0, 2, 3], np.uint8)), "material": 0}
    shader = {"baseColorTexture": {"index": 0}}
    parts = {
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": shader}],
        "textures": [{"source": 0}],
        "images": [{"bufferView": maker.view(png((200, 100, 50))), "mimeType": "image/png"}],
    }
    shade, white = [200, 100, 50], [255] * 3
    assert load(maker.glb(**parts)).colors.tolist() == [shade, white, shade, white]
    parts["samplers"], parts["textures"] = [{"wrapS": 33071}], [{"source": 0, "sampler": 0}]
    assert load(maker.glb(**parts)).colors.tolist() == [shade, white, white, shade]
    shader["baseColorFactor"] = [0.5, 1, 0, 1]
    colors = load(maker.glb(**parts)).colors
    assert colors[1].tolist() == [188, 255, 0]  # sRGB of linear 0.5
    attributes["COLOR_0"] = maker.add(np.tile([255, 0, 0, 255], (4, 1)).astype(np.uint8), normalized=True)
    assert load(maker.glb(**parts)).colors[1].tolist() == [188, 0, 0]


def test_gltf_with_files_beside_it_and_inside_it(tmp_path):
    maker = Maker()
    primitive = maker.cube()
    tree = maker.tree(nodes=[{"mesh": 0}], meshes=[{"primitives": [primitive]}], images=[{"uri": "missing.png"}])
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "my cube.bin").write_bytes(maker.binary)
    path = tmp_path / "cube.gltf"
    for uri in (
        "data/my%20cube.bin",
        "data:application/octet-stream;base64," + base64.b64encode(maker.binary).decode(),
    ):
        tree["buffers"] = [{"byteLength": len(maker.binary), "uri": uri}]
        path.write_text(json.dumps(tree))
        assert np.array_equal(load_character(path).vertices, CUBE)


OUTSIDE = ["../secret.bin", "/etc/passwd", "https://example.org/a.bin", "file:///etc/passwd", "a/../../secret.bin"]


@pytest.mark.parametrize("uri", [*OUTSIDE, "..%2Fsecret.bin", "C:\\secret.bin", "link.bin", 7])
@pytest.mark.parametrize("kind", ["buffers", "images"])
def test_files_outside_the_folder_are_not_opened(tmp_path, uri, kind):
    (tmp_path / "secret.bin").write_bytes(bytes(1000))
    folder = tmp_path / "inner"
    folder.mkdir()
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    path = folder / "cube.gltf"
    path.write_text(json.dumps({"asset": {"version": "2.0"}, kind: [{"uri": uri, "byteLength": 4}]}))
    with pytest.raises(FormatError, match=r"cube\.gltf: its|address"):
        load_character(path)


def test_an_old_vrm_is_turned_to_the_front(load):
    maker = Maker()
    primitive = maker.cube()
    parts = {"nodes": [{"mesh": 0, "translation": [0, 0, 1]}], "meshes": [{"primitives": [primitive]}]}
    old = load(maker.glb(**parts, extensions={"VRM": {}}, extensionsUsed=["VRM"]), "a.vrm")
    new = load(maker.glb(**parts, extensions={"VRMC_vrm": {}}, extensionsUsed=["VRMC_vrm"]), "b.vrm")
    assert np.allclose(old.vertices, new.vertices * [-1, 1, -1])


def test_meshes_that_are_no_characters(load):
    maker = Maker()
    bad = CUBE.copy()
    bad[2, 1] = np.nan
    with pytest.raises(CharacterError, match=r"thing\.glb: 1 vertices have coordinates that are not numbers"):
        load(
            maker.glb(
                nodes=[{"mesh": 0}],
                meshes=[
                    {
                        "primitives": [
                            {
                                "attributes": {"POSITION": maker.add(bad)},
                                "indices": maker.add(np.arange(6, dtype=np.uint8)),
                            }
                        ]
                    }
                ],
            )
        )
    with pytest.raises(CharacterError, match=r"thing\.glb: these are points without faces"):
        load(cube_glb(mode=0))
    with pytest.raises(CharacterError, match=r"thing\.glb: the mesh is empty"):
        load(glb_bytes({"asset": {"version": "2.0"}}, b""))
    with pytest.raises(CharacterError, match="all vertices are at one point"):
        load(cube_glb({"scale": [0, 0, 0]}))
    with pytest.raises(CharacterError, match=r"coordinates reach 1e\+20 m"):
        load(cube_glb({"scale": [1e20, 1, 1]}))


def test_declared_sizes_are_not_believed(load):
    maker = Maker()
    for count in (2**31, 2**62, 40_000_000):
        maker.accessors[:] = [{"componentType": 5126, "count": count, "type": "VEC3"}]
        with pytest.raises(FormatError):
            load(maker.glb(nodes=[{"mesh": 0}], meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}]))
    maker = Maker()
    maker.accessors[:] = [{"componentType": 5126, "count": 1_000_000, "type": "VEC3"}]
    many = [{"mesh": 0} for _ in range(50)]
    with pytest.raises(FormatError, match="more than 20,000,000 vertices"):
        load(
            maker.glb(
                nodes=many,
                meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}],
                scenes=[{"nodes": list(range(50))}],
            )
        )


def test_loops_in_the_node_tree_are_found(load):
    for nodes in ([{"children": [1]}, {"children": [0]}], [{"children": [1, 1]}, {}], [{"children": [0]}]):
        with pytest.raises(FormatError, match="cycle|two parents"):
            load(glb_bytes({"asset": {"version": "2.0"}, "nodes": nodes}, b""))


ARM = np.concatenate([CUBE * [0.1, 0.5, 0.1], CUBE * [0.1, 0.5, 0.1] + [0, 1, 0]]).astype(
    np.float32
)  # two boxes of height 1
ARM_FACES = np.concatenate([CUBE_FACES, CUBE_FACES + 8])


def quaternion(axis, degrees):
    return Rotation.from_euler(axis, degrees, degrees=True).as_quat().tolist()


def matrix(translation=(0, 0, 0), axis="x", degrees=0.0, scale=1.0):
    out = np.eye(4)
    out[:3, :3] = scale * Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    out[:3, 3] = translation
    return out


def columns(matrices):
    return np.array([m.T.reshape(-1) for m in matrices], np.float32)


def arm_glb(space, *, second=None, bent=40.0, turned=0.0, tilted=0.0, raised=0.0, bones=(1.0, 1.0), clip=True):
    """An arm of two bones below an armature (scaled, turned, moved), bent in the default pose, with a box in its hand.

    `space` is the transform from the space of the inverse bind matrices to the world; `second` adds a mesh with a skin
    of its own whose matrices are those of the first times this, `turned` turns the upper bone about its length, and
    `tilted` all about its head; `raised` lifts its head.
    """
    maker = Maker()
    armature = matrix((1, 2, 3), "y", 90, 0.5)
    raw = ARM.copy()  # in the armature's space
    to_space = np.linalg.inv(space) @ armature
    raw = (ARM @ to_space[:3, :3].T + to_space[:3, 3]).astype(np.float32)
    joints = np.zeros((16, 4), np.uint8)
    joints[8:, 0] = 1
    weights = np.tile([1, 0, 0, 0], (16, 1)).astype(np.float32)
    binds = [np.linalg.inv(to_space @ matrix((0, y, 0))) for y in (0.0, bones[0])]
    primitive = {
        "attributes": {
            "POSITION": maker.add(raw, bounds=True),
            "JOINTS_0": maker.add(joints),
            "WEIGHTS_0": maker.add(weights),
        },
        "indices": maker.add(ARM_FACES.reshape(-1).astype(np.uint16)),
    }
    box = {
        "attributes": {"POSITION": maker.add((0.05 * CUBE).astype(np.float32), bounds=True)},
        "indices": maker.add(CUBE_FACES.reshape(-1).astype(np.uint16)),
    }
    nodes = [
        {
            "name": "armature",
            "translation": [1, 2, 3],
            "rotation": quaternion("y", 90),
            "scale": [0.5] * 3,
            "children": [1],
        },
        {
            "name": "upper",
            "children": [2],
            "translation": [0, raised, 0],
            "rotation": (
                Rotation.from_euler("z", bent + tilted, degrees=True) * Rotation.from_euler("y", turned, degrees=True)
            )
            .as_quat()
            .tolist(),
        },
        {"name": "lower", "children": [3], "translation": [0, bones[1], 0], "rotation": quaternion("x", bent)},
        {"name": "hold", "children": [4], "translation": [0, 1, 0]},
        {"name": "box", "mesh": 1},
        {"name": "arm", "mesh": 0, "skin": 0},
    ]
    skins = [{"joints": [1, 2], "inverseBindMatrices": maker.add(columns(binds))}]
    meshes = [{"primitives": [primitive]}, {"primitives": [box]}]
    if second is not None:
        moved = (raw @ np.linalg.inv(second)[:3, :3].T + np.linalg.inv(second)[:3, 3]).astype(np.float32)
        other = {
            "attributes": {**primitive["attributes"], "POSITION": maker.add(moved, bounds=True)},
            "indices": primitive["indices"],
        }
        skins.append({"joints": [2, 1], "inverseBindMatrices": maker.add(columns([b @ second for b in binds[::-1]]))})
        other["attributes"]["JOINTS_0"] = maker.add((1 - joints).astype(np.uint8))
        meshes.append({"primitives": [other]})
        nodes.append({"name": "sleeve", "mesh": 2, "skin": 1})
    parts = {}
    if clip:
        times = maker.add(np.array([0, 1], np.float32), bounds=True)
        turn = maker.add(np.array([quaternion("z", 10), quaternion("z", 100)], np.float32))
        parts["animations"] = [
            {
                "channels": [{"sampler": 0, "target": {"node": 2, "path": "rotation"}}],
                "samplers": [{"input": times, "output": turn, "interpolation": "LINEAR"}],
            }
        ]
    scenes = [{"nodes": [0, 5, *([6] if second is not None else [])]}]
    return maker.glb(nodes=nodes, meshes=meshes, skins=skins, scenes=scenes, **parts)


@pytest.fixture
def write(tmp_path):
    def write(data):
        path = tmp_path / "arm.glb"
        path.write_bytes(data)
        return path

    return write


ARMATURE = matrix((1, 2, 3), "y", 90, 0.5)
STRAIGHT = ARM @ ARMATURE[:3, :3].T + ARMATURE[:3, 3]


@pytest.mark.parametrize("space", [ARMATURE, np.eye(4)], ids=["of the armature", "of the world"])
def test_a_bent_arm_rests_straight_where_its_armature_stands(write, space):
    arm = load_character(write(arm_glb(space)))
    box, meshes = arm.vertices[:8], arm.vertices[8:]
    assert np.allclose(meshes, STRAIGHT, atol=1e-5)
    hand = 0.05 * CUBE + [0, 2, 0]
    assert np.allclose(box, hand @ ARMATURE[:3, :3].T + ARMATURE[:3, 3], atol=1e-5)
    assert np.allclose(
        arm.rig.positions, np.array([[0, 0, 0], [0, 1, 0]]) @ ARMATURE[:3, :3].T + ARMATURE[:3, 3], atol=1e-5
    )
    bent = load_character(write(arm_glb(space)), rest="default")
    assert np.allclose(bent.vertices, Player(write(arm_glb(space, clip=False))).vertices(0), atol=1e-5)
    assert np.abs(bent.vertices - arm.vertices).max() > 0.3


@pytest.mark.parametrize(("how", "axis"), [({"turned": -90}, "y"), ({"tilted": 90}, "x")])
def test_a_skeleton_rests_as_viewers_draw_it(write, how, axis):
    """It faces where the clip turned it, and stands where only its bind pose lies."""
    arm = load_character(write(arm_glb(ARMATURE, bent=0.0, **how)))
    about, turn = ARMATURE[:3, 3], matrix(axis=axis, degrees=next(iter(how.values())))[:3, :3]
    assert np.allclose(arm.vertices[8:], (STRAIGHT - about) @ turn.T + about, atol=1e-5)


def test_a_skeleton_rests_at_the_height_at_which_viewers_draw_it(write):
    """New clips stand on the ground of the file's own, where only the clips' keys of the root lift it."""
    arm = load_character(write(arm_glb(ARMATURE, raised=3.0)))
    assert np.allclose(arm.vertices[8:], STRAIGHT + [0, 1.5, 0], atol=1e-5)


@pytest.mark.parametrize(
    "data", [arm_glb(ARMATURE), arm_glb(np.eye(4), second=matrix((5, 0, 1), "z", 30, 2.0)), textured_glb()]
)
def test_clips_play_as_the_file_says(write, data):
    path = write(data)
    animation = load_animation(path, fps=4.0)
    player = Player(path)
    for frame, own in enumerate(animation.vertices()):
        assert np.allclose(own, player.vertices(frame / 4), atol=2e-5)


def test_what_is_written_stands_in_the_bind_pose(write, tmp_path):
    arm = load_character(write(arm_glb(ARMATURE)))
    again = load_character(save_character(arm, tmp_path / "out.glb"))
    assert np.allclose(again.vertices, arm.vertices, atol=1e-5) and np.array_equal(again.faces, arm.faces)
    animation = load_animation(write(arm_glb(ARMATURE)), fps=4.0)
    played = load_animation(save(animation, tmp_path / "played.glb", fps=4.0), fps=4.0)
    assert np.allclose(played.vertices(), animation.vertices(), atol=1e-4)


@pytest.mark.parametrize(
    "data",
    [arm_glb(ARMATURE, bones=(0.0, 1.0)), arm_glb(ARMATURE, bones=(9.0, 1.0))],
    ids=["all joints in one point", "bones nine times as long"],
)
def test_a_bind_pose_without_sense_is_not_taken(write, data):
    path = write(data)
    assert np.allclose(load_character(path).vertices, load_character(path, rest="default").vertices)
