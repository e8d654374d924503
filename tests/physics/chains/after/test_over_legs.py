"""Skirts go over legs that rise, and only then."""

import numpy as np
import pytest

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.character import Character, Rig, top_influences
from bunraku.core.rig_animation import RigAnimation
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.physics.chains.after.over_legs import _beyond, _least_rotation, over_legs
from bunraku.physics.chains.chain import Chain, laid_manner

FRAMES = 40
HIP, KNEE = (JOINT_NAMES.index(f"left_{part}") for part in ("hip", "knee"))


def test_how_far_a_ball_is_beyond_a_point():
    """Heights of a circle, by hand."""
    point, out = np.zeros((1, 1, 3)), np.array([[[0.0, 0.0, 1.0]]])
    ahead = _beyond(point, np.array([[[0.0, 0.0, 0.1]]]), out, np.array([0.05]), np.zeros(1))
    beside = _beyond(point, np.array([[[0.06, 0.0, 0.1]]]), out, np.array([0.05]), np.array([0.02]))
    away = _beyond(point, np.array([[[0.08, 0.0, 0.1]]]), out, np.array([0.05]), np.array([0.02]))
    np.testing.assert_allclose([ahead, beside, away], np.array([0.15, 0.13, 0])[:, None, None], atol=1e-9)


def test_the_least_rotation_takes_one_way_to_the_other():
    random = np.random.default_rng(0)
    one, other = random.normal(size=(2, 20, 3))
    found = np.einsum("nab,nb->na", _least_rotation(one, other), one / np.linalg.norm(one, axis=1, keepdims=True))
    np.testing.assert_allclose(found, other / np.linalg.norm(other, axis=1, keepdims=True), atol=1e-6)


def dressed():
    """A leg and a panel of a skirt of two links before it, on a rig with bones for the links and on one without."""
    joints = np.zeros((JOINT_COUNT, 3))
    joints[:, 1] = 1.3
    joints[0] = 0.03, 1, 0
    for side, x in (("left", 0.03), ("right", -0.03)):
        for part, y in (("hip", 0.95), ("knee", 0.5), ("ankle", 0.1), ("foot", 0.02)):
            joints[JOINT_NAMES.index(f"{side}_{part}")] = x, y, 0
    turn = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    ring = np.stack([0.06 * np.sin(turn), np.zeros(8), 0.06 * np.cos(turn)], axis=1)
    legs = [ring + [x, y, 0] for x in (0.03, -0.03) for y in (0.9, 0.75, 0.6)]
    x, y = np.meshgrid([-0.03, 0.03, 0.09], [1.0, 0.9, 0.8, 0.7, 0.6])
    panel = np.stack([x, y, np.full_like(x, 0.1)], axis=-1).reshape(-1, 3)
    rest = np.concatenate([*legs, panel]).astype(np.float32)
    body = len(rest) - len(panel)
    owner = np.zeros(len(rest), int)
    owner[:24], owner[24:48] = HIP, JOINT_NAMES.index("right_hip")
    faces = np.array([[0, 1, 8], [body, body + 1, body + 3]])
    weights = np.eye(JOINT_COUNT, dtype=np.float32)[owner]
    part = np.where(np.arange(len(rest)) < body, -1, 0)
    clothed = ClothedCharacter(
        rest, faces, joints, weights, part >= 0, part, np.zeros(1, np.float32), np.zeros(1, np.float32)
    )
    line = np.array([[0.03, 1.0, 0.1], [0.03, 0.8, 0.1], [0.03, 0.6, 0.1]])
    transforms = np.tile(np.eye(4), (JOINT_COUNT + 2, 1, 1))
    transforms[:, :3, 3] = np.concatenate([joints, line[:2]])
    bare = Rig(JOINT_NAMES, np.array(JOINT_PARENTS), transforms[:JOINT_COUNT], *top_influences(weights, 4))
    held = np.concatenate([weights, np.zeros((len(rest), 2), np.float32)], axis=1)
    held[body:] = 0
    held[np.arange(body, len(rest)), JOINT_COUNT + (panel[:, 1] < 0.8)] = 1
    rig = Rig(
        (*JOINT_NAMES, "skirt_1", "skirt_2"), np.array([*JOINT_PARENTS, 0, JOINT_COUNT]), transforms,
        *top_influences(held, 4),
    )  # fmt: skip
    chain = Chain(
        "skirt_0_0", "skirt", JOINT_COUNT + np.arange(2), line, 0, np.full(2, 0.06), 0.01, laid_manner("skirt", 0.4)
    )
    return clothed, Character("dressed", rest, faces, rig), chain, bare


def moved(raised: float):
    """The panel's vertices [m] where the thigh is raised so far [rad] all the time, before and after, (N, M, 3)."""
    clothed, character, chain, bare = dressed()
    rotations = np.tile(np.eye(3), (FRAMES, JOINT_COUNT + 2, 1, 1))
    rotations[:, HIP] = matrix_from_axis_angle(np.array([-raised, 0.0, 0.0]))
    given = RigAnimation(character, rotations, np.zeros((FRAMES, JOINT_COUNT + 2, 3)), 20.0)
    found = over_legs(given, [chain], [], clothed, np.arange(JOINT_COUNT), bare)
    return tuple(one.vertices()[:, clothed.apparel] for one in (given, found))


def test_legs_at_rest_move_no_skirt():
    before, after = moved(0.0)
    np.testing.assert_allclose(after, before, atol=1e-4)


@pytest.mark.parametrize("raised", [0.6, 1.1])
def test_a_raised_thigh_lifts_the_panel_before_it(raised):
    before, after = moved(raised)
    ahead = np.array([0.0, -np.cos(raised), np.sin(raised)])  # down the thigh, from the hip
    upper = np.array([0.0, np.sin(raised), np.cos(raised)])
    hem = slice(-3, None)
    from_hip = [one[:, hem] - [0.03, 0.95, 0] for one in (before, after)]
    assert (from_hip[0] @ upper < 0).all()  # it was behind the middle of the thigh
    assert (from_hip[1] @ upper > 0.02).all() and (from_hip[1] @ ahead > 0).all()
    assert np.linalg.norm(np.diff(after, axis=0), axis=-1).max() < 1e-3  # and is still
