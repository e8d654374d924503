"""AMASS: small files with the arrays, shapes and types of the real ones."""

import io
import zipfile

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.body.layout import JOINT_NAMES
from bunraku.body.reference import reference_body
from bunraku.body.smpl_rest import smpl_offsets, smpl_rotations
from bunraku.errors import BunrakuError, FormatError, MotionError
from bunraku.io.motions import load_motion

UPRIGHT = [np.pi / 2, 0, 0]  # turns SMPL's +Y up into the +Z up of AMASS


def amass(frames=8, columns=156, rate="mocap_framerate", **changes):
    arrays = {
        "trans": np.tile([0.0, 0, 0.95], (frames, 1)), "gender": np.array("female"), rate: np.array(120.0),
        "betas": np.zeros(16),
        "dmpls": np.zeros((frames, 8)), "poses": np.zeros((frames, columns)),
    }  # fmt: skip
    arrays["poses"][:, :3] = UPRIGHT
    arrays |= changes
    return {name: array for name, array in arrays.items() if array is not None}


def save(path, **changes):
    np.savez(path, **amass(**changes))
    return path


@pytest.mark.parametrize(
    ("columns", "rate"), [(156, "mocap_framerate"), (165, "mocap_frame_rate"), (66, "mocap_framerate")]
)
def test_standing_facing_minus_y_of_amass(tmp_path, columns, rate):
    """The T-pose of a person that AMASS turned upright only: it faces -Y there, which is +Z here."""
    motion = load_motion(save(tmp_path / "stand.npz", columns=columns, rate=rate))
    assert motion.skeleton.names == JOINT_NAMES and motion.fps == 120 and len(motion) == 8
    positions = motion.world()[1]
    assert np.allclose(motion.root_translation, [0, 0.95, 0], atol=1e-6)
    left, right = (JOINT_NAMES.index(f"{side}_wrist") for side in ("left", "right"))
    assert positions[0, left, 0] > 0.5 and positions[0, right, 0] < -0.5
    assert (positions[0, [10, 11], 2] > 0.1).all()  # toes before the heels
    assert positions[0, JOINT_NAMES.index("head"), 1] > 1.4


def test_limbs_point_where_smpl_has_them(tmp_path):
    """Against a skeleton of SMPL's own proportions posed by scipy: every limb has the same direction."""
    rng = np.random.default_rng(0)
    poses = rng.normal(0, 0.4, (5, 156))
    motion = load_motion(save(tmp_path / "m.npz", frames=5, poses=poses))
    offsets, parents = smpl_offsets(), motion.skeleton.parents
    world = [Rotation.from_rotvec(poses[:, :3])]
    for joint in range(1, 22):
        world.append(world[parents[joint]] * Rotation.from_rotvec(poses[:, 3 * joint : 3 * joint + 3]))
    got = motion.world()[1]
    for parent, child in ((1, 4), (2, 5), (4, 7), (5, 8), (16, 18), (17, 19), (18, 20), (19, 21)):
        x, y, z = world[parent].apply(offsets[child]).T
        want = np.stack([x, z, -y], -1)
        bone = got[:, child] - got[:, parent]
        cosine = (bone * want).sum(-1) / np.linalg.norm(bone, axis=-1) / np.linalg.norm(want, axis=-1)
        assert cosine.min() > 1 - 1e-5


def test_turns_between_the_t_poses_are_small():
    turns = smpl_rotations()
    assert np.degrees(Rotation.from_matrix(turns).magnitude()).max() < 10
    assert np.allclose(turns[[0, 3, 6, 9, 12, 15]], np.eye(3))


@pytest.mark.parametrize("size", [0.85, 1.0, 1.1])
def test_the_skeleton_takes_the_size_of_the_person(tmp_path, size):
    hip = reference_body().joints[0, 1]
    trans = np.tile([0, 0, hip * size], (8, 1))
    motion = load_motion(save(tmp_path / "m.npz", trans=trans))
    ratio = np.linalg.norm(motion.skeleton.offsets[4]) / np.linalg.norm(reference_body().skeleton.offsets[4])
    assert ratio == pytest.approx(size, abs=0.02)  # SMPL's legs stand a little apart
    floating = load_motion(save(tmp_path / "m.npz", trans=trans + [0, 0, 5]))
    assert np.allclose(floating.skeleton.offsets, reference_body().skeleton.offsets)


def test_split_poses(tmp_path):
    whole = amass()
    parts = {"root_orient": whole["poses"][:, :3], "pose_body": whole["poses"][:, 3:66]}
    motion = load_motion(save(tmp_path / "m.npz", poses=None, **parts))
    assert np.allclose(motion.rotations, load_motion(save(tmp_path / "n.npz")).rotations)


def test_files_that_are_broken_or_mean_harm(tmp_path):
    path = tmp_path / "bad.npz"

    def refused(match, **changes):
        with pytest.raises((FormatError, MotionError), match=rf"bad\.npz: .*{match}") as caught:
            load_motion(save(path, **changes))
        assert "\n" not in str(caught.value)

    class Bomb:
        def __reduce__(self):
            return (pytest.fail, ("a pickle was loaded",))

    refused("'poses' holds pickled objects", poses=np.array([Bomb()], dtype=object))
    refused("'gender' holds pickled objects", gender=np.array([Bomb()], dtype=object))
    refused("lacks poses, trans or mocap_framerate", mocap_framerate=None)
    refused("lacks poses", trans=None)
    refused("not \\(N, 66 or more\\)", poses=np.zeros((8, 60)))
    refused("not \\(N, 66 or more\\)", trans=np.zeros((7, 3)))
    refused("row for each frame", poses=np.zeros(156))
    refused("row for each frame", poses=np.zeros((0, 156)))
    refused("one number", mocap_framerate=np.array(np.nan))
    refused("one number", mocap_framerate=np.zeros(2))
    refused("not numbers", trans=np.full((8, 3), np.nan))
    refused("not numbers", poses=np.full((8, 156), np.inf))
    refused("not plain numbers", poses=np.array(["a"]))
    whole = save(path).read_bytes()
    for length in range(1, len(whole), len(whole) // 30):
        path.write_bytes(whole[:length])
        with pytest.raises(BunrakuError, match=r"bad\.npz"):
            load_motion(path)


def test_days_of_frames_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("bunraku.formats.arrays.amass.MOST_FRAMES", 7)
    with pytest.raises(FormatError, match="its 8 frames are too many"):
        load_motion(save(tmp_path / "long.npz"))


def test_a_zip_bomb_is_refused_unpacked(tmp_path):
    path = tmp_path / "bomb.npz"
    arrays = amass()
    del arrays["poses"]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            packed = io.BytesIO()
            np.save(packed, array)
            archive.writestr(f"{name}.npy", packed.getvalue())
        header = io.BytesIO()
        np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (40_000, 156)})
        archive.writestr("poses.npy", header.getvalue() + bytes(40_000 * 156 * 8))
    assert path.stat().st_size < 100_000
    with pytest.raises(FormatError, match=r"bomb\.npz: its array 'poses' unpacks to \d+ times"):
        load_motion(path)
