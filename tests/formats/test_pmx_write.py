"""The PMX writer: what it writes is read back as the same character."""

from pathlib import Path

import numpy as np
import pytest

from bunraku import load_character, with_skeleton
from bunraku.core.character import Character
from bunraku.core.mmd_model import MmdAppend, MmdBone, MmdIk, MmdIkLink, mmd_model
from bunraku.errors import CharacterError
from bunraku.formats.mmd.build import MmdFile, mmd_character
from bunraku.formats.mmd.export import save_pmx, write_pmx
from bunraku.formats.mmd.pmx import read_pmx_file
from bunraku.formats.mmd.pmx_write import pmx_bytes
from bunraku.samples import sample_character
from bunraku_lab.synthetic.wardrobe import wardrobe_character


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
    _assert_same(read, mmd_character(tmp_path / "bones.pmx", read_pmx_file(tmp_path / "bones.pmx", write_pmx(read))))


def test_another_reader_agrees() -> None:
    """pymeshio, written by others, finds the same numbers."""
    reader = pytest.importorskip("pymeshio.pmx.reader")
    import io

    character = wardrobe_character(1)
    model = mmd_model(character)
    assert model is not None
    found = reader.read(io.BytesIO(write_pmx(character)))
    assert [bone.name for bone in found.bones] == list(model.names)
    assert [body.name for body in found.rigidbodies] == [body.name for body in model.bodies]
    assert [joint.name for joint in found.joints] == [joint.name for joint in model.joints]
    positions = np.array([[v.position.x, v.position.y, -v.position.z] for v in found.vertices]) * 0.08
    np.testing.assert_allclose(positions, character.vertices, atol=1e-6)
    assert len(found.indices) == 3 * len(character.faces)


def test_a_mesh_without_bones_is_refused() -> None:
    with pytest.raises(CharacterError, match="no rig"):
        write_pmx(sample_character("person"))


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
