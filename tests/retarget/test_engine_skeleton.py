"""Skeletons that engines take, held against the rules of Unity's Humanoid and of VRM 1.0's humanoid."""

from pathlib import Path

import numpy as np
import pytest

import bunraku
from bunraku.anatomy.anatomy import Anatomy
from bunraku.body.layout import HANDLE_NAMES
from bunraku.core.rig_animation import RigAnimation
from bunraku.errors import CharacterError, OptionError
from bunraku.formats.gltf.builder import mesh_document
from bunraku.formats.gltf.container.open import open_document
from bunraku.formats.gltf.read import character_from_document
from bunraku.formats.gltf.scene.nodes import read_nodes, read_skins
from bunraku.geometry.surface import vertex_normals
from bunraku.io import load_character, save_character
from bunraku.pipelines.requests.request import Request, Sampling
from bunraku.retarget.engine_skeleton import carried, on_skeleton
from bunraku.retarget.rig_parts import RigParts

# VRM 1.0's table of humanoid bones: each required one, and the nearest required or optional one above it.
VRM_PARENTS = {
    "hips": "", "spine": "hips", "chest": "spine", "upperChest": "chest", "neck": "upperChest", "head": "neck",
    **{f"{s}{a}": b if b in ("hips", "upperChest") else f"{s}{b}" for s in ("left", "right") for a, b in (
        ("UpperLeg", "hips"), ("LowerLeg", "UpperLeg"), ("Foot", "LowerLeg"), ("Toes", "Foot"),
        ("Shoulder", "upperChest"), ("UpperArm", "Shoulder"), ("LowerArm", "UpperArm"), ("Hand", "LowerArm"))},
}  # fmt: skip
VRM_REQUIRED = {
    "hips", "spine", "head", *(f"{side}{part}" for side in ("left", "right")
    for part in ("UpperLeg", "LowerLeg", "Foot", "UpperArm", "LowerArm", "Hand")),
}  # fmt: skip
UNITY_MIXAMO = {
    "Hips", "Spine", "Head", *(f"{side}{part}" for side in ("Left", "Right")
    for part in ("UpLeg", "Leg", "Foot", "Arm", "ForeArm", "Hand")),
}  # fmt: skip


@pytest.fixture(scope="module")
def person():
    mesh = bunraku.sample_character("person")
    normals = vertex_normals(mesh.vertices, mesh.faces)
    document = mesh_document(Path("person"), mesh.vertices, [(mesh.faces, None)], normals=normals)
    character = character_from_document(document, "person")
    return character, Anatomy.of(character, bunraku.rig(character))


def heads(character):
    return dict(zip(character.rig.names, character.rig.positions, strict=True))


def test_vrm_has_the_bones_that_it_requires_below_those_that_it_asks_for(person):
    rig = on_skeleton(person[1], "vrm").rig
    parents = {name: "" if up < 0 else rig.names[up] for name, up in zip(rig.names, rig.parents, strict=True)}
    assert set(parents) >= VRM_REQUIRED and len(set(rig.names)) == len(rig.names)
    for name, above in VRM_PARENTS.items():
        while above and above not in parents:  # one that may be left out
            above = VRM_PARENTS[above]
        assert name not in parents or parents[name] == above, name


def test_unity_finds_the_bones_that_it_requires(person):
    names = on_skeleton(person[1], "mixamo").rig.names
    assert {name.removeprefix("mixamorig:") for name in names} >= UNITY_MIXAMO


def test_unreal_has_a_root_on_the_ground(person):
    rig = on_skeleton(person[1], "unreal").rig
    assert rig.names[0] == "root" and np.array_equal(rig.positions[0], np.zeros(3))
    assert rig.names[1] == "pelvis" and rig.parents[1] == 0 and (rig.parents == -1).sum() == 1


def test_it_rests_in_a_t_pose(person):
    made = on_skeleton(person[1], "vrm")
    at = heads(made)
    for side, way in (("left", 1.0), ("right", -1.0)):
        for upper, lower in (("UpperArm", "LowerArm"), ("LowerArm", "Hand")):
            arm = at[f"{side}{lower}"] - at[f"{side}{upper}"]
            assert arm[0] * way > 0.995 * np.linalg.norm(arm)
        leg = at[f"{side}Foot"] - at[f"{side}UpperLeg"]
        assert -leg[1] > 0.98 * np.linalg.norm(leg)
    assert abs(float(made.vertices[made.surface, 1].min())) < 1e-5
    assert np.array_equal(made.rig.transforms[:, :3, :3], np.tile(np.eye(3), (len(made.rig.names), 1, 1)))


def test_what_is_written_rests_and_is_bound_in_that_pose(person, tmp_path):
    made = on_skeleton(person[1], "mixamo")
    path = save_character(made, tmp_path / "hero.glb", rig=True)
    document = open_document(path, path.read_bytes())
    tree = read_nodes(document)
    skins = read_skins(document, tree)
    assert np.abs(tree.world[skins.nodes] @ skins.inverse[0] - np.eye(4)).max() < 1e-5  # bound where it rests
    again = load_character(path)
    assert np.abs(again.vertices - made.vertices).max() < 1e-5
    assert np.abs(again.rig.dense_weights() - made.rig.dense_weights()).max() < 1e-5
    primitive = document.items("meshes")[0]["primitives"][0]
    assert "NORMAL" in primitive["attributes"]
    normals = document.accessor(primitive["attributes"]["NORMAL"], ("VEC3",))
    faces = again.vertices[again.faces].astype(float)
    flat = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    size = np.linalg.norm(flat, axis=1)
    own = normals[again.faces[:, 0]].astype(float)
    cosine = (own * flat).sum(axis=1) / np.maximum(size, 1e-12)
    assert np.median(cosine[size > 1e-9]) > 0.95  # normals are turned with the mesh


def test_a_vrm_skeleton_is_written_as_a_vrm_humanoid(person, tmp_path):
    """By the schema of VRMC_vrm 1.0: what is required is there, and each bone is the node of its name."""
    made = on_skeleton(person[1], "vrm")
    path = save_character(made, tmp_path / "hero.glb", rig=True)
    document = open_document(path, path.read_bytes())
    assert "VRMC_vrm" in document.tree["extensionsUsed"]
    avatar = document.tree["extensions"]["VRMC_vrm"]
    assert avatar["specVersion"] == "1.0" and avatar["meta"]["name"] and avatar["meta"]["authors"]
    assert avatar["meta"]["licenseUrl"] == "https://vrm.dev/licenses/1.0/"  # the schema's one value
    bones = avatar["humanoid"]["humanBones"]
    nodes = document.items("nodes")
    assert set(bones) >= VRM_REQUIRED and all(nodes[bone["node"]]["name"] == name for name, bone in bones.items())
    assert set(bones) <= set(VRM_PARENTS) | {"leftMiddleProximal", "rightMiddleProximal"}
    read = load_character(path)
    assert read.avatar is not None and np.abs(read.vertices - made.vertices).max() < 1e-5
    for names in ("mixamo", "unreal"):
        path = save_character(on_skeleton(person[1], names), tmp_path / f"{names}.glb", rig=True)
        assert "extensions" not in open_document(path, path.read_bytes()).tree


def test_names_are_read_back_as_the_parts_that_they_are(person):
    for names in ("mixamo", "vrm", "unreal"):
        made = on_skeleton(person[1], names)
        parts = RigParts.of(made)
        assert parts.humanoid
        for part in ("pelvis", "left_hip", "right_knee", "left_shoulder", "right_elbow", "right_wrist", "head"):
            assert parts.leads[HANDLE_NAMES.index(part)] >= 0, (names, part)


def test_it_is_animated_as_any_skeleton(person, tmp_path):
    made = bunraku.with_skeleton(person[0], "unreal")
    moved = bunraku.Animator.shipped()(made, Request("walks forward", Sampling(2.0, 1, 4, candidates=1)))
    assert isinstance(moved, RigAnimation) and moved.character.rig.names[0] == "root"
    path = moved.save(tmp_path / "walk.glb")
    document = open_document(path, path.read_bytes())
    names = {document.items("nodes")[channel["target"]["node"]]["name"]
             for channel in document.items("animations")[0]["channels"]}  # fmt: skip
    assert {"pelvis", "thigh_l", "upperarm_r"} <= names


def test_what_handles_do_is_carried_onto_it(person):
    character, anatomy = person
    moved = bunraku.Animator.shipped()(character, Request("waves", Sampling(1.0, 1, 4, candidates=1)))
    anatomy = Anatomy.of(moved.character, moved.handles)
    for names in ("vrm", "unreal"):
        made = carried(moved, anatomy, on_skeleton(anatomy, names))
        away = np.linalg.norm(made.vertices() - moved.vertices(), axis=-1)
        assert away.max() < 1e-3 * character.height and np.ptp(moved.vertices(), axis=0).max() > 0.1
    with pytest.raises(CharacterError, match="not the skeleton"):
        carried(moved, anatomy, character)


def test_who_is_no_person_is_refused(person):
    dog = bunraku.sample_character("dog")
    with pytest.raises(CharacterError, match="two arms and two legs"):
        bunraku.with_skeleton(dog, "mixamo")
    with pytest.raises(OptionError, match="mixamo, vrm, unreal"):
        on_skeleton(person[1], "daz")
