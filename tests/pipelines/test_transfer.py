"""`bunraku.transfer`: every kind of motion onto handles and onto rigs."""

import json

import numpy as np
import pytest

import bunraku
from bunraku.body.layout import JOINT_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.mesh_motion import MeshMotion
from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.formats.bvh.write import write_bvh
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.io.mesh_folder import load_mesh_motion
from bunraku.io.motions import load_motion
from bunraku.pipelines.to_reference import reference_motion
from bunraku.retarget.fit import Stages

_J = {name: joint for joint, name in enumerate(JOINT_NAMES)}
CARRIED = Stages(ground=False, feet=False, smooth=False, floor=False)


def waving(frames=12, fps=20.0):
    body = reference_body()
    turns = np.zeros((frames, 22, 3))
    turns[:, _J["left_shoulder"], 2] = np.linspace(-1.2, 0.8, frames)
    turns[:, _J["right_shoulder"], 2] = 1.2
    turns[:, _J["left_elbow"], 2] = 0.5
    return SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), np.tile(body.joints[0], (frames, 1)), fps)


@pytest.fixture(scope="module")
def person():
    return reference_body().character()


def test_onto_the_rig_and_onto_handles(person):
    motion, handles = waving(), reference_body().handles
    on_rig = bunraku.transfer(person, motion)
    on_handles = bunraku.transfer(person, motion, handles=handles)
    assert isinstance(on_rig, bunraku.RigAnimation) and isinstance(on_handles, bunraku.Animation)
    assert on_rig.reference is not None and on_handles.reference is not None
    error = np.linalg.norm(on_rig.vertices() - on_handles.vertices(), axis=-1)
    assert error.mean() < 0.01 * person.height  # the same joints, skinned by other weights


def test_rates(person):
    assert len(bunraku.transfer(person, waving(41, 40.0), fps=20)) == 21
    assert bunraku.transfer(person, waving(41, 40.0), fps=40).fps == 40


def test_bad_options(person):
    with pytest.raises(bunraku.OptionError, match="'handles', 'rig' or 'auto'"):
        bunraku.transfer(person, waving(), onto="bones")
    with pytest.raises(bunraku.OptionError, match="1 to 240"):
        bunraku.transfer(person, waving(), fps=0)
    with pytest.raises(bunraku.CharacterError, match="no rig"):
        bunraku.transfer(bunraku.Character("bare", person.vertices, person.faces), waving(), onto="rig")


def test_names_settle_what_no_rule_knows(person):
    motion = waving()
    own = Skeleton(tuple(f"j{number:02d}" for number in range(22)), motion.skeleton.parents, motion.skeleton.offsets)
    nameless = SkeletalMotion(own, motion.rotations, motion.root_translation, motion.fps)
    names = dict(zip(JOINT_NAMES, own.names, strict=True))
    want, have = (bunraku.transfer(person, some, names=known) for some, known in ((motion, None), (nameless, names)))
    assert np.abs(want.vertices() - have.vertices()).max() < 1e-4
    with pytest.raises(bunraku.MotionError, match="is no joint"):
        bunraku.transfer(person, motion, names={"left_hip": "nowhere"})


def test_a_clip_of_the_same_skeleton_is_copied(person, tmp_path):
    path = bunraku.transfer(person, waving()).save(tmp_path / "clip.glb")
    character = bunraku.load_character(path)
    clip = load_motion(path)
    again = bunraku.transfer(character, path)
    assert isinstance(again, bunraku.RigAnimation)
    assert np.abs(again.vertices() - clip.vertices()).max() < 1e-5


def test_the_clip_of_a_rig_goes_onto_handles(person, tmp_path):
    moved = bunraku.transfer(person, waving(), stages=CARRIED)
    path = moved.save(tmp_path / "clip.glb")
    result = bunraku.transfer(person, path, onto="handles", handles=reference_body().handles, stages=CARRIED)
    assert np.linalg.norm(result.vertices() - moved.vertices(), axis=-1).mean() < 0.01 * person.height


def test_what_bunraku_wrote_is_read_by_its_reference(person, tmp_path):
    animation = bunraku.transfer(person, waving(), handles=reference_body().handles)
    for name in ("own.npz", "own.glb"):
        found = load_motion(animation.save(tmp_path / name))
        assert np.abs(found.rotations - animation.reference.rotations).max() < 1e-5


def test_a_moving_mesh(person, tmp_path):
    truth = bunraku.transfer(person, waving(6), handles=reference_body().handles, stages=CARRIED, fps=20.0)
    folder = truth.save(tmp_path / "frames.ply")
    moving = load_mesh_motion(folder)
    assert len(moving) == 6 and np.abs(moving.vertices - truth.vertices()).max() < 1e-5
    rest = MeshMotion(np.concatenate([person.vertices[None], moving.vertices]), moving.faces)
    result = bunraku.transfer(person, rest, handles=reference_body().handles, stages=CARRIED, fps=20.0)
    error = np.linalg.norm(result.vertices()[1:] - truth.vertices(), axis=-1).mean()
    moved = np.linalg.norm(person.vertices - truth.vertices(), axis=-1).mean()
    assert error < 0.25 * moved  # handles are predicted, so joints are not exact


def test_bad_meshes(person, tmp_path):
    with pytest.raises(bunraku.MotionError, match="frames, vertices, 3"):
        MeshMotion(person.vertices, person.faces)
    (tmp_path / "empty").mkdir()
    with pytest.raises(bunraku.FormatError, match="no .obj or .ply"):
        load_mesh_motion(tmp_path / "empty")
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "b.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    with pytest.raises(bunraku.FormatError, match="other triangles"):
        load_mesh_motion(tmp_path)


def test_on_the_spot():
    from bunraku.retarget.treadmill import is_treadmill

    body, frames = reference_body(), 60
    phase = np.linspace(0, 6 * np.pi, frames)
    turns = np.zeros((frames, 22, 3))
    for side, sign in (("left", 1), ("right", -1)):
        turns[:, _J[f"{side}_hip"], 0] = -0.45 * sign * np.sin(phase)
        turns[:, _J[f"{side}_knee"], 0] = np.maximum(0.9 * sign * np.cos(phase), 0)
    still = np.tile(body.joints[0], (frames, 1))
    walking = SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), still, 20.0)
    assert is_treadmill(reference_motion(walking))
    assert not is_treadmill(reference_motion(waving(60)))


def test_files_of_skeletons(person, tmp_path):
    path = write_bvh(waving(), tmp_path / "wave.bvh")
    by_file, by_motion = bunraku.transfer(person, path), bunraku.transfer(person, waving())
    assert np.abs(by_file.vertices() - by_motion.vertices()).max() < 1e-3
    (tmp_path / "names.json").write_text(json.dumps({}))
    with pytest.raises(bunraku.FormatError):
        bunraku.transfer(person, tmp_path / "names.json")
