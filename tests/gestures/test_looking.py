"""Heads point to where things are seen, by forward kinematics."""

import numpy as np

from bunraku.gestures.looking import looked
from bunraku.gestures.play import gesture_motion
from bunraku.gestures.standing import AT
from bunraku.language.sight import sight_of


def gaze(text):
    """How far the gaze is up and to the left [degrees], shape (N, 2), and the lean of the chest ahead."""
    rotations, _ = gesture_motion(looked(sight_of(text))).world()
    ahead, up = rotations[:, AT["head"], :, 2], rotations[:, AT["spine3"], :, 1]
    angles = [np.degrees(np.arcsin(ahead[:, 1])), np.degrees(np.arctan2(ahead[:, 0], ahead[:, 2]))]
    return np.stack(angles, axis=1), np.degrees(np.arctan2(up[:, 2], up[:, 1]))


def test_the_gaze_goes_up_down_and_along():
    stars, _ = gaze("gazes at the stars")
    feet, _ = gaze("looks down at the feet")
    ocean, _ = gaze("gazes at the ocean")
    assert np.median(stars[:, 0]) > 20 and np.median(feet[:, 0]) < -20 and abs(np.median(ocean[:, 0])) < 8
    assert np.ptp(ocean[:, 1]) > 30 > 15 > np.ptp(gaze("stares at a painting")[0][:, 1])


def test_who_looks_over_a_cliff_leans_over_it():
    depth, lean = gaze("looks over the cliff")
    assert np.median(depth[:, 0]) < -30 and np.median(lean) > 15
