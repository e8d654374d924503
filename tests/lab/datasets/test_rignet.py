"""ModelsResource-RigNet: an OBJ and its rig text, in both layouts, and texts that are wrong."""

from pathlib import Path

import numpy as np
import pytest

from bunraku.errors import FormatError
from bunraku_lab.datasets.characters.rignet import load_rigged

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
        [1, 0, 0],
        [1, 0, 0],
        [1, 0, 0],
        [0.5, 0.5, 0],
        [0.3, 0.7, 0],
        [0.5, 0.5, 0],
        [0, 1, 0],
        [0, 0.25, 0.75],
        [0, 0, 1],
    ]
    assert np.allclose(rig.dense_weights(), expected)
    assert character.source.suffix == ".obj"  # what is written keeps the OBJ's materials and UVs


def test_an_obj_alone_has_no_rig(tmp_path):
    mesh, text = put(tmp_path, "beside")
    text.rename(tmp_path / "other_rig.txt")
    assert load_rigged(mesh).rig is None


def test_vertices_without_a_line_take_the_weights_of_their_neighbours(tmp_path):
    mesh, _ = put(tmp_path, "beside", RIG.replace("skin 2 hips 1.0\n", ""))
    assert np.allclose(load_rigged(mesh).rig.dense_weights()[2], [0.5, 0.5, 0])


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
