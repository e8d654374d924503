import numpy as np
import pytest

from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.layers import Layers
from bunraku.body.layout import JOINT_NAMES
from bunraku.body.reference import reference_body

AROUND, HEIGHTS = 32, np.linspace(0.3, 0.85, 24)


def tube(radius, heights=HEIGHTS):
    """An upright tube about the axis through the origin, its normals outward."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, AROUND, endpoint=False), heights)
    points = np.stack([radius * np.sin(angle), height, radius * np.cos(angle)], axis=-1).reshape(-1, 3)
    here = np.arange(len(points)).reshape(len(heights), AROUND)
    after = np.roll(here, -1, axis=1)
    quads = np.stack([here[:-1], after[:-1], after[1:], here[1:]], axis=-1).reshape(-1, 4)
    return points, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])


LEG, SKIRT, HAIR = (slice(number * AROUND * len(HEIGHTS), (number + 1) * AROUND * len(HEIGHTS)) for number in range(3))


@pytest.fixture(scope="module")
def clothed():
    """One leg in a skirt, and something carried by the head around both."""
    tubes = [tube(radius) for radius in (0.08, 0.16, 0.2)]
    rest = np.concatenate([points for points, _ in tubes]).astype(np.float32)
    faces = np.concatenate([own + number * len(tubes[0][0]) for number, (_, own) in enumerate(tubes)])
    weights = np.zeros((len(rest), 22), np.float32)
    for rows, joint in ((LEG, "left_knee"), (SKIRT, "pelvis"), (HAIR, "head")):
        weights[rows, JOINT_NAMES.index(joint)] = 1
    part = np.repeat([-1, 0, 1], len(tubes[0][0]))
    joints = np.array(reference_body().joints[:22], np.float32)
    joints[1:3, 1] = 0.9
    blank = np.zeros(2, np.float32)
    return ClothedCharacter(rest, faces, joints, weights, part >= 0, part, blank, blank)


@pytest.fixture(scope="module")
def layers(clothed):
    return Layers(clothed, np.flatnonzero(clothed.part >= 0))


def pose(clothed, forward):
    """The leg goes forward, and with it the front of what hangs over it, as its skin says."""
    out = clothed.rest.copy()
    out[LEG, 2] += forward
    front = np.clip(clothed.rest[SKIRT.start :, 2] / 0.16, 0, 1)
    out[SKIRT.start :, 2] += forward * front
    return out


def front_of(points, rest):
    """Largest z in the middle of the front at each height."""
    near = np.abs(rest[:, 0]) < 0.02
    return np.array([points[near & (np.abs(rest[:, 1] - height) < 1e-5), 2].max() for height in HEIGHTS])


def test_a_leg_that_has_come_through_is_covered_again_and_the_back_stays(clothed, layers):
    skinned = pose(clothed, 0.25)
    positions = clothed.rest[SKIRT.start :]
    laid = np.concatenate([skinned[LEG], layers(positions, skinned[layers.seen])])
    assert front_of(positions, clothed.rest[SKIRT.start :])[12] < 0.08 + 0.25  # it had come through
    fronts = [front_of(laid[rows], clothed.rest[rows]) for rows in (LEG, SKIRT, HAIR)]
    inner = slice(2, -2)
    assert (fronts[1] > fronts[0])[inner].all()
    assert (fronts[2] > fronts[1])[inner].all()  # and what lay over the skirt lies over it
    back = clothed.rest[:, 2] < -0.1
    np.testing.assert_allclose(
        laid[back & (np.arange(len(laid)) >= SKIRT.start)], clothed.rest[SKIRT.start :][back[SKIRT.start :]], atol=1e-6
    )


def test_what_lies_right_stays_where_it_is(clothed, layers):
    for under in (clothed.rest, pose(clothed, 0.02)):  # the leg stays under the skirt
        found = layers(clothed.rest[SKIRT.start :], under[layers.seen])
        np.testing.assert_array_equal(found, clothed.rest[SKIRT.start :])


def test_what_lacks_height_is_what_a_look_at_every_pair_finds(clothed, layers):
    """The skirt over the leg, against the words of the rule, one vertex and point after the other."""
    skinned = pose(clothed, 0.25)
    over, rest = layers.skirt, clothed.rest.astype(np.float64)
    row, lack, _, ways = over.lacking(clothed.rest[SKIRT.start :], skinned[over.used], np.inf)
    found = {}
    for number, height, way in zip(over.mine[row], lack, ways.T, strict=True):
        found.setdefault(int(number), []).append((float(height), way))
    leg = clothed.faces[(clothed.faces < LEG.stop).all(axis=1)]
    normals = [np.zeros((LEG.stop, 3)) for _ in range(2)]
    for out, points in zip(normals, (rest, skinned.astype(np.float64)), strict=True):
        for a, b, c in leg:
            out[[a, b, c]] += np.cross(points[b] - points[a], points[c] - points[a])
        out /= np.linalg.norm(out, axis=1, keepdims=True)
    wanted = {}
    for number in over.mine:
        own = rest[SKIRT.start + number]
        near = np.argsort(np.linalg.norm(rest[LEG] - own, axis=1), kind="stable")[:32]
        for point in near:
            clear = (own - rest[point]) @ normals[0][point]
            short = min(clear, 0.015 * clothed.scale) - (own - skinned[point]) @ normals[1][point]
            if clear > 0.002 * clothed.scale and short > 0:
                wanted.setdefault(int(number), []).append((short, normals[1][point]))
    assert wanted.keys() == found.keys() and len(wanted) > 50
    for number, pairs in wanted.items():
        assert max(pair[0] for pair in found[number]) == pytest.approx(max(pair[0] for pair in pairs), abs=1e-5)


def test_in_a_clip_the_skirt_goes_over_the_leg_without_a_jump(clothed, layers):
    frames = 24
    skinned = np.stack([pose(clothed, forward) for forward in np.linspace(0, 0.25, frames)])
    positions = np.repeat(clothed.rest[None, SKIRT.start :], frames, axis=0)
    told = []
    laid = layers.clip(positions, skinned[:, layers.seen], told.append)
    steps = np.linalg.norm(np.diff(laid, axis=0), axis=-1).max(axis=1)
    assert steps.max() < 3 * 0.25 / frames
    assert told[0] == 0 and all(0 <= share < 1 for share in told)


def test_apparel_that_does_not_hang_over_legs_is_left_alone(clothed):
    weights = clothed.weights.copy()
    weights[LEG] = np.eye(22)[JOINT_NAMES.index("spine1")]
    other = ClothedCharacter(
        clothed.rest,
        clothed.faces,
        clothed.joints,
        weights,
        clothed.apparel,
        clothed.part,
        clothed.stiffness,
        clothed.damping,
    )
    positions = clothed.rest[SKIRT.start :] + 0.1
    assert Layers(other, np.flatnonzero(clothed.part >= 0))(positions, clothed.rest) is positions
