"""Clips of rigged characters on the reference body, with a rigged sample character in place of a game pack."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.animation import Animation
from bunraku.core.character import Handles
from bunraku.core.motion import HandleMotion
from bunraku.errors import FormatError
from bunraku_lab.datasets.motions.game_clips import add_game_clips, reference_clip
from bunraku_lab.synthetic.samples import make_sample


def arm_raised(side, degrees=70, frames=12):
    """The rigged person raising one arm, driven by its own joints."""
    person = make_sample("person", 0.3, rigged=True)
    rig, sign = person.rig, 1 if side == "left" else -1
    shoulder = rig.names.index(f"{side.capitalize()}Arm")
    moved = {shoulder}
    for joint, parent in enumerate(rig.parents):  # parents come before children in the samples
        if parent in moved:
            moved.add(joint)
    joints = len(rig.names)
    rotations = np.tile(np.eye(3), (frames, joints + 1, 1, 1))
    translations = np.zeros((frames, joints + 1, 3))
    turn = Rotation.from_rotvec(np.linspace(0, sign * np.radians(degrees), frames)[:, None] * [0, 0, 1]).as_matrix()
    for joint in moved:
        arm = rig.positions[joint] - rig.positions[shoulder]
        rotations[:, joint + 1] = turn
        translations[:, joint + 1] = turn @ arm - arm
    weights = np.concatenate([np.zeros((len(person.vertices), 1)), rig.dense_weights()], axis=1)
    handles = Handles(np.concatenate([np.zeros((1, 3)), rig.positions]), weights / weights.sum(axis=1, keepdims=True))
    still = np.broadcast_to(np.eye(3), (frames, 3, 3))
    return Animation(person, handles, HandleMotion(translations, rotations, np.zeros((frames, 3)), still, 20.0))


@pytest.mark.parametrize(("side", "other"), [("left", "right"), ("right", "left")])
def test_a_raised_arm_is_raised_on_the_reference_body(side, other):
    motion = reference_clip(arm_raised(side))
    body = reference_body()
    posed = Animation(body.character(), body.handles, motion).vertices()
    hand = body.handle_weights[:, HANDLE_NAMES.index(f"{side}_wrist")] > 0.5
    idle = body.handle_weights[:, HANDLE_NAMES.index(f"{other}_wrist")] > 0.5
    arm = np.linalg.norm(body.joints[20] - body.joints[16])
    rise = posed[-1, hand, 1].mean() - posed[0, hand, 1].mean()
    assert rise == pytest.approx(arm * np.sin(np.radians(70)), rel=0.3)
    assert abs(posed[-1, idle, 1].mean() - posed[0, idle, 1].mean()) < 0.05
    assert np.abs(posed[..., 1].min(axis=1)).max() < 0.03


def test_what_is_missing_is_said(tmp_path):
    with pytest.raises(FormatError, match="no index"):
        add_game_clips(tmp_path, tmp_path)
    (tmp_path / "index.json").write_text(json.dumps({"clips": {}}))
    with pytest.raises(FormatError, match="none of the known characters"):
        add_game_clips(tmp_path, tmp_path)
