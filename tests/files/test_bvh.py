"""BVH: every dialect's joints are where they were, what is written comes back, and broken files get one sentence."""

import time
import tracemalloc

import numpy as np
import pytest
from bvh_files import BLENDER, DIALECTS, bvh_text
from motion_files import walk_about
from scipy.spatial.transform import Rotation

from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.errors import BunrakuError, FormatError
from bunraku.files.motions.bvh import write_bvh
from bunraku.pipelines.to_reference import load_motion

SMALL = """HIERARCHY
ROOT hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT knee
  {
    OFFSET 0 -40 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 -120 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
1 2 3 90 0 0 0 0 0
1 2 4 0 90 0 0 0 90
"""


def read(tmp_path, text, name="take.bvh"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_motion(path)


def same(a, b):
    """Greatest angle between rotations [degrees]."""
    relative = np.swapaxes(np.asarray(a, float), -1, -2) @ np.asarray(b, float)
    return np.degrees(Rotation.from_matrix(relative.reshape(-1, 3, 3)).magnitude()).max()


def test_by_hand(tmp_path):
    motion = read(tmp_path, SMALL)
    assert motion.fps == 25 and motion.skeleton.names == ("hips", "knee")
    assert np.allclose(motion.skeleton.offsets[1], [0, -0.4, 0])  # centimetres
    assert np.allclose(motion.root_translation, [[0.01, 0.02, 0.03], [0.01, 0.02, 0.04]])
    positions = motion.world()[1]
    assert np.allclose(positions[0, 1], [0.41, 0.02, 0.03], atol=1e-6)  # a quarter turn about +Z takes -Y to +X
    assert np.allclose(positions[1, 1], [0.01, 0.02, -0.36], atol=1e-6)  # about +X to -Z
    assert np.allclose(motion.rotations[1, 1], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], atol=1e-6)


@pytest.mark.parametrize("dialect", DIALECTS, ids=str)
def test_joints_of_every_dialect_are_where_they_were(tmp_path, dialect):
    truth = walk_about(40, still=set(JOINT_NAMES) - {joint for _, _, joint, _ in DIALECTS[dialect].joints})
    motion = read(tmp_path, bvh_text(truth, DIALECTS[dialect]))
    positions = truth.world()[1]
    got = dict(zip(motion.skeleton.names, np.moveaxis(motion.world()[1], 1, 0), strict=True))
    for name, _, joint, share in DIALECTS[dialect].joints:
        if joint and share == 1:
            assert np.abs(got[name] - positions[:, JOINT_NAMES.index(joint)]).max() < 1e-3, name


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX", "XYX", "ZXZ", "Y", "XZ"])
def test_every_order_of_channels(tmp_path, order):
    rng = np.random.default_rng(0)
    angles = rng.uniform(-180, 180, (6, len(order)))
    names = " ".join(f"{axis}rotation" for axis in order)
    head = f"HIERARCHY\nROOT a\n{{\nOFFSET 0 1 0\nCHANNELS {len(order)} {names}\nEnd Site\n{{\nOFFSET 0 1.7 0\n}}\n}}\n"
    head += "MOTION\nFrames: 6\nFrame Time: 0.1\n"
    motion = read(tmp_path, head + "\n".join(" ".join(f"{x:.8f}" for x in row) for row in angles))
    want = Rotation.identity()
    for index, axis in enumerate(order):
        want = want * Rotation.from_rotvec(np.radians(angles[:, index, None]) * np.eye(3)["XYZ".index(axis)])
    assert same(motion.rotations[:, 0], want.as_matrix()) < 1e-3


@pytest.mark.parametrize(
    "changed",
    [
        SMALL.replace("\n", "\r\n"),
        SMALL.replace("  ", "\t"),
        "\ufeff\n" + SMALL,
        SMALL.replace("ROOT", "root")
        .replace("MOTION", "Motion")
        .replace("CHANNELS", "Channels")
        .replace("Zrotation", "ZROTATION"),
        SMALL + "\n\n  \n",
        SMALL + "this file was written by a trial version\n",
        SMALL.replace("90 0 0 0 0 0\n1", "9e1 +0 -0. .0 0 0 1"),
        SMALL.replace("hips\n{", "hips {").replace("}\n}\nMOTION", "} }\nMOTION"),
        SMALL.replace(
            "HIERARCHY\n",
            "HIERARCHY\nROOT prop\n{\nOFFSET 0 0 0\nCHANNELS 1 Xposition\nEnd Site\n{\nOFFSET 0 0 0\n}\n}\n",
        )
        .replace("\n1 2 3", "\n7 1 2 3")
        .replace("\n1 2 4", "\n7 1 2 4"),
    ],
)
def test_ways_to_write_the_same(tmp_path, changed):
    want, got = read(tmp_path, SMALL), read(tmp_path, changed)
    assert np.allclose(got.rotations, want.rotations, atol=1e-6) and np.allclose(
        got.world()[1], want.world()[1], atol=1e-6
    )
    assert got.skeleton.names == want.skeleton.names


def test_units_and_axes(tmp_path):
    truth = walk_about(10)
    text = bvh_text(truth, BLENDER)
    path = tmp_path / "take.bvh"
    path.write_text(text)
    assert load_motion(path).world()[1][..., 1].max() > 1.3  # it stands along +Y
    for unit, metres in (("m", 1), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254), ("dm", 0.1)):
        write_bvh(truth, path, unit=unit)
        assert np.linalg.norm(load_motion(path).skeleton.offsets[1]) == pytest.approx(
            np.linalg.norm(truth.skeleton.offsets[1]), rel=1e-3
        ), unit
        written = [float(word) for word in path.read_text().split("OFFSET")[2].split()[:3]]
        assert np.linalg.norm(written) == pytest.approx(np.linalg.norm(truth.skeleton.offsets[1]) / metres, rel=1e-3)


def test_hips_below_a_still_root_carry_the_path(tmp_path):
    truth = walk_about(30, still=("spine2",))
    motion = read(tmp_path, bvh_text(truth, DIALECTS["bandai-namco"]))
    assert motion.skeleton.names[0] == "Hips" and "joint_Root" not in motion.skeleton.names
    assert np.abs(motion.root_translation - truth.root_translation).max() < 1e-4
    zeros = read(tmp_path, bvh_text(truth, DIALECTS["rokoko"]))
    assert (
        np.linalg.norm(zeros.skeleton.offsets[1:], axis=-1) > 0.01
    ).all()  # zeros in the channels are not the offsets


@pytest.mark.parametrize(("up", "order", "unit"), [("+y", "zxy", "cm"), ("+z", "xyz", "m"), ("+y", "yzx", "in")])
def test_written_and_read_again(tmp_path, up, order, unit):
    rng = np.random.default_rng(3)
    truth = walk_about(2100, seed=4, size=1.5)
    rotations = truth.rotations.copy()
    rotations[:50] = Rotation.random(50 * 22, random_state=rng).as_matrix().reshape(50, 22, 3, 3)
    for index, angle in enumerate((90, -90)):  # where angles are not unique
        rotations[50 + index] = Rotation.from_euler("ZXY", [30, angle, 40], degrees=True).as_matrix()
    truth = SkeletalMotion(truth.skeleton, rotations, truth.root_translation, 120.0)
    path = write_bvh(truth, tmp_path / "again.bvh", up=up, order=order, unit=unit)
    motion = load_motion(path)
    index = [motion.skeleton.names.index(name) for name in JOINT_NAMES]
    turn = np.eye(3) if up == "+y" else Rotation.from_euler("x", 90, degrees=True).as_matrix()
    assert motion.fps == 120  # poses at random do not tell that +Z is up: they are read in the file's axes
    assert same(motion.rotations[:, index], (turn @ truth.rotations @ turn.T).astype(np.float32)) < 0.01
    assert np.abs(motion.root_translation - truth.root_translation @ turn.T).max() < 1e-5
    assert np.abs(motion.world()[1][:, index] - truth.world()[1] @ turn.T).max() < 1e-4


def test_angles_do_not_jump(tmp_path):
    spin = Rotation.from_rotvec(np.linspace(0, 20, 4100)[:, None] * [0, 0, 1.0]).as_matrix()[:, None]
    motion = SkeletalMotion(Skeleton(("a",), [-1], [[0, 0, 0]]), spin, np.zeros((4100, 3)), 60.0)
    text = write_bvh(motion, tmp_path / "spin.bvh").read_text().split("Frame Time")[1].splitlines()[1:]
    angles = np.array([[float(word) for word in line.split()[3:]] for line in text])
    assert np.abs(np.diff(angles, axis=0)).max() < 1
    assert len(write_bvh(motion, tmp_path / "slow.bvh", fps=30.0).read_text().splitlines()) < 2070


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("90 0 0", "nan 0 0", "frame 1 holds 'nan'|frame 1 holds values that are not numbers"),
        ("1 2 4", "1 inf 4", "frame 2 holds"),
        ("1 2 4", "1 -1.#IND 4", "frame 2 holds '-1.#IND'"),
        ("1 2 4", "1 2,5 4", "frame 2 holds '2,5'.*decimals need a point"),
        ("Frames: 2", "Frames:", "number of frames"),
        ("Frames: 2\n", "", "no 'Frames:'"),
        ("Frames: 2", "Frames: two", "number of frames"),
        ("Frames: 2", "Frames: 0", "0 frames"),
        ("Frames: 2", "Frames: -1", "-1 frames"),
        ("Frames: 2", "Frames: 4294967295", "cut off"),
        ("Frames: 2", "Frames: 3", "announces 3 frames of 9 numbers but is cut off"),
        ("0.04", "0", "frame time"),
        ("0.04", "nan", "frame time"),
        ("0.04", "", "not a number"),
        ("MOTION", "MOTIONS", "'MOTIONS' where it makes no sense"),
        ("0 -40 0", "0 nan 0", "offset of its joint 'knee'"),
        ("0 -40 0", "0 -40", "offset of its joint 'knee'"),
        ("JOINT knee", "JOINT hips", "'hips' is inside itself, a cycle"),
        ("CHANNELS 3", "CHANNELS 4", "announces 4 channels"),
        ("CHANNELS 6", "CHANNELS 2000000000", "announces"),
        ("Zrotation Xrotation Yrotation\n    End", "Wrotation\n    End", "announces 3 channels and names 0"),
        ("JOINT knee\n  {", "JOINT knee\n", "makes no sense|no braces"),
        ("    }\n  }\n}", "    }\n  }\n", "braces are open"),
        ("    }\n  }\n}", "    }\n  }\n}\n}", "makes no sense"),
        ("HIERARCHY", "HIERACHY", "does not begin with HIERARCHY"),
        ("CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n", "", "cut off|holds"),
        ("1 2 3 90", "1e30 2 3 90", "billion"),
    ],
)
def test_broken_files_get_one_sentence(tmp_path, old, new, match):
    assert old in SMALL
    text = SMALL.replace(old, new, 1)
    if "CHANNELS 6 X" in old:
        read(
            tmp_path, text.replace("0.04\n", "0.04\n0 0 0\n")
        )  # fewer channels, so more numbers than needed: that is no error
        return
    with pytest.raises(BunrakuError, match=match) as caught:
        read(tmp_path, text)
    assert "take.bvh: " in str(caught.value) and "\n" not in str(caught.value) and len(str(caught.value)) < 300


def test_deep_and_wide_hierarchies(tmp_path):
    deep = (
        "HIERARCHY\n"
        + "".join(f"{'JOINT' if j else 'ROOT'} j{j}\n{{\nOFFSET 0 1 0\nCHANNELS 1 Xrotation\n" for j in range(1500))
        + "}\n" * 1500
    )
    assert len(read(tmp_path, deep + "MOTION\nFrames: 1\nFrame Time: 0.1\n" + "1 " * 1500).skeleton.names) == 1500
    many = (
        "HIERARCHY\n"
        + "".join(f"{'JOINT' if j else 'ROOT'} j{j}\n{{\nOFFSET 0 1 0\nCHANNELS 1 Xrotation\n" for j in range(5000))
        + "}\n" * 5000
    )
    with pytest.raises(FormatError, match="more than 4096 joints"):
        read(tmp_path, many + "MOTION\nFrames: 1\nFrame Time: 0.1\n" + "1 " * 5000)


def test_a_text_file_of_1_gb_is_refused_unread(tmp_path):
    path = tmp_path / "novel.bvh"
    with path.open("wb") as file:
        file.write(b"It was a dark and stormy night. " * 100)
        file.truncate(1 << 30)
    tracemalloc.start()
    start = time.process_time()
    with pytest.raises(FormatError, match=r"novel\.bvh: 1024 MiB"):
        load_motion(path)
    assert time.process_time() - start < 2 and tracemalloc.get_traced_memory()[1] < 10 << 20
    tracemalloc.stop()


def test_memory_is_bounded_by_the_size_of_the_file(tmp_path):
    path = tmp_path / "long.bvh"
    path.write_text(SMALL.replace("Frames: 2", "Frames: 40000").split("1 2 3")[0] + "1 2 3 90 0 0 0 0 0\n" * 40_000)
    load_motion(path)
    tracemalloc.start()
    load_motion(path)
    assert tracemalloc.get_traced_memory()[1] < 25 * path.stat().st_size
    path.write_bytes(path.read_bytes()[:-5] + b"x\n")
    tracemalloc.reset_peak()
    with pytest.raises(FormatError, match="frame 40000 holds"):
        load_motion(path)
    assert tracemalloc.get_traced_memory()[1] < 25 * path.stat().st_size
    tracemalloc.stop()


def test_files_that_mean_harm_get_one_sentence(tmp_path):
    header = "HIERARCHY\nROOT r\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n%s}\nMOTION\nFrames: %d\nFrame Time: 0.1\n"
    with pytest.raises(FormatError, match="CHANNELS"):
        read(tmp_path, (header % ("", 1)).replace("CHANNELS 1", "CHANNELS " + "9" * 5000) + "0")
    start = time.process_time()
    with pytest.raises(FormatError, match="not a number"):
        read(tmp_path, header % ("", 1) + "1" * 100_000 + "x")
    assert time.process_time() - start < 5  # and not the square of the length
    with pytest.raises(FormatError, match="cut off"):
        read(tmp_path, header % ("", 1) + " \n \n")  # blanks are not a number
    twice = (
        "".join(f"JOINT a{'_2' * depth}\n{{\nOFFSET 0 1 0\n}}\n" for depth in range(1100))
        + "JOINT a\n{\nOFFSET 0 1 0\n}\n"
    )
    assert len(set(read(tmp_path, header % (twice, 1) + "0").skeleton.names)) == 1102
    still = "".join(
        f"JOINT j{joint}\n{{\nOFFSET 0 1 0\n}}\n" for joint in range(4000)
    )  # 29 GB of rotations, were they made
    with pytest.raises(FormatError, match="200,000 frames of 4,001 joints are too many"):
        read(tmp_path, header % (still, 200_000) + "0\n" * 200_000)
