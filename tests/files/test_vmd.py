"""Motions of MikuMikuDance: reading and writing VMD."""

import struct
from functools import partial

import hostile
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from bunraku.core.avatars import MMD_METRE
from bunraku.errors import FormatError
from bunraku.files.mmd.vmd import MmdClip, load_vmd, pack_vmd, write_vmd

LINEAR = ((20, 20, 107, 107),) * 4


def interpolation(curves):
    """64 bytes: x1 of the four channels, then y1, x2, y2; again from the second, third and fourth byte on; bytes 2 and
    3 overwritten.
    """
    row = bytes(curves[channel][point] for point in range(4) for channel in range(4))
    rows = [row[shift:] + bytes([1, 0, 0][:shift]) for shift in range(4)]
    rows[0] = rows[0][:2] + b"\0\0" + rows[0][4:]
    return b"".join(rows)


def bone(name, frame, position=(0, 0, 0), rotation=(0, 0, 0, 1), curves=LINEAR):
    return struct.pack("<15sI3f4f", name.encode("cp932")[:15], frame, *position, *rotation) + interpolation(curves)


def vmd(bones, morphs=(), switches=(), tail=True):
    data = (
        struct.pack("<30s20s", b"Vocaloid Motion Data 0002", "ジーン".encode("cp932"))
        + struct.pack("<I", len(bones))
        + b"".join(bones)
    )
    data += struct.pack("<I", len(morphs)) + b"".join(
        struct.pack("<15sIf", name.encode("cp932"), frame, 1.0) for name, frame in morphs
    )
    if tail:
        data += struct.pack("<I", 1) + bytes(61) + struct.pack("<I", 1) + bytes(28) + struct.pack("<I", 0)
        data += struct.pack("<I", len(switches))
        for frame, states in switches:
            data += struct.pack("<IBI", frame, 1, len(states))
            data += b"".join(struct.pack("<20sB", name.encode("cp932"), on) for name, on in states.items())
    return data


def load(tmp_path, data):
    (tmp_path / "take.vmd").write_bytes(data)
    return load_vmd(tmp_path / "take.vmd")


def on_curve(share, x1, y1, x2, y2):
    """y at x = share of a cubic Bezier curve from (0, 0) to (1, 1)."""
    s = brentq(lambda s: 3 * (1 - s) ** 2 * s * x1 + 3 * (1 - s) * s * s * x2 + s**3 - share, 0, 1, xtol=1e-14)
    return 3 * (1 - s) ** 2 * s * y1 + 3 * (1 - s) * s * s * y2 + s**3


def test_keys_curves_and_names(tmp_path):
    curves = ((64, 0, 64, 127), (10, 90, 30, 120), (127, 0, 127, 0), (100, 10, 120, 40))
    turn = Rotation.from_rotvec([0.3, -0.7, 0.5])
    motion = load(
        tmp_path,
        vmd(
            [bone("センター", 20, (1, 2, 3), turn.as_quat(), curves), bone("左ひじ", 5), bone("センター", 0)],
            morphs=[("まばたき", 0), ("まばたき", 3), ("あ", 1)],
            switches=[(10, {"左足ＩＫ": False}), (0, {"左足ＩＫ": True, "右足ＩＫ": False})],
        ),
    )
    assert motion.model == "ジーン" and set(motion.bones) == {"センター", "左ひじ"}
    assert motion.morphs == {"まばたき": 2, "あ": 1} and motion.last_frame == 20
    assert motion.switches == ((0, {"左足ＩＫ": True, "右足ＩＫ": False}), (10, {"左足ＩＫ": False}))
    positions, rotations = motion.sample()["センター"]
    assert positions.shape == (21, 3)
    for frame in range(21):
        x, y, z, r = (on_curve(frame / 20, *(np.array(curve) / 127)) for curve in curves)
        assert np.allclose(positions[frame], np.array([x, 2 * y, -3 * z]) * MMD_METRE, atol=1e-6)
        want = Rotation.from_rotvec(np.array([-0.3, 0.7, 0.5]) * r)  # seen in the mirror that turns z round
        assert np.degrees((Rotation.from_matrix(rotations[frame]).inv() * want).magnitude()) < 1e-4


def test_other_rates_and_held_ends(tmp_path):
    motion = load(
        tmp_path, vmd([bone("頭", 10, (0, 0, 0)), bone("頭", 40, (3, 0, 0)), bone("首", 70, (1, 0, 0))], tail=False)
    )
    positions, _ = motion.sample(60.0)["頭"]
    assert len(positions) == 141
    assert np.allclose(positions[[0, 20, 50, 80, 140], 0], np.array([0, 0, 1.5, 3, 3]) * MMD_METRE)
    assert np.allclose(motion.sample()["首"][0], [MMD_METRE, 0, 0])


def test_broken_files_get_one_sentence(tmp_path):
    good = vmd([bone("頭", 0), bone("頭", 9)], morphs=[("あ", 1)], switches=[(0, {"左足ＩＫ": False})])

    refused = partial(hostile.refused, tmp_path / "take.vmd", read=load_vmd, errors=FormatError)

    refused(b"MMD Motion" + good, "not a VMD file")
    refused(good[:50] + b"\xff\xff\xff\xff" + good[54:], "announces 4294967295 bone keys but has room for 3")
    refused(good[:52], "cut off in its bone keys")
    refused(good[:150], "announces 2 bone keys")
    end = good.index(struct.pack("<IBI", 0, 1, 1), 300)
    refused(good[: end + 5] + b"\xff\xff\xff\xff" + good[end + 9 :], "announces 4294967295 inverse kinematics bones")
    refused(good[:end] + struct.pack("<IBI", 0, 1, 1), "announces 1 inverse kinematics bones but has room for 0")
    refused(good[: end - 4] + b"\xff\xff\xff\xff" + good[end:], "announces 4294967295 inverse kinematics keys")
    refused(vmd([bone("頭", 0, (np.nan, 0, 0))]), "not numbers")
    refused(vmd([bone("頭", 0, rotation=(np.inf, 0, 0, 1))]), "not numbers")
    refused(vmd([bone("頭", 4_000_000_000)]), "frame 4000000000, hours")
    copies = hostile.damaged(good, 300, cut=1)
    hostile.outcomes(tmp_path / "take.vmd", copies, lambda path: load_vmd(path).sample())


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
