"""VMD written and read again by our reader, whose bytes are tested on their own."""

import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.errors import FormatError
from bunraku.formats.mmd.vmd import load_vmd
from bunraku.formats.mmd.vmd_write import MmdClip, pack_vmd, write_vmd


def clip(frames=50, seed=0):
    rng = np.random.default_rng(seed)
    steps = Rotation.from_rotvec(rng.normal(0, 0.3, (frames, 3)))
    turns = [steps[0]]
    for step in steps[1:]:
        turns.append(turns[-1] * step)
    rotations = np.stack([turn.as_matrix() for turn in turns])
    still = np.broadcast_to(Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix(), (frames, 3, 3))
    bones = {
        "センター": (np.cumsum(rng.normal(0, 0.05, (frames, 3)), axis=0), rotations),
        "左腕": (np.zeros((frames, 3)), still),
    }
    return MmdClip(bones, "ジーン", ("左足ＩＫ", "右足ＩＫ"))


def test_written_and_read_again(tmp_path):
    wanted = clip()
    motion = load_vmd(write_vmd(wanted, tmp_path / "out.vmd"))
    assert motion.model == "ジーン" and motion.last_frame == 49 and not motion.morphs
    for name, (positions, rotations) in motion.sample().items():
        assert np.abs(positions - wanted.bones[name][0][: len(positions)]).max() < 1e-5
        error = Rotation.from_matrix(rotations).inv() * Rotation.from_matrix(wanted.bones[name][1])
        assert np.degrees(error.magnitude()).max() < 0.01
    assert len(motion.bones["左腕"].frames) == 1  # it stands still
    assert motion.switches == ((0, {"左足ＩＫ": False, "右足ＩＫ": False}),)


def test_between_frames_the_way_is_straight(tmp_path):
    positions = np.array([[0.0, 0, 0], [0.3, 0, 0]])
    turns = Rotation.from_rotvec([[0, 0, 0], [0, 1.0, 0]]).as_matrix()
    motion = load_vmd(write_vmd(MmdClip({"頭": (positions, turns)}), tmp_path / "out.vmd"))
    moved, turned = motion.bones["頭"].sample(np.array([0.25]))
    assert np.allclose(moved, [[0.075, 0, 0]], atol=1e-6) and np.allclose(
        turned[0], Rotation.from_rotvec([0, 0.25, 0]).as_matrix(), atol=1e-6
    )


def test_the_bytes(tmp_path):
    """One key, byte by byte: names in fixed fields, MMD's frame and unit, a straight curve in every row."""
    turn = Rotation.from_rotvec([0.2, 0, 0])
    data = pack_vmd(MmdClip({"左ひじ": (np.array([[0.08, 0.16, 0.24]]), turn.as_matrix()[None])}, "m"))
    assert (
        data.startswith(b"Vocaloid Motion Data 0002\0")
        and data[30:32] == b"m\0"
        and struct.unpack_from("<I", data, 50) == (1,)
    )
    name, frame, *numbers = struct.unpack_from("<15sI7f", data, 54)
    assert name.rstrip(b"\0").decode("cp932") == "左ひじ" and frame == 0
    assert np.allclose(numbers, [1, 2, -3, -np.sin(0.1), 0, 0, np.cos(0.1)], atol=1e-6)
    assert data[101:117] == bytes([20] * 8 + [107] * 8) and len(data) == 54 + 111 + 16 + 4 + 9


def test_signs_of_quaternions_never_jump(tmp_path):
    turns = Rotation.from_rotvec(np.linspace(0, 4 * np.pi, 60)[:, None] * [0, 1.0, 0]).as_matrix()
    motion = load_vmd(write_vmd(MmdClip({"頭": (np.zeros((60, 3)), turns)}), tmp_path / "out.vmd"))
    rotations = motion.bones["頭"].rotations
    assert ((rotations[1:] * rotations[:-1]).sum(-1) > 0).all()


def test_names_that_vmd_cannot_hold(tmp_path):
    with pytest.raises(FormatError, match="a name that VMD cannot hold"):
        write_vmd(MmdClip({"🦊": (np.zeros((1, 3)), np.eye(3)[None])}), tmp_path / "out.vmd")
    assert not list(tmp_path.iterdir())
    assert load_vmd(write_vmd(MmdClip({}), tmp_path / "empty.vmd")).bones == {}
