"""Springs and colliders of VRM 0.x and 1.0, written by hand, good and broken."""

import numpy as np
import pytest
from gltf_files import Maker

from bunraku.apparel.mask import apparel_mask, moved_joints
from bunraku.core.avatars import vrm_model
from bunraku.errors import FormatError
from bunraku.files import load_character

# 0 hips, 1 head, 2 to 4 hair, 5 a branch of it, 6 the mesh
NODES = [
    {"name": "hips", "children": [1]},
    {"name": "head", "translation": [0, 1, 0], "children": [2]},
    {"name": "hair", "translation": [0, 0.2, 0], "children": [3]},
    {"name": "hair2", "translation": [0, 0.2, 0], "children": [4, 5]},
    {"name": "tip", "translation": [0, 0.2, 0]},
    {"name": "branch", "translation": [0.1, 0.1, 0]},
    {"name": "mesh", "mesh": 0, "skin": 0},
]
SPHERE = {"node": 1, "colliders": [{"offset": {"x": 1, "y": 2, "z": 3}, "radius": 0.5}]}


def vrm(extensions):
    """A triangle on the hips and one on the tip of the hair."""
    maker = Maker()
    points = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 1.6, 0], [0.1, 1.6, 0], [0, 1.7, 0]], "<f4")
    joints = np.array([[0, 0, 0, 0]] * 3 + [[4, 1, 0, 0]] * 3, "u1")
    weights = np.array([[1, 0, 0, 0]] * 3 + [[0.6, 0.4, 0, 0]] * 3, "<f4")
    heights = np.array([0, 1, 1.2, 1.4, 1.6, 1.5])
    inverse = np.tile(np.eye(4, dtype="<f4"), (6, 1, 1))
    inverse[:, 1, 3] = -heights
    inverse[5, 0, 3] = -0.1
    attributes = {"POSITION": maker.add(points, True), "JOINTS_0": maker.add(joints), "WEIGHTS_0": maker.add(weights)}
    skin = {"joints": list(range(6)), "inverseBindMatrices": maker.add(inverse.transpose(0, 2, 1).reshape(-1, 16))}
    mesh = {"primitives": [{"attributes": attributes}]}
    return maker.glb(
        nodes=NODES, scenes=[{"nodes": [0, 6]}], scene=0, meshes=[mesh], skins=[skin], extensions=extensions
    )


def load(folder, extensions):
    (folder / "doll.vrm").write_bytes(vrm(extensions))
    character = load_character(folder / "doll.vrm")
    return character, vrm_model(character)


def old(group=None, colliders=(SPHERE,), bones=({"bone": "hips", "node": 0}, {"bone": "head", "node": 1})):
    own = {"comment": "ほげ", "stiffiness": 2.5, "gravityPower": 0.1, "gravityDir": {"x": 0.6, "y": -0.8, "z": 0},
    "dragForce": 0.3,
           "hitRadius": 0.04, "center": -1, "bones": [2], "colliderGroups": [0]}  # fmt: skip
    swings = {"boneGroups": [own | (group or {})], "colliderGroups": list(colliders)}
    return {"VRM": {"meta": {"title": "Doll"}, "humanoid": {"humanBones": list(bones)}, "secondaryAnimation": swings}}


def new(springs=None, colliders=None, groups=({"name": "g", "colliders": [0, 1]},)):
    shapes = [
        {"node": 1, "shape": {"sphere": {"offset": [1, 2, 3], "radius": 0.5}}},
        {"node": 0, "shape": {"capsule": {"offset": [0, 0, 0], "radius": 0.1, "tail": [0, 1, 0]}}},
    ]
    spring = {
        "name": "hair",
        "colliderGroups": [0],
        "joints": [{"node": 2, "stiffness": 3, "hitRadius": 0.02}, {"node": 3}, {"node": 4}],
    }
    swings = {"colliders": colliders or shapes, "colliderGroups": list(groups), "springs": springs or [spring]}
    person = {"meta": {"name": "Doll"}, "humanoid": {"humanBones": {"hips": {"node": 0}, "head": {"node": 1}}}}
    return {"VRMC_vrm": person, "VRMC_springBone": swings}


def test_vrm_0(tmp_path):
    character, model = load(tmp_path, old())
    assert (model.version, model.title, model.humanoid, model.warnings) == ("0.x", "Doll", {"hips": 0, "head": 1}, ())
    assert [[joint.node for joint in spring.joints] for spring in model.springs] == [
        [2, 3, 4],
        [5],
    ]  # a branch is a chain of its own
    spring = model.springs[0]
    assert spring.groups == (0,) and spring.center == -1 and spring.ends_free and spring.name == "ほげ"
    joint = spring.joints[1]
    assert (joint.stiffness, joint.gravity, joint.drag, joint.radius) == (2.5, 0.1, 0.3, 0.04)
    assert np.allclose(joint.gravity_direction, [-0.6, -0.8, 0])  # the avatar was turned to face +Z
    (ball,) = model.colliders
    assert ball.node == 1 and ball.radius == 0.5 and np.allclose(ball.offset, [1, 2, -3]) and model.groups == ((0,),)
    assert moved_joints(character).tolist() == [False, False, True, True, True, True]
    assert apparel_mask(character).tolist() == [False] * 3 + [True] * 3


def test_vrm_1(tmp_path):
    extended = {"shape": {"sphere": {"offset": [0, 0, 0], "radius": 2, "inside": True}}}
    plane = {"shape": {"plane": {"offset": [0, 0, 0], "normal": [0, 1, 0]}}}
    more = [
        {
            "node": 0,
            "shape": {"sphere": {"radius": 0.1}},
            "extensions": {"VRMC_springBone_extended_collider": extended},
        },
        {"node": 0, "extensions": {"VRMC_springBone_extended_collider": plane}},
    ]
    _, model = load(tmp_path, new())
    assert (model.version, model.title, model.humanoid) == (
        "1.0",
        "Doll",
        {"hips": 0, "head": 1},
    ) and not model.warnings
    (spring,) = model.springs
    assert [joint.node for joint in spring.joints] == [2, 3, 4] and not spring.ends_free and spring.groups == (0,)
    assert (spring.joints[0].stiffness, spring.joints[1].stiffness, spring.joints[1].drag) == (3, 1, 0.5)
    assert np.allclose(spring.joints[0].gravity_direction, [0, -1, 0])
    ball, rod = model.colliders
    assert (
        ball.shape == "sphere"
        and np.allclose(ball.offset, [1, 2, 3])
        and rod.shape == "capsule"
        and np.allclose(rod.tail, [0, 1, 0])
    )
    _, model = load(tmp_path, new(colliders=more))
    assert model.colliders[0].inside and model.colliders[0].radius == 2 and model.colliders[1].shape == "plane"


def test_broken_parts_are_left_out_with_a_warning(tmp_path):
    def warned(extensions, match):
        _, model = load(tmp_path, extensions)
        assert any(match in warning for warning in model.warnings), model.warnings
        return model

    ball = SPHERE["colliders"][0]
    for radius in (-1, "x", 10**400):
        model = warned(
            old(colliders=[{"node": 1, "colliders": [ball | {"radius": radius}, ball]}]),
            "negative or not a number and are left out: head",
        )
        assert len(model.colliders) == 1 and model.groups == ((0,),)
    assert (
        warned(old(colliders=[{"node": 99, "colliders": [ball]}]), "colliders are on nodes that do not exist").colliders
        == ()
    )
    assert warned(old({"bones": [77, 2]}), "begin at nodes that do not exist and are left out: 77").springs
    assert warned(old({"colliderGroups": [0, 9]}), "groups of colliders that do not exist").springs[0].groups == (0,)
    assert warned(old({"stiffiness": None}), "springs hold values").springs == ()
    assert warned(
        old(bones=[{"bone": "hips", "node": 0}, {"bone": "head", "node": -4}]), "bones of the person"
    ).humanoid == {"hips": 0}
    looped = {"name": "loop", "joints": [{"node": 2}, {"node": 3}, {"node": 2}, {"node": 3}]}
    assert (
        len(
            warned(new(springs=[looped]), "go on at nodes that are not below and are cut there: loop").springs[0].joints
        )
        == 2
    )
    assert (
        warned(
            new(springs=[{"name": "one", "joints": [{"node": 2}]}]), "no chain of nodes and are left out: one"
        ).springs
        == ()
    )
    _, twice = load(tmp_path, old({"bones": [2, 2, 3]}))
    assert sum(len(spring.joints) for spring in twice.springs) == 4  # each node swings once
    for nonsense in (
        {"VRM": 3},
        {"VRM": {"humanoid": [], "secondaryAnimation": {"boneGroups": {"a": 1}}}},
        {"VRMC_vrm": None, "VRMC_springBone": []},
    ):
        assert load(tmp_path, nonsense)[1].springs == ()


def test_nodes_in_a_cycle_and_files_without_vrm(tmp_path):
    character, model = load(tmp_path, {})
    assert model is None and apparel_mask(character) is None
    from gltf_files import cube_glb

    (tmp_path / "cube.glb").write_bytes(cube_glb())
    assert vrm_model(load_character(tmp_path / "cube.glb")) is None
    maker = Maker()
    points = {"POSITION": maker.add(np.eye(3, dtype="<f4"), True)}
    nodes = [{"mesh": 0}, {"children": [2]}, {"children": [1]}]
    (tmp_path / "round.vrm").write_bytes(
        maker.glb(nodes=nodes, meshes=[{"primitives": [{"attributes": points}]}], extensions=old())
    )
    with pytest.raises(FormatError, match="cycle"):
        load_character(tmp_path / "round.vrm")
