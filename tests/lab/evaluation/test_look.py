"""Contacts that slide are counted, and those that stand are not."""

import numpy as np

from bunraku.body.reference import reference_body
from bunraku.core.motion import SkeletalMotion
from bunraku.retarget.body_motion import body_handle_motion
from bunraku_lab.evaluation.motion.viewer.look import hands_in_body, sliding_contacts


def standing(speed, frames=20):
    """The reference body at rest, carried along z [m/s]."""
    body = reference_body()
    root = np.tile(body.joints[0].astype(float), (frames, 1))
    root[:, 2] += speed * np.arange(frames) / 20
    return body_handle_motion(SkeletalMotion(body.skeleton, np.tile(np.eye(3), (frames, 22, 1, 1)), root, 20.0))


def test_who_stands_slides_nowhere_and_who_is_carried_does_in_all_frames():
    still, slow, fast = (sliding_contacts(standing(speed)) for speed in (0.0, 0.19, 0.5))
    assert still == (0, 0, 2 * 19)
    assert slow.fast == 0 and slow.far == slow.contacts - 2 * 3  # 3 cm are passed in the fourth frame
    assert fast.fast == fast.contacts


def test_arms_to_the_sides_are_in_no_body():
    assert not hands_in_body(standing(0.0, 4)).any()
