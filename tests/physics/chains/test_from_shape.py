"""Chains laid over bare apparel: where they run, what they hold, and that they swing without flying off."""

import numpy as np
import pytest

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.body.layout import JOINT_COUNT, JOINT_NAMES, JOINT_PARENTS
from bunraku.core.character import Character, Rig, top_influences
from bunraku.core.rig_animation import RigAnimation
from bunraku.geometry.rotations import matrix_from_axis_angle
from bunraku.physics.chains.from_shape import shape_chains
from bunraku.physics.chains.laid import Chained, LaidChains, with_chains
from bunraku.physics.chains.moving import steady_simulation
from bunraku.physics.told.clothed import clothed_from_file
from bunraku_lab.synthetic.wardrobe import wardrobe_character

JOINTS = np.arange(JOINT_COUNT)
Laid = tuple[Chained, LaidChains, Character]


@pytest.fixture(scope="module", params=[870_003, 810_016])
def laid(request: pytest.FixtureRequest) -> Laid:
    """A character with long hair, and one with ears, a tail and a scarf; their files' bones are
    not told.
    """
    clothed = clothed_from_file(wardrobe_character(request.param))
    transforms = np.tile(np.eye(4), (JOINT_COUNT, 1, 1))
    transforms[:, :3, 3] = clothed.joints
    rig = Rig(JOINT_NAMES, np.array(JOINT_PARENTS), transforms, *top_influences(clothed.weights, 4))
    found = shape_chains(clothed)
    body = Character("bare", clothed.rest, clothed.faces, rig)
    return with_chains(body, found, JOINTS), found, body


def _swung(made: Chained, body: Character) -> RigAnimation:
    """The body leans from side to side, all of it."""
    frames = 45
    rotations = np.tile(np.eye(3), (frames, JOINT_COUNT, 1, 1))
    angles = 0.5 * np.sin(np.arange(frames) / 30 * 2 * np.pi)
    rotations[:, 0] = matrix_from_axis_angle(np.stack([0 * angles, 0.5 * angles, angles], axis=1))
    return made.on(RigAnimation(body, rotations, np.zeros((frames, JOINT_COUNT, 3)), 30.0))


def test_what_is_held(laid: Laid) -> None:
    made, found, _ = laid
    assert len(found.chains) > 3
    assert (found.shares >= 0).all() and found.shares.sum(axis=1).max() < 1 + 1e-9
    assert found.links.max() < found.count
    rig = made.character.rig
    assert rig is not None
    np.testing.assert_allclose(rig.weights.sum(axis=1), 1, atol=1e-5)
    # each chain hangs on a bone above it, and its end is a bone of its own
    for chain, end in zip(made.chains, made.ends, strict=True):
        assert rig.parents[chain.bones[0]] == chain.holder < chain.bones[0]
        assert rig.parents[end] == chain.bones[-1]
        np.testing.assert_allclose(rig.positions[end], chain.points[-1])


def test_seams_stay_closed(laid: Laid) -> None:
    """Vertices of one place are held by the same links, so no motion opens a seam."""
    made, _, body = laid
    moved = steady_simulation(_swung(made, body), made.rig()).animation.vertices([20, 44])
    _, first, index = np.unique(np.round(made.character.vertices, 6), axis=0, return_index=True, return_inverse=True)
    index = index.reshape(-1)
    gap = np.linalg.norm(moved - moved[:, first[index]], axis=-1)
    own = np.ptp(made.character.vertices[:, 1])
    assert np.percentile(gap, 99.9) < 1e-3 * own


def test_chains_swing_and_do_not_fly(laid: Laid) -> None:
    made, found, body = laid
    animation = _swung(made, body)
    result = steady_simulation(animation, made.rig())
    assert not result.report.recoveries
    away = np.linalg.norm(result.animation.vertices() - animation.vertices(), axis=-1)
    size = float(np.ptp(made.character.vertices[:, 1]))
    stiff = with_chains(body, found.turned(10.0, 1.0), JOINTS)
    less = steady_simulation(_swung(stiff, body), stiff.rig()).animation.vertices() - animation.vertices()
    assert np.linalg.norm(less, axis=-1).max() < 0.7 * away.max()
    assert away[:, found.vertices].max() > 0.005 * size
    assert away.max() < 0.5 * size
    still = np.ones(len(made.character.vertices), bool)
    still[found.vertices] = False
    assert away[:, still].max() < 1e-5


def test_a_skirt_is_tied_all_round() -> None:
    """A cone about a post: as many columns all round, each tied to the next on both sides, all of one length."""
    turn = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    rows = [(0.1, 1.7), (0.1, 1.0), (0.1, 0.0)], [(0.12, 1.0), (0.2, 0.85), (0.28, 0.7), (0.36, 0.55)]
    points, faces = [], []
    for rings in rows:
        start = 32 * len(points)
        points += [np.stack([r * np.sin(turn), np.full(32, y), r * np.cos(turn)], axis=1) for r, y in rings]
        for row in range(len(rings) - 1):
            a = start + 32 * row + np.arange(32)
            b = start + 32 * row + (np.arange(32) + 1) % 32
            faces += [np.stack([a, b, a + 32], axis=1), np.stack([b, b + 32, a + 32], axis=1)]
    vertices = np.concatenate(points).astype(np.float32)
    cloth = np.arange(len(vertices)) >= 96
    weights = np.zeros((len(vertices), JOINT_COUNT), np.float32)
    weights[:, 0] = 1
    joints = np.zeros((JOINT_COUNT, 3), np.float32)
    joints[:, 1] = 0.95
    one = np.zeros(1, np.float32)
    found = shape_chains(
        ClothedCharacter(vertices, np.concatenate(faces), joints, weights, cloth, np.where(cloth, 0, -1), one, one)
    )
    assert {chain.kind for chain in found.chains} == {"skirt"} and len(found.chains) >= 6
    assert (np.bincount(np.array(found.ties).ravel()) == 2).all()
    lengths = [chain.length for chain in found.chains]
    assert max(lengths) < 1.05 * min(lengths)
    hem = np.flatnonzero(vertices[found.vertices, 1] < 0.56)
    np.testing.assert_allclose(found.shares[hem].sum(axis=1), 1, atol=1e-6)


def test_what_is_far_from_the_skull_hangs_for_itself() -> None:
    """Long hair of which the mask has the lowest band and two locks beside the face: no chain runs from one of them to
    the other.
    """
    clothed = clothed_from_file(wardrobe_character(840_040))
    hair = [chain for chain in shape_chains(clothed).chains if chain.kind == "hair"]
    assert len(hair) >= 4
    for chain in hair:
        assert np.linalg.norm(chain.points[0] - chain.points[-1]) < 0.3 * clothed.scale
