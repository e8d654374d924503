import numpy as np
import pytest

from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.parts import PARTS, kept_handles
from bunraku.core.motion import HandleMotion
from bunraku.diffusion.features import encode, feature_mask
from bunraku.errors import OptionError


def names(keep):
    return {HANDLE_NAMES[i] for i in np.flatnonzero(kept_handles(keep))}


def test_words_name_handles():
    assert names("left arm") == {"left_collar", "left_shoulder", "left_elbow", "left_wrist", "left_fingers"}
    assert names(["Left-Arm"]) == names("left_arm") and names("left arm, right arm") == names("arms")
    assert names("left_wrist") == {"left_wrist"} and names(["head_top", "tail"]) == {"head_top", "tail", "tail_tip"}
    assert names("left leg") == {"pelvis", "left_hip", "left_knee", "left_ankle", "left_foot"} and names("root") == {
        "pelvis"
    }
    assert names("upper body") | names("lower body") == set(HANDLE_NAMES) and not names("upper body") & names(
        "lower body"
    )
    assert names("head") == {"neck", "head", "head_top", "face"}


def test_words_that_name_nothing_or_all():
    with pytest.raises(OptionError, match=r"no part 'lags'.*legs"):
        kept_handles("lags")
    with pytest.raises(OptionError, match="all handles"):
        kept_handles(["upper body", "lower body"])


@pytest.mark.parametrize("part", list(PARTS))
def test_features_of_a_part_change_with_its_handles_only(part):
    rng, handles = np.random.default_rng(0), kept_handles(part)
    still = HandleMotion(
        np.zeros((5, 30, 3)), np.tile(np.eye(3), (5, 30, 1, 1)), np.zeros((5, 3)), np.tile(np.eye(3), (5, 1, 1))
    )
    translations, root = np.zeros((5, 30, 3)), np.zeros((5, 3))
    translations[:, handles] = rng.normal(size=(5, int(handles.sum()), 3))
    translations[:, 0] = 0
    if handles[0]:
        root = rng.normal(size=(5, 3))
    change = encode(HandleMotion(translations, still.rotations, root, still.root_rotation)) != encode(still)
    mask = feature_mask(handles)
    assert mask.shape == (271,) and not change[:, ~mask].any() and change[:, mask].any()
