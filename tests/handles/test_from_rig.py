"""Handles from a file's own rig, by the names of its bones."""

import dataclasses

import numpy as np
import pytest

import bunraku
from bunraku.body.layout import HANDLE_NAMES
from bunraku.errors import CharacterError, OptionError
from bunraku.handles.from_rig import resolve_joints, rig_handles
from bunraku_lab.synthetic.samples import make_sample


def test_joints_without_a_name_join_their_nearest_known_ancestor():
    handles, parents = np.array([-1, 0, 16, -1, -1, 15]), np.array([-1, 0, 1, 2, 3, -1])
    np.testing.assert_array_equal(resolve_joints(handles, parents), [0, 0, 16, 16, 16, 15])


def test_handles_from_bone_names_hold_every_vertex():
    person = make_sample("person", 0.3, rigged=True)
    handles = rig_handles(person)
    np.testing.assert_allclose(handles.weights.sum(axis=1), 1, atol=1e-4)
    left = handles.weights[:, HANDLE_NAMES.index("left_wrist")] > 0.5
    assert left.any() and (person.vertices[left, 0] > 0.3).all()


def test_an_unknown_bone_follows_the_bone_that_it_hangs_on():
    person = make_sample("person", 0.3, rigged=True)
    names = list(person.rig.names)
    forearm = names.index("LeftForeArm")
    names[forearm] = "xyzzy"
    got = rig_handles(dataclasses.replace(person, rig=dataclasses.replace(person.rig, names=tuple(names))))
    part = person.rig.dense_weights()[:, forearm] > 0.6
    assert part.any() and (got.weights[part].argmax(axis=1) == HANDLE_NAMES.index("left_shoulder")).all()


def test_what_cannot_be_understood_is_said():
    with pytest.raises(CharacterError, match="no rig in this file"):
        rig_handles(make_sample("person", 0.3))
    person = make_sample("person", 0.3, rigged=True)
    names = tuple(f"Bone.{n:03d}" for n in range(len(person.rig.names)))
    with pytest.raises(CharacterError, match="do not tell which part"):
        rig_handles(dataclasses.replace(person, rig=dataclasses.replace(person.rig, names=names)))
    with pytest.raises(OptionError, match="'predict' or 'rig'"):
        bunraku.rig(person, handles="guess")
