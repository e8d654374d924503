"""Models of MikuMikuDance: reading PMX and PMD, writing PMX."""

import os
import struct
from dataclasses import replace
from pathlib import Path

import hostile
import numpy as np
import pytest
from mmd_bytes import Bone, plank, pmd, pmx
from scipy.spatial.transform import Rotation

from bunraku import with_skeleton
from bunraku.apparel.mask import apparel_mask, moved_joints
from bunraku.core.avatars import MmdAppend, MmdBone, MmdIk, MmdIkLink, mmd_model
from bunraku.core.character import Character
from bunraku.errors import FormatError
from bunraku.files import load_character
from bunraku.files.mmd.model import MmdFile, mmd_character
from bunraku.files.mmd.read import read_pmx_file
from bunraku.files.mmd.write import pmx_bytes, pmx_file, save_pmx
from bunraku.files.samples import sample_character
from bunraku_lab.synthetic.wardrobe import wardrobe_character

MODELS = Path(os.environ.get("BUNRAKU_DATA", "runs/data"), "apparel/mmd")
FLIP = np.diag([1.0, 1, -1])


def load(folder, data, name="doll.pmx"):
    (folder / name).write_bytes(data)
    character = load_character(folder / name)
    return character, mmd_model(character)


@pytest.mark.parametrize(
    ("utf8", "sizes", "uvs"),
    [(False, (1, 1, 1, 2, 1, 1), 0), (True, (4, 2, 4, 4, 2, 4), 2), (False, (2, 4, 2, 1, 4, 2), 4)],
)
def test_a_pmx_in_our_frame(tmp_path, utf8, sizes, uvs):
    character, model = load(tmp_path, pmx(plank(), utf8=utf8, sizes=sizes, uvs=uvs))
    assert np.allclose(
        character.vertices, np.array([[-1, 0, 0], [1, 0, 0], [1, 20, -1], [-1, 20, -1]]) * 0.08, atol=1e-6
    )
    a, b, c = character.vertices[character.faces].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()  # it faces +Z, as its normals said -Z
    assert (model.name, model.english, model.version) == ("人形", "doll", "PMX 2.0")
    assert character.rig.names == model.names == (
        "センター",
        "上半身",
        "スカート",
    ) and character.rig.parents.tolist() == [-1, 0, 1]
    assert np.allclose(character.rig.positions, np.array([[0, 8, -0.5], [0, 12, 0], [0, 16, 2]]) * 0.08, atol=1e-6)
    assert np.allclose(character.rig.dense_weights(), [[1, 0, 0], [0.75, 0.25, 0], [0, 0.5, 0.5], [0, 0.5, 0.5]])
    assert model.deforms.tolist() == [0, 1, 2, 3] and model.sdef.vertices.tolist() == [3]
    assert np.allclose(model.sdef.center, [[0.08, 0.16, -0.24]]) and np.allclose(model.sdef.r1, [[0.56, 0.64, -0.72]])
    assert [(morph.name, morph.kind, morph.count) for morph in model.morphs] == [
        ("あ", "vertex", 1),
        ("材", "material", 1),
    ]
    assert np.allclose(model.bones[0].tail, [0, 0.08, 0]) and np.allclose(
        model.bones[1].tail, np.array([0, 4, 2]) * 0.08
    )
    skirt = model.bones[2]
    assert (skirt.append.bone, skirt.append.ratio, skirt.append.rotation, skirt.append.translation) == (
        1,
        0.5,
        True,
        False,
    )
    assert (
        np.allclose(skirt.fixed_axis, [0, 0, -1])
        and np.isclose(np.linalg.det(skirt.local_axes), 1)
        and skirt.layer == 1
    )


def test_materials_and_textures(tmp_path):
    from PIL import Image

    (tmp_path / "tex").mkdir()
    Image.new("RGB", (2, 2), (0, 128, 255)).save(tmp_path / "tex" / "Skin.PNG")  # Windows does not mind capitals
    character, model = load(tmp_path, pmx(plank()))
    materials = character.source.document.tree["materials"]
    assert (
        [material["name"] for material in materials] == ["肌", "服"]
        and materials[0]["doubleSided"]
        and materials[1]["alphaMode"] == "BLEND"
    )
    assert materials[0]["pbrMetallicRoughness"]["baseColorTexture"] == {"index": 0} and not model.warnings
    assert len(character.source.document.items("images")) == 1
    uv = character.source.document.accessor(
        character.source.document.items("meshes")[0]["primitives"][0]["attributes"]["TEXCOORD_0"], ("VEC2",)
    )
    assert np.allclose(uv, [[0, 1], [1, 1], [1, 0], [0, 0]])  # v downwards in both


@pytest.mark.parametrize(
    "name", ["..\\secret.png", "/etc/passwd", "C:\\Windows\\a.png", "https://example.org/a.png", "tex/../../secret.png"]
)
def test_textures_outside_the_folder_are_left_out(tmp_path, name):
    from PIL import Image

    folder = tmp_path / "model"
    folder.mkdir()
    Image.new("RGB", (2, 2)).save(tmp_path / "secret.png")
    character, model = load(folder, pmx(plank(textures=[name])))
    assert not character.source.document.items("images") and "outside the model's folder" in model.warnings[0]


def test_bodies_and_joints_in_our_frame(tmp_path):
    _, model = load(tmp_path, pmx(plank()))
    core, cloth = model.bodies
    assert (core.shape, core.mode, core.dynamic, core.bone) == ("box", 0, False, 1)
    assert np.allclose(core.position, np.array([0, 12, -1]) * 0.08) and np.allclose(core.size, 0.08)
    want = Rotation.from_euler("YXZ", [0.2, 0.1, 0.3]).as_matrix()  # about z first, then x, then y
    assert np.allclose(core.rotation, FLIP @ want @ FLIP, atol=1e-6)
    assert (cloth.shape, cloth.group, cloth.mask, cloth.dynamic) == ("capsule", 3, 0xFFF7, True)
    assert np.allclose(
        [cloth.linear_damping, cloth.angular_damping, cloth.restitution, cloth.friction], [0.5, 0.6, 0.1, 0.7]
    )
    (joint,) = model.joints
    assert (
        joint.bodies == (0, 1)
        and np.allclose(joint.lower, np.array([-1, -2, -6]) * 0.08)
        and np.allclose(joint.upper, np.array([4, 5, 3]) * 0.08)
    )
    assert np.allclose(joint.angle_lower, [-0.4, -0.5, -0.3]) and np.allclose(joint.angle_upper, [0.1, 0.2, 0.6])
    assert np.allclose(joint.rotation, Rotation.from_rotvec([-0.4, 0, 0]).as_matrix(), atol=1e-6)
    assert np.allclose(joint.spring, [1, 2, 3]) and np.allclose(joint.angle_spring, [4, 5, 6])


def test_apparel_is_what_physics_move(tmp_path):
    bones = [*plank().bones, Bone("すそ", (0.0, 17.0, 0.0), 2)]
    vertices = plank().vertices
    vertices[2] = (*vertices[2][:3], (1, [3, 0], [0.6]))
    character, _ = load(tmp_path, pmx(plank(bones=bones, vertices=vertices)))
    assert moved_joints(character).tolist() == [False, False, True, True]
    assert apparel_mask(character).tolist() == [False, False, True, False]  # a half is not more than a half


def test_a_pmd(tmp_path):
    positions = {
        "センター": (0, 8, 0),
        "左足": (1, 10, 0),
        "左ひざ": (1, 5, 0),
        "左足首": (1, 1, 0),
        "左足ＩＫ": (1, 1, 0),
        "左目": (0, 15, 0),
        "捩": (2, 10, 0),
    }
    above = (-1, 0, 1, 2, 0, 0, 0)
    bones = [
        Bone(name, tuple(map(float, position)), parent)
        for (name, position), parent in zip(positions.items(), above, strict=True)
    ]
    model = plank(bones=bones, materials=[("", (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0, 0, 6)])
    kinds = {4: (2, 0, 0), 5: (5, 0, 1), 6: (8, 1, 0), 0: (9, 2, 50)}
    data = pmd(model, [(4, 3, 40, 0.5, [2, 1])], kinds=kinds)
    character, read = load(tmp_path, data, "doll.pmd")
    assert (read.version, read.name, read.english, read.bones[3].english) == ("PMD", "人形", "doll", "bone")
    assert np.allclose(
        character.vertices, np.array([[-1, 0, 0], [1, 0, 0], [1, 20, -1], [-1, 20, -1]]) * 0.08, atol=1e-6
    )
    assert np.allclose(character.rig.dense_weights()[:, :3], [[1, 0, 0], [0.75, 0.25, 0], [0, 1, 0], [0, 0.5, 0.5]])
    ik = read.bones[4].ik
    assert (ik.target, ik.loops, ik.limit) == (3, 40, 2.0) and [link.bone for link in ik.links] == [2, 1]
    assert (
        np.allclose(np.degrees([ik.links[0].lower, ik.links[0].upper]), [[0.5, 0, 0], [180, 0, 0]])
        and ik.links[1].lower is None
    )
    assert (read.bones[5].append.bone, read.bones[5].append.ratio) == (1, 1.0) and (
        read.bones[0].append.bone,
        read.bones[0].append.ratio,
    ) == (2, 0.5)
    assert np.allclose(read.bones[6].fixed_axis, [-1, 0, 0])
    assert np.allclose(read.bodies[0].position, np.array([1, 22, -1]) * 0.08)  # it counts from its bone
    assert len(read.joints) == 1 and [morph.name for morph in read.morphs] == ["あ", "材"]
    _, short = load(tmp_path, pmd(model, tail=False), "old.pmd")
    assert short.bodies == () and short.english == ""


def test_broken_parts_are_left_out_with_a_warning(tmp_path):
    def warned(match, **changes):
        _, model = load(tmp_path, pmx(plank(**changes)))
        assert any(match in warning for warning in model.warnings), model.warnings
        return model

    first, second = plank().bodies
    joint = plank().joints[0]
    light = warned("have no mass and follow their bones: 布", bodies=[first, replace(second, mass=0.0)])
    assert not light.bodies[1].dynamic
    assert warned("do not exist and are left out: 糸", joints=[replace(joint, bodies=(0, 9))]).joints == ()
    assert warned("tie a rigid body to itself", joints=[replace(joint, bodies=(1, 1)), joint]).joints[0].bodies == (
        0,
        1,
    )
    assert (
        warned("not numbers and are left out: 芯", bodies=[replace(first, mass=np.nan), second]).bodies[0].name == "布"
    )
    assert warned("not numbers and are left out: 糸", joints=[replace(joint, position=(np.inf, 0.0, 0.0))]).joints == ()
    assert len(warned("negative size", bodies=[first, replace(second, size=(-1.0, 0.0, 0.0))]).bodies) == 1
    assert (
        len(warned("shape, mode or group", bodies=[first, replace(second, shape=9), replace(second, mode=7)]).bodies)
        == 1
    )
    assert warned("on a bone that does not exist", bodies=[replace(first, bone=77), second]).bodies[0].bone == -1
    bones = plank().bones
    assert warned("their own parents", bones=[replace(bones[0], parent=2), *bones[1:]]).parents.tolist().count(-1) == 1
    assert warned("their own parents", bones=[replace(bones[0], parent=0), *bones[1:]]).parents.tolist() == [-1, 0, 1]
    both = [replace(bones[0], append=(1, 1.0, 0x100)), replace(bones[1], append=(0, 1.0, 0x100)), bones[2]]
    assert sum(bone.append is not None for bone in warned("their own motion", bones=both).bones) == 2
    assert (
        warned(
            "take over the motion of a bone that does not exist",
            bones=[replace(bones[0], append=(50, 1.0, 0x100)), *bones[1:]],
        )
        .bones[0]
        .append
        is None
    )
    assert (
        warned("inverse kinematics of bones", bones=[replace(bones[0], ik=(1, 4, 1.0, [(99, None)])), *bones[1:]])
        .bones[0]
        .ik
        is None
    )
    assert warned("its materials are for 1 of its 2 triangles", materials=plank().materials[:1]).bones
    assert warned(
        "weighted to no bone", vertices=[*plank().vertices[:3], (*plank().vertices[3][:3], (0, [-1], []))]
    ).bones


def test_broken_files_get_one_sentence(tmp_path):
    good = pmx(plank())

    def refused(data, match, name="doll.pmx"):
        hostile.refused(tmp_path / name, data, match)

    refused(b"PMX " + struct.pack("<f", 3.0) + good[8:], "version 3")
    refused(good[:9] + b"\5" + good[10:], "sizes that no PMX file has")
    refused(good[:100], "cut off in its vertices|has room for")
    refused(good[: len(good) // 2], "cut off|has room for|are left")
    head = good.index(struct.pack("<i", 4), 17 + 8)
    refused(good[:head] + b"\xff\xff\xff\xff" + good[head + 4 :], "announces 4294967295 vertices but has room for")
    refused(good[:head] + b"\xff\xff\xff\x7f" + good[head + 4 :], "announces 2147483647 vertices but has room for")
    refused(good[:17] + b"\xff\xff\xff\xff" + good[21:], "4294967295 bytes")
    refused(pmx(plank(triangles=[0, 1, 200])), "uses vertex 200 but there are 4")
    refused(pmx(plank(triangles=[0, 1, -7]), sizes=(4, 1, 1, 2, 1, 1)), "uses vertex -7 but there are 4")
    for deform, match in (((0, [300], []), "weighted to bone 300 but there are 3"), ((9, [0], []), "vertex 3 deforms")):
        vertices = [*plank().vertices[:3], (*plank().vertices[3][:3], deform)]
        refused(pmx(plank(vertices=vertices)), match)
    refused(pmx(plank(bones=[Bone("あ", parent=40), *plank().bones])), "bone 0 has the parent 40")
    refused(
        pmx(plank(bones=[Bone("あ", position=(np.nan, 0.0, 0.0)), *plank().bones])), "a position that is not a number"
    )
    refused(pmx(plank(vertices=[((np.nan, 0.0, 0.0), *plank().vertices[0][1:]), *plank().vertices[1:]])), "not numbers")
    refused(pmx(plank(vertices=[], triangles=[], materials=[])), "empty")
    old = pmd(plank())
    refused(old[:300], "cut off|has room for", "doll.pmd")
    refused(old[:283] + b"\xff\xff\xff\xff" + old[287:], "announces 4294967295 vertices but has room for", "doll.pmd")
    refused(pmd(plank(triangles=[0, 1, 200])), "uses vertex 200", "doll.pmd")


def test_what_is_no_model_has_none(tmp_path):
    from gltf_files import cube_glb

    (tmp_path / "cube.glb").write_bytes(cube_glb())
    assert mmd_model(load_character(tmp_path / "cube.glb")) is None
    (tmp_path / "doll.pmx").write_bytes(b"Pmx!")
    with pytest.raises(FormatError, match="contents are not those of a .pmx file"):
        load_character(tmp_path / "doll.pmx")


@pytest.mark.skipif(not MODELS.is_dir(), reason="needs the unpacked MMD characters")
@pytest.mark.parametrize(
    ("file", "numbers"),
    [("uka/MS_Uka.pmx", (49955, 302, 164, 137, 151, 10085)), ("gene/Gene.pmx", (28646, 224, 87, 62, 92, 3456))],
)
def test_real_characters(file, numbers):
    character = load_character(MODELS / file)
    model = mmd_model(character)
    dynamic = sum(body.dynamic for body in model.bodies)
    apparel = int(apparel_mask(character).sum())
    assert (
        len(character.vertices),
        len(model.bones),
        len(model.bodies),
        dynamic,
        len(model.joints),
        apparel,
    ) == numbers
    assert 1.4 < character.height < 1.9 and abs(character.vertices[:, 1].min()) < 0.01
    from bunraku.anatomy.names.bone_names import handle_of_joints
    from bunraku.core.body.layout import HANDLE_NAMES

    handles = handle_of_joints(character.rig.names, character.rig.parents, character.rig.positions)
    named = {
        name: HANDLE_NAMES[handle] for name, handle in zip(character.rig.names, handles, strict=True) if handle >= 0
    }
    assert (
        named["左腕"] == "left_shoulder"
        and named["右ひざ"] == "right_knee"
        and named["下半身"] == "pelvis"
        and named["頭"] == "head"
    )


def _assert_same(first: Character, second: Character) -> None:
    a, b = mmd_model(first), mmd_model(second)
    assert a is not None and b is not None and first.rig is not None and second.rig is not None
    np.testing.assert_array_equal(first.vertices, second.vertices)
    np.testing.assert_array_equal(first.faces, second.faces)
    np.testing.assert_array_equal(first.rig.indices, second.rig.indices)
    np.testing.assert_array_equal(first.rig.weights, second.rig.weights)
    np.testing.assert_array_equal(first.rig.transforms, second.rig.transforms)
    np.testing.assert_array_equal(first.colors, second.colors)
    np.testing.assert_array_equal(a.deforms, b.deforms)
    assert (a.name, a.english, a.version, a.names) == (b.name, b.english, b.version, b.names)
    assert not b.warnings
    for mine, yours in zip((*a.bones, *a.bodies, *a.joints), (*b.bones, *b.bodies, *b.joints), strict=True):
        for name, value in vars(mine).items():
            other = getattr(yours, name)
            if isinstance(value, np.ndarray):
                np.testing.assert_allclose(other, value, atol=2e-7, err_msg=f"{mine.name}: {name}")
            elif name == "ik" and value is not None:
                assert (value.target, value.loops, value.limit) == (other.target, other.loops, other.limit)
                for link, again in zip(value.links, other.links, strict=True):
                    assert link.bone == again.bone
                    assert (link.lower is None) == (again.lower is None)
                    if link.lower is not None:
                        np.testing.assert_array_equal([link.lower, link.upper], [again.lower, again.upper])
            else:
                assert value == other, (mine.name, name)


def test_round_trip(tmp_path: Path) -> None:
    character = wardrobe_character(4)
    path = save_pmx(character, tmp_path / "one.pmx")
    _assert_same(character, load_character(path))


def test_all_kinds_of_bones(tmp_path: Path) -> None:
    """Appends, fixed and local axes, tails, layers: everything that a bone may have, told by hand."""
    file = MmdFile("PMX 2.0", "骨", "bones")
    file.positions, file.normals, file.uvs = (
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.5]]),
        np.tile([0.0, 0, -1], (3, 1)),
        np.zeros((3, 2)),
    )
    file.deforms = np.array([0, 1, 2], np.uint8)
    file.indices = np.array([[0, -1, -1, -1], [0, 1, -1, -1], [0, 1, 2, 3]])
    file.weights = np.array([[1, 0, 0, 0], [0.25, 0.75, 0, 0], [0.5, 0.25, 0.125, 0.125]])
    file.sdef, file.triangles = np.zeros((3, 3, 3)), np.array([[0, 1, 2]])
    axes = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    zero = np.zeros(3)
    file.bones = [
        MmdBone("親", "root", zero, -1, moves=True, tail=np.array([0, 0.08, 0.0])),
        MmdBone("左腕捩", "", np.array([0.08, 0, 0]), 0, 2, True, fixed_axis=np.array([0.6, -0.8, 0]), local_axes=axes,
        tail=zero),
        MmdBone("左目", "eye", np.array([0, 0.16, 0.08]), 1, append=MmdAppend(1, -0.5, True, False, True), tail=zero),
        MmdBone("左足ＩＫ", "", np.array([0, 0.16, 0.0]), 0, 1, rotates=False, tail=zero,
                ik=MmdIk(2, 12, 0.5, (MmdIkLink(1, np.array([-1.0, 0, -0.5]), np.array([0.25, 0, 0.75])),
                MmdIkLink(0)))),
    ]  # fmt: skip
    file.tails = {0: 1}
    data = pmx_bytes(file)
    (tmp_path / "bones.pmx").write_bytes(data)
    read = load_character(tmp_path / "bones.pmx")
    model = mmd_model(read)
    assert model is not None
    np.testing.assert_allclose(model.bones[0].tail, [0.08, 0, 0], atol=1e-7)
    np.testing.assert_allclose(model.bones[1].fixed_axis, [0.6, -0.8, 0], atol=1e-7)
    np.testing.assert_allclose(model.bones[1].local_axes, axes, atol=1e-7)
    assert model.bones[1].layer == 2 and model.bones[1].after_physics
    assert model.bones[2].append == MmdAppend(1, -0.5, True, False, True)
    assert not model.bones[3].rotates
    assert model.bones[3].ik is not None and len(model.bones[3].ik.links) == 2
    np.testing.assert_allclose(model.bones[3].ik.links[0].lower, [-1, 0, -0.5])
    np.testing.assert_allclose(read.vertices[1], [0.08, 0, 0], atol=1e-7)
    np.testing.assert_allclose(read.vertices[2], [0, 0.08, -0.04], atol=1e-7)
    written = read_pmx_file(tmp_path / "bones.pmx", pmx_bytes(pmx_file(read)))
    _assert_same(read, mmd_character(tmp_path / "bones.pmx", written))


def test_another_reader_agrees() -> None:
    """pymeshio, written by others, finds the same numbers."""
    reader = pytest.importorskip("pymeshio.pmx.reader")
    import io

    character = wardrobe_character(1)
    model = mmd_model(character)
    assert model is not None
    found = reader.read(io.BytesIO(pmx_bytes(pmx_file(character))))
    assert [bone.name for bone in found.bones] == list(model.names)
    assert [body.name for body in found.rigidbodies] == [body.name for body in model.bodies]
    assert [joint.name for joint in found.joints] == [joint.name for joint in model.joints]
    positions = np.array([[v.position.x, v.position.y, -v.position.z] for v in found.vertices]) * 0.08
    np.testing.assert_allclose(positions, character.vertices, atol=1e-6)
    assert len(found.indices) == 3 * len(character.faces)


def test_a_rig_of_another_file(tmp_path: Path) -> None:
    """A person on a skeleton becomes a model with the same bones and weights, and its picture lies beside it."""
    character = with_skeleton(sample_character("person"), "vrm")
    assert character.rig is not None
    read = load_character(save_pmx(character, tmp_path / "person.pmx"))
    assert read.rig is not None and read.rig.names == character.rig.names
    np.testing.assert_array_equal(read.rig.parents, character.rig.parents)
    np.testing.assert_allclose(read.rig.positions, character.rig.positions, atol=1e-6)
    assert len(read.faces) == len(character.faces)
    corners = np.sort(read.vertices[read.faces].reshape(len(read.faces), -1), axis=0)
    np.testing.assert_allclose(corners, np.sort(character.vertices[character.faces].reshape(-1, 9), axis=0), atol=1e-5)
