"""Rigged characters as training data, also of RigNet."""

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bunraku.core.body.reference import reference_body
from bunraku.errors import CharacterError, FormatError
from bunraku.files import save_character
from bunraku.files.samples import sample_names
from bunraku_lab.datasets.characters.build import (
    HELD_OUT,
    build_characters,
    load_characters,
    load_rigged,
    rigged_files,
    training_character,
)
from bunraku_lab.datasets.characters.training_character import TrainingCharacter
from bunraku_lab.synthetic.samples import make_sample


def test_reference_character_knows_its_handles():
    body = reference_body()
    built = training_character(body.character(), "reference", mesh_vertices=600)
    assert len(built.vertices) <= 600 and built.height == pytest.approx(1, abs=0.05)
    np.testing.assert_allclose(built.weights.sum(1), 1, atol=1e-4)
    assert built.handles.tolist() == list(range(22))  # SMPL's own names are read as SMPL's own handles
    left_wrist = built.vertices[built.target[:, 20] > 0.5]
    assert len(left_wrist) and left_wrist[:, 0].min() > 0.2
    assert np.linalg.norm(built.root - built.joints[0]) < 1e-5


def test_characters_are_turned_to_face_forward():
    character = reference_body().character()
    quarter = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # +Z to +X
    transforms = character.rig.transforms.copy()
    transforms[:, :3, 3] = transforms[:, :3, 3] @ quarter.T
    rig = type(character.rig)(
        character.rig.names, character.rig.parents, transforms, character.rig.indices, character.rig.weights
    )
    turned = type(character)("turned", character.vertices @ quarter.T.astype(np.float32), character.faces, rig)
    a, b = training_character(character, "a", 600), training_character(turned, "b", 600)
    np.testing.assert_allclose(b.joints, a.joints, atol=1e-3)


def test_characters_without_rigs_and_empty_folders(tmp_path):
    body = reference_body()
    bare = type(body.character())("bare", body.vertices, body.faces)
    with pytest.raises(CharacterError, match="no rig"):
        training_character(bare, "bare")
    with pytest.raises(FormatError, match="no GLB"):
        build_characters(tmp_path, tmp_path / "cache")


def test_variants_of_held_out_characters_are_neither_trained_on_nor_validated_twice(tmp_path):
    built = training_character(reference_body().character(), "x", mesh_vertices=300)
    for name in (HELD_OUT[0], HELD_OUT[0] + "~posed", "pack/free", "pack/free~posed"):
        path = tmp_path / f"{name}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        replace(built, name=name).save(path)
    train, held = load_characters(tmp_path)
    assert [c.name for c in train] == ["pack/free", "pack/free~posed"] and [c.name for c in held] == [HELD_OUT[0]]


DATA = Path(__file__).parents[2] / "files" / "data"


def put_rignet(folder: Path) -> None:
    """A sample character in the layout of the ModelsResource-RigNet archive."""
    character = make_sample("person", 0.3, rigged=True)
    lines = [
        f"joints {name.replace(' ', '_')} {x} {y} {z}"
        for name, (x, y, z) in zip(character.rig.names, character.rig.positions, strict=True)
    ]
    names = [name.replace(" ", "_") for name in character.rig.names]
    lines += [f"root {name}" for name, parent in zip(names, character.rig.parents, strict=True) if parent < 0]
    lines += [
        f"hier {names[parent]} {name}" for name, parent in zip(names, character.rig.parents, strict=True) if parent >= 0
    ]
    for vertex, row in enumerate(character.rig.dense_weights()):
        lines.append(f"skin {vertex} " + " ".join(f"{names[joint]} {row[joint]:.4f}" for joint in row.nonzero()[0]))
    (folder / "obj").mkdir(parents=True)
    (folder / "rig_info").mkdir()
    corners = [f"v {x} {y} {z}" for x, y, z in character.vertices] + [
        f"f {a + 1} {b + 1} {c + 1}" for a, b, c in character.faces
    ]
    (folder / "obj" / "7.obj").write_text("\n".join(corners))
    (folder / "rig_info" / "7.txt").write_text("\n".join(lines))
    (folder / "obj" / "no_rig.obj").write_text("v 0 0 0\n")


def test_all_kinds_become_training_characters(tmp_path):
    put_rignet(tmp_path / "set")
    fbx = gzip.decompress((DATA / "boxman_z_up_cm.fbx.gz").read_bytes())
    (tmp_path / "mixamo").mkdir()
    (tmp_path / "mixamo" / "man.fbx").write_bytes(fbx)
    save_character(make_sample("mushroom", 0.3), tmp_path / "mixamo" / "man.glb")  # of the same name, and without a rig
    found = [path.relative_to(tmp_path).as_posix() for path in rigged_files(tmp_path)]
    assert found == ["mixamo/man.fbx", "mixamo/man.glb", "set/obj/7.obj"]

    for name in sample_names():  # what is there already is kept, so the samples are not built again here
        (tmp_path / "cache" / "samples").mkdir(parents=True, exist_ok=True)
        (tmp_path / "cache" / "samples" / f"{name}.npz").touch()
    done, failed = build_characters(tmp_path, tmp_path / "cache", 300)
    names = {path.relative_to(tmp_path / "cache").with_suffix("").as_posix() for path in done}
    assert (
        {"mixamo/man", "set/obj/7"} <= names
        and list(failed) == ["mixamo/man.glb"]
        and "no rig" in failed["mixamo/man.glb"]
    )
    man, seven = (TrainingCharacter.load(tmp_path / "cache" / f"{name}.npz") for name in ("mixamo/man", "set/obj/7"))
    assert man.handles[0] == 0 and set(man.handles.tolist()) >= {0, 1, 2, 4, 5, 15, 16, 17, 18, 19}  # by Mixamo's names
    left = man.vertices[man.target[:, 18] > 0.9]
    assert len(left) and 0.9 < man.height <= 1.01 and left[:, 0].min() > 0
    assert seven.handles[0] == 0 and len(seven.vertices) <= 300


OBJ = (
    "\n".join(f"v {x} {y} {z}" for y in (0, 1, 2) for x, z in ((-1, 0), (1, 0), (0, 1)))
    + "\nf 1 2 5 4\nf 2 3 6 5\nf 4 5 8 7\nf 5 6 9 8\n"
)
RIG = """joints hips 0.0 0.5 0.3
joints chest 0.0 1.5 0.3
joints head 0.0 2.0 0.3
root hips
hier hips chest
hier chest head
skin 0 hips 1.0000
skin 1 hips 1.0
skin 2 hips 1.0
skin 3 hips 0.5 chest 0.5
skin 4 chest 0.7 hips 0.3
skin 5 hips 2.0 chest 2.0
skin 6 chest 1.0
skin 7 chest 0.25 head 0.75
skin 8 head 1.0
"""


def put(folder: Path, layout: str, rig: str = RIG, obj: str = OBJ) -> tuple[Path, Path]:
    """A mesh and its rig text in one of the layouts."""
    mesh, text = {
        "beside": ("123.obj", "123_rig.txt"),
        "remesh": ("123_remesh.obj", "123_rig.txt"),
        "archive": ("obj/123.obj", "rig_info/123.txt"),
        "archive remesh": ("obj_remesh/123.obj", "rig_info_remesh/123.txt"),
    }[layout]
    for name, content in ((mesh, obj), (text, rig)):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(content)
    return folder / mesh, folder / text


@pytest.mark.parametrize("layout", ["beside", "remesh", "archive", "archive remesh"])
def test_layouts(tmp_path, layout):
    character = load_rigged(put(tmp_path, layout)[0])
    rig = character.rig
    assert rig.names == ("hips", "chest", "head") and rig.parents.tolist() == [-1, 0, 1]
    assert np.allclose(rig.positions, [[0, 0.5, 0.3], [0, 1.5, 0.3], [0, 2, 0.3]])
    expected = [
        [1, 0, 0], [1, 0, 0], [1, 0, 0], [0.5, 0.5, 0], [0.3, 0.7, 0], [0.5, 0.5, 0], [0, 1, 0], [0, 0.25, 0.75],
        [0, 0, 1],
    ]  # fmt: skip
    assert np.allclose(rig.dense_weights(), expected)
    assert character.source.suffix == ".obj"  # what is written keeps the OBJ's materials and UVs


@pytest.mark.parametrize(("old", "new", "match"), [
    ("skin 8 head", "skin 9 head", "for vertex 9 but the mesh has 9"),
    ("skin 8 head", "skin 8 tail", "names the joint 'tail', which has no 'joints' line"),
    ("skin 8 head", "skin 7 head", "line 15 weighs vertex 7 a second time"),
    ("skin 8 head 1.0", "skin 8 head", "line 15 is no 'skin VERTEX JOINT WEIGHT"),
    ("skin 8 head 1.0", "skin 8 head nan", "line 15 holds 'nan', which is no number"),
    ("skin 8", "skin -1", "line 15 weighs the vertex '-1', which is no number"),
    ("skin 8", "skin 99999999999999999999", "which is no number"),
    ("root hips\n", "", "needs one line 'root NAME'"),
    ("root hips\n", "root hips\nroot head\n", "needs one line 'root NAME'.*has 2"),
    ("root hips", "root neck", "needs one line 'root NAME'"),
    ("root hips", "root head", "its root 'head' has a parent"),
    ("hier hips chest", "hier head chest", "do not lead from the root to the joint 'chest', or go in a loop"),
    ("hier hips chest", "hier hips head", "gives the joint 'head' a second parent"),
    ("hier hips chest", "hier hips neck", "line 5 names the joint 'neck'"),
    ("joints head 0.0 2.0 0.3", "joints head 0.0 2.0", "line 3 is no 'joints NAME X Y Z'"),
    ("joints head 0.0", "joints chest 0.0", "names the joint 'chest' a second time"),
    ("joints head 0.0", "joints head 1e99", "which is no number"),
    ("root hips", "bone hips", "starts with 'bone'"),
])  # fmt: skip
def test_wrong_texts(tmp_path, old, new, match):
    mesh, text = put(tmp_path, "beside", RIG.replace(old, new))
    with pytest.raises(FormatError, match=match) as caught:
        load_rigged(mesh)
    assert str(text) in str(caught.value)


def test_texts_without_joints_or_of_another_mesh(tmp_path):
    for rig, match in (("hello\n", "line 1 starts with 'hello'"), ("\n", "has no joints"), (RIG.split("skin")[0],
    "has no skin lines"),
                       (RIG.split("skin 4")[0], "skin lines for 4 of the 9 vertices")):  # fmt: skip
        mesh, text = put(tmp_path, "beside", rig)
        with pytest.raises(FormatError, match=match):
            load_rigged(mesh)
    text.write_bytes(b"\0" * 100)
    with pytest.raises(FormatError, match="binary data"):
        load_rigged(mesh)
