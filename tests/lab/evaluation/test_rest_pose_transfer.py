"""The measure of rest poses: small where the stage runs, large where it does not."""

import numpy as np

from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.retarget.fit import Stages
from bunraku_lab.evaluation.handles.rest_pose_transfer import code_made_motions, rest_pose_transfer, true_handles
from bunraku_lab.evaluation.handles.rest_poses import posed_limbs
from bunraku_lab.evaluation.handles.subjects import subject
from bunraku_lab.synthetic.samples import make_sample


def test_the_rest_pose_does_not_show_in_the_animation():
    people = [
        subject(make_sample("person", 0.3, rigged=True), "person"),
        subject(reference_body().character(), "reference"),
    ]
    motions = code_made_motions(0.5)
    result = rest_pose_transfer(people, {"squat": motions["squat"]})
    assert result["rest_pose_transfer"] < 0.02 and result["in_place"] < 0.02 and result["ground"] < 0.01
    assert set(result["poses"]) == {"A", "arms down", "sitting", "crouching"} and result["poses"]["A"] < 0.01
    without = rest_pose_transfer(people[1:], {"wave": motions["wave"]}, stages=Stages(rest_pose=False))
    assert without["rest_pose_transfer"] > 3 * result["rest_pose_transfer"]


def test_who_is_no_humanoid_is_passed_over():
    dog = subject(make_sample("dog", 0.3, rigged=True), "dog")
    assert rest_pose_transfer([dog])["rest_pose_transfer"] is None


def test_posed_limbs_and_true_handles_agree_on_the_parts():
    one = subject(make_sample("person", 0.3, rigged=True), "person")
    sitting = posed_limbs(one.truth, "sitting")
    handles = true_handles(one, sitting)
    thigh, pelvis = (handles.positions[HANDLE_NAMES.index(name)] for name in ("left_hip", "pelvis"))
    assert thigh[2] - pelvis[2] > 0.05 * one.height and np.allclose(handles.weights.sum(axis=1), 1, atol=1e-4)
