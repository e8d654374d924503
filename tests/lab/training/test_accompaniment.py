"""What goes with the hands is found again in motion that was made by such numbers."""

import numpy as np
import pytest

from bunraku.gestures.catalogue import gestures
from bunraku.gestures.perform import FOLLOWS, accompanied
from bunraku.gestures.play import Tracks, gesture_motion, posed
from bunraku.gestures.pose import Hand, Pose
from bunraku.gestures.standing import swaying
from bunraku_lab.training.accompaniment import accompaniment, gesticulates


def stretch(seed, follows):
    """Somebody whose hands go about in front of the chest."""
    random = np.random.default_rng(seed)
    hands = [
        [Hand((x, y, z)) for x, y, z in random.uniform((0.1, 1.2, 0.3), (0.4, 1.55, 0.5), (9, 3))] for _ in range(2)
    ]
    keys = [(1.0 * number, Pose(right, left)) for number, (right, left) in enumerate(zip(*hands, strict=True))]
    tracks = Tracks.of(keys)
    if follows:
        tracks = accompanied(tracks, np.ones(9), {side: np.zeros(9, bool) for side in ("left", "right")})
    moments = np.arange(160) / 20
    return posed(tracks, np.arange(9.0), moments, swaying(seed, moments), 20)


def test_the_numbers_are_found_again():
    found = accompaniment([stretch(seed, True) for seed in range(8)])
    assert min(found.explained["turn"], found.explained["lean left"]) > 0.8
    for name in ("turn", "lean left", "head left"):
        assert found.follows[name][2] == pytest.approx(FOLLOWS[name][2], abs=0.3 * abs(FOLLOWS[name][2]))


def test_nothing_is_found_where_nothing_goes_with_them():
    found = accompaniment([stretch(seed, False) for seed in range(8)])
    assert max(abs(factor) for row in found.follows.values() for factor in row) < 3
    assert found.explained["turn"] < 0.3


def test_who_claps_uses_the_hands_and_who_nods_kneels_or_marches_does_not():
    by_name = {one.name: gesture_motion(one) for one in gestures()}
    assert gesticulates(by_name["clap"]) and gesticulates(by_name["conduct"])
    assert not any(gesticulates(by_name[name]) for name in ("nod", "kneel", "march in place", "crawl"))
