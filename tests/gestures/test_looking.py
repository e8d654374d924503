"""Heads point to where things are seen, by forward kinematics."""

import numpy as np

from bunraku.core.motion import SkeletalMotion
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.gestures.catalogue import STANDING
from bunraku.gestures.looking import looked
from bunraku.gestures.perform import performed
from bunraku.gestures.play import gesture_motion, posed
from bunraku.gestures.standing import AT, swaying
from bunraku.gestures.tracks import Tracks
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
    pelvis = gesture_motion(looked(sight_of("looks under the bed"))).world()[1][:, 0, 1]
    assert pelvis[0] - np.median(pelvis) > 0.2 and np.median(gaze("looks under the bed")[1]) > 45


def test_who_looks_at_the_ground_by_himself_looks_up_as_far_as_anybody():
    moments = np.arange(120) / 20
    level = posed(Tracks.of(STANDING.keys), np.array([0, 9.5]), moments, swaying(1, moments), 20)
    rotations = level.rotations.copy()
    rotations[:, AT["neck"]] = rotations[:, AT["neck"]] @ matrix_from_axis_angle(np.array([np.radians(35), 0, 0]))
    bent = SkeletalMotion(level.skeleton, rotations, level.root_translation, level.fps)
    ups = []
    for idle in (level, bent):
        motion = performed(looked(sight_of("gazes at the stars")), 120, (idle,), np.random.default_rng(0))
        ups.append(np.degrees(np.arcsin(np.median(motion.world()[0][40:80, AT["head"], 1, 2]))))
    assert ups[0] > 20 and abs(ups[0] - ups[1]) < 8
