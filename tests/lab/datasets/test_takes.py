"""Motions in files of their own: captions of the user, HumanML3D, AMASS."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.core.body.joint_rotations import motion_from_positions
from bunraku.core.body.layout import HANDLE_NAMES, JOINT_COUNT, JOINT_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import SkeletalMotion
from bunraku.errors import FormatError
from bunraku_lab.cli.data import Motions
from bunraku_lab.datasets.motions.clips import load_clip, load_index, write_index
from bunraku_lab.datasets.takes import add_takes, amass_takes, humanml3d_takes, licensed_takes, own_takes, read_texts


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
        ("file,text\n../a.bvh,walks\n", "below the folder"),
        ("file,text\n/etc/passwd,walks\n", "below the folder"),
        ("file,text\na.\0vh,walks\n", "line 2: .* below the folder"),
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


CAPTION = "a person bends.#a/DET person/NOUN bend/VERB#0.0#0.0\nbowing#bow/VERB#0.0#0.0\n"


def poses(frames):
    out = np.zeros((frames, JOINT_COUNT, 3))
    out[:, 3] = np.linspace(0, 1, frames)[:, None] * [0.8, 0, 0]  # bends forward
    return out


def humanml3d(folder):
    body = reference_body()
    for name in ("new_joints", "texts"):
        (folder / name).mkdir(parents=True)
    rotations = Rotation.from_rotvec(poses(60).reshape(-1, 3)).as_matrix().reshape(60, JOINT_COUNT, 3, 3)
    positions = SkeletalMotion(body.skeleton, rotations, np.tile(body.joints[0], (60, 1)), 20.0).world()[1]
    for key in ("000001", "000002", "M000001", "000003", "000004"):
        np.save(folder / "new_joints" / f"{key}.npy", positions if key != "000004" else positions[:5])
        (folder / "texts" / f"{key}.txt").write_text(
            CAPTION + ("he waits#he/PRON wait/VERB#0.5#2.0\n" if key == "000002" else "")
        )
    (folder / "texts" / "000003.txt").unlink()
    (folder / "train.txt").write_text("000001\nM000001\n000004\n")
    (folder / "test.txt").write_text("000002\n000003\n")
    return folder


def amass(folder):
    for name, start in (("KIT/3/bend_down02_poses", 0.0), ("MPI_HDM05/bk/01_01_poses", 0.3)):
        file = folder / f"{name}.npz"
        file.parent.mkdir(parents=True)
        full = np.zeros((600, 156))
        full[:, : 3 * JOINT_COUNT] = poses(600).reshape(600, -1)
        full[:, 0] = np.pi / 2
        np.savez(
            file, poses=full, trans=np.tile([start, 0, 1.0], (600, 1)), mocap_framerate=100.0, betas=np.zeros(16),
            gender="male",
        )  # fmt: skip
    np.savez(folder / "KIT" / "3" / "shape.npz", betas=np.zeros(16))
    return folder


def test_humanml3d_takes(tmp_path):
    takes = {take.name: take for take in humanml3d_takes(humanml3d(tmp_path / "h"))}
    assert set(takes) == {"humanml3d_000001", "humanml3d_000002", "humanml3d_000002_1", "humanml3d_000004"}
    assert (
        takes["humanml3d_000001"].texts == ("a person bends.", "bowing") and takes["humanml3d_000001"].split == "train"
    )
    span = takes["humanml3d_000002_1"]
    assert (span.texts, span.split, span.start, span.end) == (("he waits",), "test", 0.5, 2.0)


def test_takes_join_an_index(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    write_index(out, {"cmu_01": {"texts": ["walk"], "frames": 3, "split": "train"}})
    takes = humanml3d_takes(humanml3d(tmp_path / "h"))
    added, failed = add_takes(takes, out, jobs=1)
    assert sorted(added) == ["humanml3d_000001", "humanml3d_000002", "humanml3d_000002_1"]
    assert list(failed) == ["humanml3d_000004"] and "too short" in failed["humanml3d_000004"]
    index = load_index(out)
    assert index["cmu_01"]["texts"] == ["walk"] and index["humanml3d_000002_1"]["frames"] == 30
    clip = load_clip(out / "humanml3d_000001.npz")
    assert len(clip) == 60 and clip.fps == 20
    stamp = (out / "humanml3d_000001.npz").stat().st_mtime_ns
    write_index(out, {})  # as a second run of build_motions does
    assert sorted(add_takes(takes, out, jobs=1)[0]) == sorted(added)
    assert (out / "humanml3d_000001.npz").stat().st_mtime_ns == stamp and len(load_index(out)) == 3


def test_amass_with_the_captions_and_spans_of_humanml3d(tmp_path):
    captions, sets = humanml3d(tmp_path / "h"), amass(tmp_path / "a")
    rows = ["source_path,start_frame,end_frame,new_name"]
    rows += [
        "./pose_data/KIT/3/bend_down02_poses.npy,0,100,000001.npy",
        "./pose_data/MPI_HDM05/bk/01_01_poses.npy,10,60,000002.npy",
    ]
    rows += ["./pose_data/../../../etc/passwd.npy,0,1,000004.npy"]
    (captions / "index.csv").write_text("\n".join(rows) + "\n")
    takes = {take.name: take for take in licensed_takes(captions, sets)}
    assert set(takes) == {"amass_000001", "amass_000002", "amass_000002_1", "humanml3d_000004"}
    assert (takes["amass_000001"].start, takes["amass_000001"].end) == (0, 5)
    assert (takes["amass_000002"].start, takes["amass_000002"].end) == (3.5, 6)  # three seconds are cut off that set
    assert (takes["amass_000002_1"].start, takes["amass_000002_1"].end) == (4.0, 5.5)
    (tmp_path / "out").mkdir()
    added, _ = add_takes([takes["amass_000001"]], tmp_path / "out", jobs=1)
    assert added == ["amass_000001"] and len(load_clip(tmp_path / "out" / "amass_000001.npz")) == 100


def test_folders_that_are_something_else(tmp_path):
    with pytest.raises(FormatError, match="new_joint_vecs"):
        humanml3d_takes(tmp_path)
    with pytest.raises(FormatError, match=r"there is no \.npz"):
        amass_takes(tmp_path)
    (tmp_path / "h").mkdir()
    humanml3d(tmp_path / "h" / "x")
    for file in (tmp_path / "h" / "x" / "texts").iterdir():
        file.unlink()
    with pytest.raises(FormatError, match="none of its motions has a caption"):
        humanml3d_takes(tmp_path / "h" / "x")


def test_positions_of_a_bent_body_bend_it_alike():
    body = reference_body()
    rotations = Rotation.from_rotvec(poses(20).reshape(-1, 3)).as_matrix().reshape(20, JOINT_COUNT, 3, 3)
    positions = SkeletalMotion(body.skeleton, rotations, np.tile(body.joints[0], (20, 1)), 20.0).world()[1]
    found = motion_from_positions(positions, 20.0)
    assert np.abs(found.world()[1] - positions).max() < 1e-4
    turned = found.world()[0][:, 15] @ np.swapaxes(found.world()[0][:1, 15], -1, -2)
    assert np.degrees(Rotation.from_matrix(turned[-1]).magnitude()) == pytest.approx(np.degrees(0.8), abs=3)


def test_captions_with_spans(tmp_path):
    (tmp_path / "a.txt").write_text(
        "a man kicks.#a/DET man/NOUN kick/VERB#0.0#0.0\nhe  walks#he/PRON "
        "walk/VERB#1.5#3.0\nbare\n\n#x#0#0\nodd#x#nan#0.0\nback#x#5#2\n"
    )
    found = [(caption.text, caption.start, caption.end) for caption in read_texts(tmp_path / "a.txt")]
    assert found == [("a man kicks.", 0, 0), ("he walks", 1.5, 3), ("bare", 0, 0), ("odd", 0, 0), ("back", 0, 0)]
    (tmp_path / "b.txt").write_text("\n##\n")
    with pytest.raises(FormatError, match=r"b\.txt: there is no caption"):
        read_texts(tmp_path / "b.txt")
    (tmp_path / "c.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FormatError, match="UTF-8"):
        read_texts(tmp_path / "c.txt")
