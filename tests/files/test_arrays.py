"""Motions in arrays: NPZ and NPY, AMASS, HumanML3D."""

import io
import zipfile
from dataclasses import replace
from functools import partial

import hostile
import numpy as np
import pytest
from gltf_files import CUBE, CUBE_FACES, made_up_handles, made_up_motion
from motion_files import about_y, humanml3d_vectors, walk_about
from scipy.spatial.transform import Rotation

from bunraku.core.animation import Animation
from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.body.reference import reference_body, smpl_offsets
from bunraku.core.character import Character
from bunraku.errors import BunrakuError, FormatError, MotionError
from bunraku.files.registry import read_motion
from bunraku.pipelines.to_reference import load_motion


@pytest.fixture
def animation():
    cube = Character("cube", CUBE, CUBE_FACES)
    return Animation(cube, made_up_handles(cube), made_up_motion(cube))


def test_there_and_back(animation, tmp_path):
    path = animation.save(tmp_path / "motion.npz")
    motion = read_motion(path)
    for name in ("translations", "rotations", "root_translation", "root_rotation"):
        assert np.allclose(getattr(motion, name), getattr(animation.motion, name), atol=1e-6)
    assert motion.fps == animation.motion.fps
    with np.load(path, allow_pickle=False) as plain:
        assert plain["rotations"].shape == (24, 30, 3, 3) and plain["handle_names"][0] == "pelvis"
        assert np.array_equal(plain["handle_positions"], animation.handles.positions)


def test_matrices_are_read_too(animation, tmp_path):
    motion = animation.motion
    parts = {name: getattr(motion, name) for name in (*motion.arrays, "fps")}
    np.savez(tmp_path / "m.npz", **parts)
    assert np.array_equal(read_motion(tmp_path / "m.npz").rotations, motion.rotations)


def test_broken_and_hostile_files(animation, tmp_path):
    whole, path = animation.save(tmp_path / "good.npz").read_bytes(), tmp_path / "bad.npz"

    refused = partial(hostile.refused, path, read=read_motion, errors=(FormatError, MotionError))
    for length in range(1, len(whole), len(whole) // 40):
        refused(whole[:length], "bad.npz: ")
    motion = animation.motion
    parts = {name: getattr(motion, name) for name in (*motion.arrays, "fps")}

    def packed(**changes):
        out = io.BytesIO()
        np.savez(out, **{**parts, **changes}, allow_pickle=True)
        return out.getvalue()

    refused(packed(fps=np.array([object()])), "not plain numbers")
    refused(packed(rotations=np.zeros((24, 30, 4))), "6D or 3 x 3")
    refused(packed(translations=np.full((24, 30, 3), np.nan)), "not numbers")
    refused(packed(fps=0), "from 1 to 1000")
    refused(packed(fps=np.ones(2)), "one number")
    refused(packed(root_translation=np.zeros((23, 3))), "shape")
    out = io.BytesIO()
    np.savez(out, a=1)
    refused(out.getvalue(), "lacks translations")
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in parts:
            header = io.BytesIO()
            np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (10**9, 3)})
            archive.writestr(f"{name}.npy", header.getvalue() + bytes(100))
    refused(out.getvalue(), "cut short")


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [("fps", np.inf, "fps"), ("fps", 1e-6, "fps"), ("fps", np.nan, "fps"), ("rotations", None, "handle 0")],
)
def test_numbers_that_make_no_motion_name_the_file(animation, tmp_path, name, value, match):
    with np.load(animation.save(tmp_path / "good.npz"), allow_pickle=False) as good:
        parts = dict(good)
    parts[name] = np.zeros_like(parts[name]) if value is None else np.float32(value)
    np.savez(tmp_path / "odd.npz", **parts)
    with pytest.raises((FormatError, MotionError), match=f"odd.npz.*{match}"):
        read_motion(tmp_path / "odd.npz")


def test_only_what_numpy_packs_is_unpacked(animation, tmp_path):
    with (
        zipfile.ZipFile(animation.save(tmp_path / "good.npz")) as good,
        zipfile.ZipFile(tmp_path / "bad.npz", "w", zipfile.ZIP_BZIP2) as bad,
    ):
        for name in good.namelist():
            bad.writestr(name, good.read(name))
    with pytest.raises(FormatError, match=r"bad\.npz"):
        read_motion(tmp_path / "bad.npz")


def test_what_body_a_motion_was_made_for_is_kept_and_older_files_say_all_of_it_by_one_name(animation, tmp_path):
    path = replace(animation, motion=replace(animation.motion, own_height=True)).save(tmp_path / "own.npz")
    found = read_motion(path)
    assert (found.own_kind, found.own_height, found.soft) == (False, True, False)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files if name not in ("own_kind", "own_height", "soft")}
    for value in (0.0, 1.0):
        np.savez(path, **arrays, native=np.float32(value))
        found = read_motion(path)
        assert (found.own_kind, found.own_height, found.soft) == (bool(value),) * 3


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
    monkeypatch.setattr("bunraku.files.motions.arrays.MOST_FRAMES", 7)
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


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_vectors_give_back_the_joints(tmp_path, seed):
    positions = walk_about(81, seed=seed).world()[1]
    vectors, heading = humanml3d_vectors(positions)
    assert vectors.shape == (80, 263)
    np.save(tmp_path / "000001.npy", vectors)
    motion = load_motion(tmp_path / "000001.npy")
    assert motion.skeleton.names == JOINT_NAMES and motion.fps == 20 and len(motion) == 80
    start = positions[0, 0] * [1, 0, 1]  # vectors forget where the motion began and which way it faced
    want = about_y(-heading).apply((positions[:-1] - start).reshape(-1, 3)).reshape(80, 22, 3)
    assert np.abs(motion.world()[1] - want).max() < 1e-4


def test_positions_are_read_as_they_are(tmp_path):
    positions = walk_about(30).world()[1]
    np.save(tmp_path / "000002.npy", positions)
    assert np.abs(load_motion(tmp_path / "000002.npy").world()[1] - positions).max() < 1e-4


def test_humanml3d_files_that_are_broken_or_mean_harm(tmp_path):
    path = tmp_path / "bad.npy"

    def refused(array, match, **options):
        np.save(path, array, **options)
        with pytest.raises((FormatError, MotionError), match=rf"bad\.npy: .*{match}"):
            load_motion(path)

    refused(np.zeros((4, 262)), r"shape \(N, 263\)")
    refused(np.zeros((0, 263)), "shape")
    refused(np.zeros(263), "shape")
    refused(np.full((4, 263), np.nan), "not numbers")
    refused(np.full((4, 22, 3), np.inf), "not numbers")
    refused(np.array([{"a": 1}], dtype=object), "pickled objects", allow_pickle=True)
    refused(np.array(["a", "b"]), "not plain numbers")
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (10**12, 263)})
    path.write_bytes(header.getvalue() + bytes(100))
    with pytest.raises(FormatError, match="cut short"):
        load_motion(path)
    np.save(path, np.zeros((4, 22, 3), np.float32))
    whole = path.read_bytes()
    for length in range(1, len(whole), 37):
        path.write_bytes(whole[:length])
        with pytest.raises(BunrakuError, match=r"bad\.npy"):
            load_motion(path)
