"""Animals' clips as captured skeletons, on a folder of one dog."""

from __future__ import annotations

import numpy as np

import bunraku
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.io import save_character
from bunraku_lab.evaluation.transfer.quadrupeds import measure_quadrupeds
from bunraku_lab.synthetic.samples import make_sample


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


def test_without_animals_there_is_nothing_to_measure(tmp_path):
    mushroom = make_sample("mushroom", rigged=True)
    path = save_character(mushroom, tmp_path / "mushroom.glb")
    found = measure_quadrupeds({"mushroom": path, "none": tmp_path / "none.glb"})
    assert found["quadruped_limbs_degrees"] is None and found["quadrupeds"] == []
