from __future__ import annotations

import numpy as np
import pytest

from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.parts import PARTS
from bunraku.body.reference import reference_body
from bunraku.diffusion.features import decode, encode
from bunraku.diffusion.generation.overlay import overlaid
from bunraku.gestures.catalogue import gestures
from bunraku.gestures.limbs.gesture import limb_gesture
from bunraku.gestures.play import gesture_motion
from bunraku.language.limbs.posing import posing_of
from bunraku.retarget.body_motion import body_handle_motion


def features(gesture, frames=40):
    return encode(body_handle_motion(gesture_motion(gesture)))[:frames]


@pytest.fixture(scope="module")
def march():
    return features(next(one for one in gestures() if one.name == "march in place"))


def limbs(predicate):
    return features(limb_gesture(posing_of(predicate)))


def places(values, handles):
    """World positions of handles, shape (N, H, 3)."""
    motion, rest = decode(values), reference_body().handles.positions.astype(float)
    local = (rest + motion.translations)[:, handles] - rest[0]
    turned = np.einsum("nij,nkj->nki", motion.root_rotation, local)
    return turned + rest[0] + motion.root_translation[:, None]


def test_what_is_laid_over_itself_stays(march):
    once = overlaid(march, march, ["arms"])
    assert np.abs(once - march).max() < 1e-4


def test_arms_go_with_the_chest_and_legs_go_on(march):
    made = overlaid(march, limbs("stands with the arms stretched out to the sides"), ["arms"])
    legs = list(PARTS["legs"][1:])
    assert np.abs(places(made, legs) - places(march, legs)).max() < 1e-4
    wrists = [HANDLE_NAMES.index(f"{side}_wrist") for side in ("left", "right")]
    left, right = np.moveaxis(places(made, wrists), 1, 0)
    assert (left[:, 0] - right[:, 0] > 1.2).all()
    shoulders = [HANDLE_NAMES.index(f"{side}_shoulder") for side in ("left", "right")]
    length = np.linalg.norm(places(made, wrists) - places(made, shoulders), axis=2)
    assert length.max() - length.min() < 0.05


def test_one_arm_alone(march):
    made = overlaid(march, limbs("raises the left arm and holds it"), ["left arm"])
    right = list(PARTS["right arm"])
    assert np.abs(places(made, right) - places(march, right)).max() < 1e-4


def test_a_trunk_that_leans_takes_head_and_arms_along(march):
    made = overlaid(march, limbs("stands leaning far to the left"), ["upper body"])
    for name in ("head", "left_shoulder", "right_shoulder"):
        handle = [HANDLE_NAMES.index(name)]
        assert (places(made, handle) - places(march, handle))[..., 0].mean() > 0.08


def test_legs_that_stay(march):
    standing = limbs("stands with the arms crossed")
    made = overlaid(march, standing, ["lower body"])
    feet = [HANDLE_NAMES.index(f"{side}_ankle") for side in ("left", "right")]
    assert np.ptp(places(made, feet), axis=0).max() < 0.05 < np.ptp(places(march, feet), axis=0).max()
