"""Legs come down below a trunk that has nothing under one of its ends."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.anatomy.anatomy import Anatomy
from bunraku.anatomy.joints import attach_joints
from bunraku.anatomy.legs import find_legs, foot_points
from bunraku.body.layout import HANDLE_NAMES
from bunraku.body.reference import reference_body
from bunraku.core.motion import HandleMotion
from bunraku.geometry.rotations import matrix_from_axis_angle, matrix_y
from bunraku.retarget.rig_parts import RigParts
from bunraku.retarget.stages.support import Support
from bunraku_lab.synthetic.samples import make_sample

H = {name: handle for handle, name in enumerate(HANDLE_NAMES)}
FPS = 20.0


@pytest.fixture(scope="module")
def dog():
    character = make_sample("dog", rigged=True)
    parts = RigParts.of(character)
    return character, parts.handles, parts.joints


def folded(dog, seconds: float, pitch: float = 0.0, heading: float = 0.0, part: str = "shoulder") -> HandleMotion:
    """Four seconds on the spot, forelegs (or hind legs) stretched ahead for some of them."""
    _, handles, joints = dog
    frames = round(4 * FPS)
    angles = np.zeros((frames, len(HANDLE_NAMES), 3))
    for side in ("left", "right"):
        for name in (part, *(("elbow", "wrist") if part == "shoulder" else ("knee", "ankle", "foot"))):
            angles[20 : 20 + round(seconds * FPS), H[f"{side}_{name}"], 0] = -1.2
    rotations, translations = attach_joints(matrix_from_axis_angle(angles), handles, joints)
    tilt = np.zeros((frames, 3))
    tilt[20 : 20 + round(seconds * FPS), 0] = -pitch
    root = matrix_y(np.array(heading)) @ matrix_from_axis_angle(tilt)
    path = np.zeros((frames, 3))
    return HandleMotion(translations, rotations, path, root, FPS)


def low(dog, motion, front: bool):
    """Height of the lowest foot of one end, over the leg's length, shape (N,)."""
    character, handles, joints = dog
    legs = find_legs(character, handles, joints)
    floor, world = float(character.vertices[:, 1].min()), motion.transforms(handles.positions)
    arms = {H["left_shoulder"], H["right_shoulder"]}
    own = [leg for leg in legs if (leg.upper in arms) == front]
    assert len(own) == 2
    heights = [foot_points(leg, character, handles, world)[..., 1].min(axis=1) - floor for leg in own]
    return np.max(heights, axis=0) / own[0].length


def kept(dog, motion):
    character, handles, joints = dog
    anatomy = Anatomy.of(character, handles, (np.tile(np.eye(3), (len(HANDLE_NAMES), 1, 1)), joints))
    return Support().kept(motion, anatomy), Support().unsupported(motion, anatomy)


@pytest.mark.parametrize("heading", [0.0, 2.5])
@pytest.mark.parametrize("part", ["shoulder", "hip"])
def test_folded_legs_are_put_down(dog, heading, part):
    motion = folded(dog, 2.0, heading=heading, part=part)
    front = part == "shoulder"
    assert low(dog, motion, front)[25:55].min() > 0.2
    done, wanting = kept(dog, motion)
    assert wanting[:, int(front)].sum() == 40 and not wanting[:, int(not front)].any()
    assert low(dog, done, front)[26:54].max() < 0.05
    assert np.allclose(low(dog, done, not front), low(dog, motion, not front), atol=1e-6)
    before, after = (some.transforms(dog[1].positions)[:10] for some in (motion, done))
    assert np.allclose(before, after, atol=1e-4)  # what stood stays as it was


def test_a_leap_a_blow_and_rearing_up_are_meant(dog):
    for motion in (folded(dog, Support().long - 0.1), folded(dog, 2.0, pitch=0.6)):
        done, wanting = kept(dog, motion)
        assert not wanting.any() and done is motion


def test_people_keep_their_arms(dog):
    body = reference_body()
    character, parts = body.character(), RigParts.of(body.character())
    frames = 40
    rotations = np.tile(np.eye(3), (frames, len(HANDLE_NAMES), 1, 1))
    still = HandleMotion(np.zeros((frames, 30, 3)), rotations, np.zeros((frames, 3)), rotations[:, 0], FPS)
    assert kept((character, parts.handles, parts.joints), still)[0] is still
