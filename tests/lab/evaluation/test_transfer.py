"""The evaluation of motion transfer."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from mmd_bytes import Bone, plank, pmx

import bunraku
from bunraku import FormatError, RigAnimation
from bunraku.core.body.layout import JOINT_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_from_axis_angle
from bunraku.core.motion import SkeletalMotion
from bunraku.files.mmd.vmd import MmdClip, write_vmd
from bunraku.files.motions.bvh import write_bvh
from bunraku.retarget.mmd_motion import standard_model
from bunraku_lab.evaluation.transfer.quadrupeds import measure_quadrupeds
from bunraku_lab.evaluation.transfer.table import BARS, KINDS, evaluate_transfer, leg_reach, measure_soles, pick_motions
from bunraku_lab.synthetic.samples import make_sample

MMD = Path(os.environ.get("BUNRAKU_DATA", "runs/data"), "apparel/mmd")


def test_motions_are_picked_by_caption_then_by_name(tmp_path):
    for name in ("a.bvh", "b.bvh", "c.bvh", "kick.bvh", "sit_down.bvh", "roll.bvh", "dance.bvh"):
        (tmp_path / name).write_text("x")
    (tmp_path / "captions.csv").write_text(
        "file,caption\na.bvh,walking far away\nb.bvh,a walk\nmissing.bvh,walk\nc.bvh,kickflip\n"
    )
    assert {kind: path.name for kind, path in pick_motions(tmp_path).items()} == {
        "walk": "b.bvh", "dance": "dance.bvh", "kick": "kick.bvh", "sit": "sit_down.bvh", "roll": "roll.bvh",
    }  # fmt: skip
    (tmp_path / "roll.bvh").unlink()
    with pytest.raises(FormatError, match="roll"):
        pick_motions(tmp_path)


def raised_arm(folder, frames):
    """The reference body, turns of its joints that raise an arm, and that motion, also as the file of each kind."""
    body, turns = reference_body(), np.zeros((frames, 22, 3))
    turns[:, JOINT_NAMES.index("left_shoulder"), 2] = np.linspace(-1.2, 0.3, frames)
    motion = SkeletalMotion(body.skeleton, matrix_from_axis_angle(turns), np.tile(body.joints[0], (frames, 1)), 20.0)
    for kind in KINDS:
        write_bvh(motion, folder / f"{kind}.bvh")
    return body, turns, motion


def test_the_table(tmp_path):
    body, turns, motion = raised_arm(tmp_path, 10)
    (tmp_path / "characters").mkdir()
    RigAnimation(body.character(), matrix_from_axis_angle(turns), np.zeros((10, 22, 3))).save(
        tmp_path / "characters" / "person.glb"
    )
    result = evaluate_transfer(tmp_path / "characters", tmp_path, work=tmp_path / "work")
    assert result["counts"] == {"characters": 1, "humanoids": 1, "clips": 1} and not result["failed"]
    assert set(BARS) <= set(result)
    assert result["finished"] == 1 and result["angle_rig"] < 5 and result["bvh_degrees"] < 0.01
    assert result["back"] < 0.005 and result["back_copied"] < 1e-5 and result["soles"] is None
    (kept,) = (tmp_path / "work" / "transfer").iterdir()
    row = json.loads(kept.read_text())
    assert row == result["rows"][0]
    kept.write_text(json.dumps(row | {"angle_rig": 77.0}))
    assert evaluate_transfer(tmp_path / "characters", tmp_path, work=tmp_path / "work")["angle_rig"] == 77.0
    write_bvh(motion, tmp_path / "walk.bvh", fps=30)
    assert evaluate_transfer(tmp_path / "characters", tmp_path, work=tmp_path / "work")["angle_rig"] < 5  # another walk


def test_processes_give_the_same_table_of_transfer(tmp_path):
    body, turns, _ = raised_arm(tmp_path, 8)
    (folder := tmp_path / "characters").mkdir()
    RigAnimation(body.character(), matrix_from_axis_angle(turns), np.zeros((8, 22, 3))).save(folder / "person.glb")
    (folder / "broken.glb").write_bytes(b"glTF")
    (folder / "a.glb").write_bytes((folder / "person.glb").read_bytes())
    work = tmp_path / "work"
    alone = evaluate_transfer(folder, tmp_path)
    shared = evaluate_transfer(folder, tmp_path, work=work, jobs=2)
    assert [row["name"] for row in shared["rows"]] == ["a", "broken", "person"]
    assert len(list((work / "transfer").iterdir())) == 3 and shared["failed"] == alone["failed"]
    assert shared["counts"] == alone["counts"] and "broken" in alone["failed"]
    for one, other in zip(alone["rows"], shared["rows"], strict=True):
        for key in one:
            assert one[key] == (pytest.approx(other[key], abs=1e-3) if isinstance(one[key], float) else other[key])


def doll(folder):
    """The standard skeleton of MMD with a mesh, its leg IK and all."""
    model = standard_model()

    def chain(ik):
        if ik is None:
            return None
        limits = {True: None, False: ((-np.pi, 0.0, 0.0), (-np.radians(0.5), 0.0, 0.0))}
        return ik.target, ik.loops, ik.limit, [(link.bone, limits[link.lower is None]) for link in ik.links]

    bones = [
        Bone(some.name, tuple(some.position * [1, 1, -1] / 0.08), some.parent, some.layer, ik=chain(some.ik))
        for some in model.bones
    ]
    (folder / "doll.pmx").write_bytes(pmx(plank(bones=bones, bodies=[], joints=[], textures=[])))


def test_soles_of_an_mmd_model(tmp_path):
    doll(tmp_path)
    up = np.zeros((20, 3))
    up[:10, 1], up[10:, 1] = np.linspace(0.02, 0.3, 10), -0.4  # the last half is under the floor
    still = np.broadcast_to(np.eye(3), (20, 3, 3))
    write_vmd(MmdClip({f"{side}足ＩＫ": (up, still) for side in "左右"}), tmp_path / "step.vmd")
    (tmp_path / "broken.vmd").write_bytes(b"Vocaloid Motion Data 0002")
    failed = {}
    result = measure_soles(tmp_path, failed)
    assert list(failed) == ["broken.vmd"]
    assert result["soles"] < 1e-5 and result["soles_reached"] == 0.5 and result["soles_beyond"] < 1e-5
    assert 0.38 < result["soles_target"] < 0.41
    model = standard_model()
    hip, knee, ankle = (model.bone(f"左{name}") for name in ("足", "ひざ", "足首"))
    length = np.linalg.norm(model.positions[hip] - model.positions[knee]) + np.linalg.norm(
        model.positions[knee] - model.positions[ankle]
    )
    link = model.bones[model.bone("左足ＩＫ")].ik.links[0]
    assert length - 1e-3 < leg_reach(model, link, hip, ankle) <= length
    assert measure_soles(None, {}) == dict.fromkeys(result)


@pytest.mark.skipif(not MMD.is_dir(), reason="needs the unpacked MMD characters")
def test_soles_of_real_characters():
    failed = {}
    result = measure_soles(MMD, failed)
    assert not failed and result["soles"] < 0.01 and result["soles_beyond"] < 0.001 and result["soles_reached"] > 0.4


def test_a_walking_dog_on_the_sample_dog(tmp_path):
    dog = make_sample("dog", rigged=True)
    names, frames = dog.rig.names, 40
    turns = np.zeros((frames, len(names), 3))
    swing = 0.3 * np.sin(2 * np.pi * np.arange(frames) / 20)
    for name, sign in (("LeftArm", 1), ("RightArm", -1), ("LeftUpLeg", -1), ("RightUpLeg", 1)):
        turns[:, names.index(name), 0] = sign * swing
    walk = bunraku.RigAnimation(dog, matrix_from_axis_angle(turns), np.zeros((frames, len(names), 3)), 20.0)
    path = walk.save(tmp_path / "dog.glb", name="walk")
    found = measure_quadrupeds({"dog": path})
    (row,) = found["quadrupeds"]
    assert (row["source"], row["target"]) == ("dog", "sample dog") and "failed" not in row
    assert found["quadruped_limbs_degrees"] == row["degrees"] < 8  # the same body, by handles that know nothing of it
    assert found["quadruped_hind_above_back"] == 0 and found["quadruped_ground"] < 0.02
