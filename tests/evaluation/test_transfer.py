"""The table of motion transfer, on a folder with one character and five motions."""

import numpy as np
import pytest

from bunraku import FormatError, RigAnimation
from bunraku.bodies.layout import JOINT_NAMES
from bunraku.bodies.reference import reference_body
from bunraku.evaluation.transfer import BARS, KINDS, evaluate_transfer, limb_angles, pick_motions
from bunraku.formats.bvh_write import write_bvh
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.motion import SkeletalMotion
from bunraku.retarget.rig_parts import RigParts


def test_motions_are_picked_by_caption_then_by_name(tmp_path):
    for name in ("a.bvh", "b.bvh", "c.bvh", "kick.bvh", "sit_down.bvh", "roll.bvh", "dance.bvh"):
        (tmp_path / name).write_text("x")
    (tmp_path / "captions.csv").write_text("file,caption\na.bvh,walking far away\nb.bvh,a walk\nmissing.bvh,walk\nc.bvh,kickflip\n")
    assert {kind: path.name for kind, path in pick_motions(tmp_path).items()} == {
        "walk": "b.bvh", "dance": "dance.bvh", "kick": "kick.bvh", "sit": "sit_down.bvh", "roll": "roll.bvh",
    }  # fmt: skip
    (tmp_path / "roll.bvh").unlink()
    with pytest.raises(FormatError, match="roll"):
        pick_motions(tmp_path)


def test_angles_of_limbs():
    parts = RigParts.of(reference_body().character())
    places = np.concatenate([reference_body().joints, np.zeros((8, 3))])[None]
    source = reference_body().joints[None]
    assert np.abs(limb_angles(parts, places, source)).max() < 1e-3
    turned = source @ matrix_from_axis_angle(np.array([0, 0, 0.5])).T
    assert limb_angles(parts, places, turned)[0, 0] == pytest.approx(np.degrees(0.5), abs=0.5)


def test_the_table(tmp_path):
    body = reference_body()
    turns = np.zeros((10, 22, 3))
    turns[:, JOINT_NAMES.index("left_shoulder"), 2] = np.linspace(-1.2, 0.3, 10)
    motion = SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), np.tile(body.joints[0], (10, 1)), 20.0)
    for kind in KINDS:
        write_bvh(motion, tmp_path / f"{kind}.bvh")
    (tmp_path / "characters").mkdir()
    RigAnimation(body.character(), matrix_from_axis_angle(turns), np.zeros((10, 22, 3))).save(tmp_path / "characters" / "person.glb")
    result = evaluate_transfer(tmp_path / "characters", tmp_path, speed=False)
    assert result["counts"] == {"characters": 1, "humanoids": 1, "clips": 1} and not result["failed"]
    assert set(BARS) <= set(result)
    assert result["finished"] == 1 and result["angle_rig"] < 5 and result["bvh_degrees"] < 0.01
    assert result["back"] < 0.005 and result["back_copied"] < 1e-5
