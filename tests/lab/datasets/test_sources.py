from importlib import resources

import numpy as np
import pytest

from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.motion import HandleMotion
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku_lab.datasets.motions.build import between_held_poses, checked, clip_weight
from bunraku_lab.datasets.motions.sources import credit_lines, source_of, subject_of
from bunraku_lab.datasets.motions.watched import Stretch


def test_the_longest_prefix_tells_the_source():
    assert source_of("accad_m2_Kick").weight > source_of("accad_m1_Walk").weight == 1.0
    assert source_of("cmux_backflip").credit == source_of("cmu_02_01").credit
    assert source_of("turn_snu_Walk05").licence == source_of("snu_Walk05").licence
    assert source_of("nobody_knows") is None


def test_subjects():
    names = ("cmu_07_11", "accad_f_A01_Stand", "accad_m1_Walk2", "accad_m2_E5", "snu_WalkSad05", "nobody_knows7")
    assert [subject_of(name) for name in names] == [
        "cmu_07", "accad_f", "accad_m1", "accad_m2", "snu_WalkSad", "nobody_knows",
    ]  # fmt: skip


def test_weights_are_those_of_the_table_and_half_for_part_of_a_take():
    assert clip_weight("kk_Idle", []) == clip_weight("kkm_Wave", []) == pytest.approx(0.4)
    assert clip_weight("cmu_01_01", []) == 1.0 and clip_weight("cmu_01_01", ["partial take"]) == 0.5
    assert clip_weight("nobody_knows", []) == 1.0


def test_each_source_is_credited_once():
    lines = credit_lines(["g1_Dance", "accad_f_A01", "accad_m2_E1", "cmu_01_01", "turn_cmu_01_01", "nobody_knows"])
    assert len(lines) == 3 and lines[0].startswith("CMU Graphics Lab")
    assert lines[1].startswith("Open Motion Project") and lines[1].endswith("Licence: CC BY 3.0 Unported.")


def test_the_card_credits_its_sources_as_the_table_does():
    card = resources.files("bunraku").joinpath("weights", "diffusion.md").read_text(encoding="utf-8")
    named = card.partition("## Credits")[2]
    said = [" ".join(part.split()) for part in named.split("\n- ")[1:]]
    known = credit_lines(
        ["cmu_", "hdm_", "snu_", "dm_", "fair_", "m2m_", "kk_", "qc_", "accad_f_", "g1_", "idle_", "style_", "gdq_"]
    )
    assert said == known


def take(angles, way=0.0):
    """A take whose left elbow is bent by these angles [degrees]."""
    vectors = np.zeros((len(angles), HANDLE_COUNT, 3))
    vectors[:, HANDLE_NAMES.index("left_elbow"), 2] = np.radians(angles)
    zeros = np.zeros((len(angles), 3), np.float32)
    return HandleMotion(
        np.zeros((len(angles), HANDLE_COUNT, 3), np.float32), matrix_from_axis_angle(vectors).astype(np.float32),
        zeros, np.tile(np.eye(3, dtype=np.float32), (len(angles), 1, 1)), 20.0,
    )  # fmt: skip


def test_what_is_held_at_the_ends_of_a_take_is_left_out():
    angles = np.concatenate([np.zeros(40), 60 * np.sin(np.linspace(0, 9, 60)) + 40, np.full(30, 80.0)])
    motion = take(angles)
    start, stop = between_held_poses(motion)
    assert 30 <= start <= 40 and 100 <= stop <= 110
    stretch = Stretch(0, 80, ("a person bends an arm",))
    assert checked(stretch, motion, np.zeros(130), (start, stop)) == {
        "start": start, "stop": 80, "texts": ["a person bends an arm"],
    }  # fmt: skip
    still = checked(Stretch(0, 30, ("stands",)), motion, np.zeros(130), (start, stop))
    assert still["fault"] == "nothing but a pose that is held"
    assert between_held_poses(take(np.zeros(50))) == (45, 5)


def test_a_t_pose_in_the_middle_is_a_fault():
    motion = take(np.concatenate([np.full(20, 90.0), np.zeros(6), np.full(20, 90.0)]))
    stretch = Stretch(0, 46, ("a person walks",), note="T-pose in the middle")
    assert checked(stretch, motion, np.zeros(46))["fault"] == "a T-pose in the middle"
    assert "fault" not in checked(Stretch(0, 46, ("a person walks",)), motion, np.zeros(46))
    ends = checked(Stretch(20, 46, ("a person walks",), note="T-pose at the start"), motion, np.zeros(46))
    assert ends["start"] == 26 and "fault" not in ends
