"""Skeletons of many conventions become SMPL's joints, and their motions move alike."""

import numpy as np
import pytest
from bvh_files import ALONG_X, CMU, DIALECTS, bvh_text
from motion_files import walk_about
from scipy.spatial.transform import Rotation

from bunraku.body.layout import JOINT_NAMES
from bunraku.core.motion import SkeletalMotion, Skeleton
from bunraku.errors import MotionError
from bunraku.io.motions import load_motion
from bunraku.skeletons.skeleton_map import map_skeleton
from bunraku.skeletons.to_smpl import rest_is_a_pose, to_smpl

LIMBS = ((1, 4), (2, 5), (4, 7), (5, 8), (16, 18), (17, 19), (18, 20), (19, 21))


def degrees(rotations):
    return np.degrees(Rotation.from_matrix(np.asarray(rotations, float).reshape(-1, 3, 3)).magnitude()).reshape(
        rotations.shape[:-2]
    )


@pytest.mark.parametrize("dialect", DIALECTS, ids=str)
def test_every_dialect_moves_alike(tmp_path, dialect):
    how = DIALECTS[dialect]
    truth = walk_about(90, fps=how.rate, still=set(JOINT_NAMES) - {joint for _, _, joint, _ in how.joints})
    path = tmp_path / "take.bvh"
    path.write_text(bvh_text(truth, how))
    motion = load_motion(path)
    assert motion.fps == pytest.approx(how.rate, rel=1e-3)
    found = map_skeleton(motion.skeleton)
    assert found.convention == how.convention
    want = {joint: name for name, _, joint, share in how.joints if share == 1.0 and joint is not None}
    for name, index in zip(JOINT_NAMES, found.joints, strict=True):
        if name in want and "HeadTop" not in want[name]:
            assert index >= 0 and motion.skeleton.names[index].replace(" Pelvis", "") == want[name], (name, found)
        elif name not in want:
            assert index < 0, (name, found)
    result = to_smpl(motion, found)
    assert result.skeleton.names == JOINT_NAMES and len(result) == 90
    ours, theirs = result.world(), truth.world()
    known = [index for index, name in enumerate(JOINT_NAMES) if found.joints[index] >= 0]
    direct = [index for index in known if index == 0 or found.joints[truth.skeleton.parents[index]] >= 0]
    assert np.abs(ours[1][:, direct] - theirs[1][:, direct]).max() < 1e-3
    if how.rest == "X":
        for parent, child in LIMBS:
            bones = [positions[:, child] - positions[:, parent] for positions in (ours[1], theirs[1])]
            assert np.abs(bones[0] - bones[1]).max() < 1e-3
        turned = degrees(np.swapaxes(ours[0], -1, -2) @ theirs[0]).mean(axis=0)
        assert turned[0] < 3 and turned[9] < 10  # limbs bend at random here, so their roll is not known
    else:
        turned = degrees(np.swapaxes(ours[0][:, known], -1, -2) @ theirs[0][:, known]).max(axis=0)
        assert turned.max() < 0.05, dict(zip(np.array(JOINT_NAMES)[known], turned.round(2), strict=True))


def test_elbows_and_knees_say_how_limbs_are_rolled(tmp_path):
    """All bones along one axis: the rest pose says nothing, the way that hinges bend does."""
    time = np.linspace(0, 6, 60)
    bends = np.zeros((60, 22, 3))
    swing = 0.5 * np.sin(2 * time)
    for side, sign in (("left", 1), ("right", -1)):
        hip, knee, shoulder, elbow = (
            JOINT_NAMES.index(f"{side}_{part}") for part in ("hip", "knee", "shoulder", "elbow")
        )
        bends[:, hip, 0], bends[:, knee, 0] = sign * swing, 0.6 + sign * swing
        bends[:, shoulder, 2], bends[:, elbow, 1] = -sign * (1.0 + 0.2 * swing), -sign * (0.8 + swing)
    truth = walk_about(60, fps=30.0)
    rotations = Rotation.from_rotvec(bends.reshape(-1, 3)).as_matrix().reshape(60, 22, 3, 3)
    truth = SkeletalMotion(truth.skeleton, rotations, truth.root_translation, 30.0)
    (tmp_path / "take.bvh").write_text(bvh_text(truth, ALONG_X))
    result = to_smpl(load_motion(tmp_path / "take.bvh"))
    turned = degrees(np.swapaxes(result.world()[0], -1, -2) @ truth.world()[0]).max(axis=0)
    for name, angle in zip(JOINT_NAMES, turned, strict=True):
        if any(part in name for part in ("pelvis", "hip", "knee", "shoulder", "elbow", "spine")):
            assert angle < 0.5, (name, angle)


def test_whether_a_rest_pose_is_one(tmp_path):
    for dialect, pose in ((ALONG_X, False), (CMU, True)):
        (tmp_path / "take.bvh").write_text(bvh_text(walk_about(5), dialect))
        skeleton = load_motion(tmp_path / "take.bvh").skeleton
        assert rest_is_a_pose(skeleton, map_skeleton(skeleton)) is pose


def test_names_that_are_given_win():
    skeleton = Skeleton(
        ("base", "x", "x2", "x3", "y", "y2", "y3", "back", "top"),
        [-1, 0, 1, 2, 0, 4, 5, 0, 7],
        [
            [0, 0, 0],
            [0.1, 0, 0],
            [0, -0.4, 0],
            [0, -0.4, 0],
            [-0.1, 0, 0],
            [0, -0.4, 0],
            [0, -0.4, 0],
            [0, 0.3, 0],
            [0, 0.3, 0],
        ],
    )
    names = {
        "pelvis": "base",
        "left_hip": "x",
        "left_knee": "x2",
        "right_hip": "y",
        "right_knee": "y2",
        "head": "top",
        "neck": "",
    }
    found = map_skeleton(skeleton, names)
    assert found.of("left_knee") == 2 and found.of("head") == 8 and found.of("neck") == -1
    assert found.how[JOINT_NAMES.index("left_hip")] == "given" and "left_wrist" in found.missing
    with pytest.raises(MotionError, match="'nose' in the map of names is no joint; there are base, x"):
        map_skeleton(skeleton, {"head": "nose"})
    with pytest.raises(MotionError, match="'snout' in the map"):
        map_skeleton(skeleton, {"snout": "top"})


def test_a_skeleton_without_legs_says_what_is_missing():
    skeleton = Skeleton(("trunk", "leaf"), [-1, 0], [[0, 0, 0], [0, 1, 0]])
    with pytest.raises(MotionError, match="pelvis, left_hip, right_hip"):
        map_skeleton(skeleton)


def test_missing_parts_stay_straight_and_have_lengths(tmp_path):
    (tmp_path / "take.bvh").write_text(bvh_text(walk_about(20), DIALECTS["daz"]))
    result = to_smpl(load_motion(tmp_path / "take.bvh"))
    for name in ("spine2", "left_foot", "right_foot"):
        assert np.allclose(result.rotations[:, JOINT_NAMES.index(name)], np.eye(3), atol=1e-5)
    assert (np.linalg.norm(result.skeleton.offsets[1:], axis=-1) > 0.02).all()
