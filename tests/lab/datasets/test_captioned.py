"""A folder of one's own motions with a captions.csv: what becomes a clip, with which words, and what is refused."""

import json

import numpy as np
import pytest

from bunraku.body.layout import HANDLE_NAMES, JOINT_COUNT, JOINT_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.motion import SkeletalMotion
from bunraku.errors import FormatError
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku_lab.cli.data.samples import Motions
from bunraku_lab.datasets.motions.clips import load_clip, load_index
from bunraku_lab.datasets.takes.captioned import own_takes


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A BVH of four seconds with two sentences about all of it and one about its middle."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "takes").mkdir()
    body, turns = reference_body(), np.zeros((80, JOINT_COUNT, 3))
    turns[:, JOINT_NAMES.index("right_shoulder"), 2] = np.linspace(0, 1.2, 80)  # lowers the arm
    motion = SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), np.tile(body.joints[0], (80, 1)), 20.0)
    motion.save(folder / "takes" / "a wave.bvh")
    (folder / "captions.csv").write_text(
        "file,text,start,end,split,licence,credit\n"
        'takes/a wave.bvh,"a person hails, slowly",,,,CC0,A. Person\n'
        "takes/a wave.bvh,hails,,,,CC0,A. Person\n"
        "takes\\a wave.bvh,an arm goes up,1,3.5,val,,\n",
        encoding="utf-8",
    )
    return folder


def test_rows_about_the_same_seconds_are_one_take(folder):
    whole, part = own_takes(folder)
    assert (whole.name, whole.texts) == ("own_takes_a_wave", ("a person hails, slowly", "hails"))
    assert (part.name, part.start, part.end, part.split) == ("own_takes_a_wave_1_00_3_50", 1.0, 3.5, "val")
    assert (whole.licence, whole.credit, part.licence) == ("CC0", "A. Person", "as the owner's")


def test_they_become_clips_of_the_reference_body(folder, tmp_path):
    Motions(folder, tmp_path / "data", jobs=1).run()
    index = load_index(tmp_path / "data")
    assert {name: entry["frames"] for name, entry in index.items()} == {
        "own_takes_a_wave": 80, "own_takes_a_wave_1_00_3_50": 50,
    }  # fmt: skip
    assert index["own_takes_a_wave"]["stretches"][0]["texts"] == ["a person hails, slowly", "hails"]
    assert index["own_takes_a_wave"]["credit"] == "A. Person"
    whole, part = (load_clip(tmp_path / "data" / f"{name}.npz") for name in sorted(index))
    hand = HANDLE_NAMES.index("right_wrist")
    assert np.trace(whole.rotations[70, hand]) < 2.2  # that is 53 degrees
    np.testing.assert_allclose(part.rotations[:, hand], whole.rotations[20:70, hand], atol=2e-2)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("name,words\na.bvh,walks\n", "columns file and text"),
        ("file,text\n", "no rows"),
        ("file,text\nb.bvh,walks\n", "no file b.bvh"),
        ("file,text\n../a.bvh,walks\n", "leads out of the folder"),
        ("file,text\n/etc/passwd,walks\n", "leads out of the folder"),
        ("file,text\na.bvh,\n", "line 2: the text is missing"),
        ("file,text,start,end\na.bvh,walks,2,1\n", "the end must come after the start"),
        ("file,text,start,end\na.bvh,walks,nan,1\n", "no time in seconds"),
        ("file,text,split\na.bvh,walks,some\n", "write train, val or test"),
        (f"file,text\na.bvh,{'walks ' * 300}\n", "say it shorter"),
    ],
)
def test_what_cannot_be_followed_is_named(tmp_path, text, problem):
    (tmp_path / "a.bvh").write_text("HIERARCHY\n")
    (tmp_path / "captions.csv").write_text(text)
    with pytest.raises(FormatError, match=problem):
        own_takes(tmp_path)


def test_a_motion_that_cannot_be_read_is_left_out_and_said(folder, tmp_path, capsys):
    source = tmp_path / "own"
    source.mkdir()
    (source / "a.bvh").write_text("HIERARCHY\n")
    (source / "wave.bvh").write_bytes((folder / "takes" / "a wave.bvh").read_bytes())
    (source / "captions.csv").write_text("file,text\na.bvh,walks\nwave.bvh,waves\n")
    Motions(source, tmp_path / "data", jobs=1).run()
    assert list(json.loads((tmp_path / "data" / "index.json").read_text())["clips"]) == ["own_wave"]
    assert "left out" in capsys.readouterr().err
