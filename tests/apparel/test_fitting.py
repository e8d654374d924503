"""Apparel on a body: depth, fitting and layers."""

import numpy as np
import pytest
import trimesh

from bunraku.apparel.body import PosedBody, surface_points
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.fitting import fitted_clothes
from bunraku.apparel.layers import Layers
from bunraku.apparel.nodes import whole_pieces
from bunraku.apparel.part_network import PARTS
from bunraku.apparel.parts import Parts
from bunraku.core.body.layout import JOINT_COUNT, JOINT_NAMES
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.rotations import matrix_from_axis_angle


def tube(radius, low, high, around=24, rings=12):
    """An upright tube about the axis through the origin."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, around, endpoint=False), np.linspace(low, high, rings))
    points = np.stack([radius * np.sin(angle), height, radius * np.cos(angle)], axis=-1).reshape(-1, 3)
    here = np.arange(len(points)).reshape(rings, around)
    after = np.roll(here, -1, axis=1)
    quads = np.stack([here[:-1], after[:-1], after[1:], here[1:]], axis=-1).reshape(-1, 4)
    return points, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])


def worn(joint, kind, *radii):
    """A trunk that one joint moves, and parts of a kind that hang from it."""
    tubes = [tube(0.1, 0.9, 1.6), *(tube(radius, 0.4, 0.9) for radius in radii)]
    count = len(tubes[0][0])
    vertices = np.concatenate([points for points, _ in tubes]).astype(np.float32)
    faces = np.concatenate([own + number * count for number, (_, own) in enumerate(tubes)])
    weights = np.zeros((len(vertices), 22), np.float32)
    weights[:, JOINT_NAMES.index(joint)] = 1
    joints = np.array(reference_body().joints[:22], np.float32)
    hangs = np.arange(len(vertices)) >= count
    number = np.arange(len(vertices)) // count - 1
    carrier = "pelvis" if joint == "pelvis" else "chest"
    parts = Parts(PARTS.index(kind) * hangs, number, hangs, (kind,) * len(radii), (carrier,) * len(radii))
    return fitted_clothes(vertices, faces, joints, weights, hangs, parts)


@pytest.mark.parametrize(
    ("joint", "kind", "radii", "parts"),
    [
        ("pelvis", "skirt", (0.12, 0.14, 0.18), 1),  # layers of a skirt
        ("spine3", "cape", (0.12, 0.14), 2),  # what is no skirt stays apart, as locks of hair do
    ],
)
def test_layers_of_a_skirt_are_one_part(joint, kind, radii, parts):
    clothed = worn(joint, kind, *radii)
    assert set(np.unique(clothed.part)) == {-1, *range(parts)}
    assert len(clothed.stiffness) == len(clothed.damping) == parts
    assert (clothed.weights[clothed.part >= 0].argmax(axis=1) == JOINT_NAMES.index(joint)).all()


def test_loose_pieces_that_are_mostly_apparel():
    """A lock of which a half is marked is apparel, one with a speck is not, and a body never."""

    def strip(x, rows):
        y = np.linspace(1, 0, rows)
        points = np.stack([np.repeat([[x, x + 0.02]], rows, 0), np.repeat(y[:, None], 2, 1), np.zeros((rows, 2))], -1)
        first = 2 * np.arange(rows - 1)[:, None]
        return points.reshape(-1, 3), np.concatenate([first + [0, 1, 2], first + [1, 3, 2]])

    points, faces, start = [], [], 0
    for x, rows in ((0, 80), (1, 10), (2, 10)):
        own, triangles = strip(x, rows)
        points.append(own)
        faces.append(triangles + start)
        start += len(own)
    vertices, faces = np.concatenate(points), np.concatenate(faces)
    mask = np.zeros(len(vertices), bool)
    mask[:90], mask[160:170], mask[180:182] = True, True, True
    found = whole_pieces(vertices, faces, mask)
    assert len(set(found[160:180])) == 1 and found[160] >= 0
    assert (found[:160] == -1).all() and (found[180:] == -1).all()


def test_a_tip_hangs_on_what_its_surface_goes_on_as():
    """The lower half of a lock is apparel and lies on an arm: it goes with the head, as the upper half does."""
    lock, lock_faces = tube(0.01, 0.8, 1.6)
    arm, arm_faces = tube(0.03, 0.7, 1.2)
    vertices = np.concatenate([lock + [0.045, 0, 0], arm]).astype(np.float32)
    faces = np.concatenate([lock_faces, arm_faces + len(lock)])
    weights = np.zeros((len(vertices), 22), np.float32)
    weights[: len(lock), JOINT_NAMES.index("head")] = 1
    weights[len(lock) :, JOINT_NAMES.index("left_elbow")] = 1
    apparel = (np.arange(len(vertices)) < len(lock)) & (vertices[:, 1] < 1.15)
    joints = np.array(reference_body().joints[:22], np.float32)
    clothed = fitted_clothes(vertices, faces, joints, weights, apparel)
    assert clothed.apparel.any()
    assert (clothed.weights[clothed.apparel].argmax(axis=1) == JOINT_NAMES.index("head")).all()


AROUND, HEIGHTS = 32, np.linspace(0.3, 0.85, 24)


def layered_tube(radius, heights=HEIGHTS):
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
    tubes = [layered_tube(radius) for radius in (0.08, 0.16, 0.2)]
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
        clothed.rest, clothed.faces, clothed.joints, weights, clothed.apparel, clothed.part, clothed.stiffness,
        clothed.damping,
    )  # fmt: skip
    positions = clothed.rest[SKIRT.start :] + 0.1
    assert Layers(other, np.flatnonzero(clothed.part >= 0))(positions, clothed.rest) is positions


RADIUS = 0.3


def ball(flipped=False, without_cap=False):
    """A ball as a body of one joint."""
    mesh = trimesh.creation.icosphere(4, RADIUS)
    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces)
    if without_cap:
        faces = faces[(vertices[faces][:, :, 1] < 0.8 * RADIUS).all(axis=1)]
    weights = np.eye(JOINT_COUNT, dtype=np.float32)[np.zeros(len(vertices), int)]
    none = np.zeros(0, np.float32)
    return ClothedCharacter(
        vertices, faces[:, ::-1] if flipped else faces, np.zeros((JOINT_COUNT, 3)), weights,
        np.zeros(len(vertices), bool), np.full(len(vertices), -1), none, none,
    )  # fmt: skip


@pytest.mark.parametrize("flipped, without_cap", [(False, False), (True, False), (False, True)])
def test_distances_from_a_ball(flipped, without_cap):
    """Whichever way round its faces are, and beside a hole in it."""
    points = surface_points(ball(flipped, without_cap), 3000)
    body = PosedBody(points.rest, points.normals)
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(400, 3))
    ways[:, 1] = -np.abs(ways[:, 1])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    away = rng.uniform(-0.1, 0.1, 400)
    near = (RADIUS + away)[:, None] * ways
    found, out, beside = body.planes(near)[1].of(near)
    assert np.abs(found - away).max() < 0.006 and np.abs(found - away).mean() < 0.002
    assert (out * ways).sum(axis=1).min() > 0.97 and (beside < 0.04 + np.abs(away)).all()


def test_points_are_pushed_out_in_any_pose_and_no_farther_than_they_were():
    points = surface_points(ball(), 3000)
    turn, shift = matrix_from_axis_angle(np.array([0.4, -1.0, 0.7])), np.array([1.0, 2.0, -0.5])
    affine = np.tile(np.concatenate([turn, shift[:, None]], axis=1), (JOINT_COUNT, 1, 1))
    body = PosedBody(*points.posed(affine))
    rest = np.array([[0.25, 0, 0], [0, 0.31, 0], [0, 0, 0.26], [0, 0.35, 0.1]])
    gap = np.array([0.02, 0.02, -0.05, 0.02])
    moved = rest @ turn.T + shift
    near = body.planes(moved)[1]
    lack, way = near.push(moved, gap, 0.1, 1.0)
    moved = (moved + lack[:, None] * way - shift) @ turn
    assert np.linalg.norm(moved, axis=1) == pytest.approx([0.32, 0.32, 0.26, np.hypot(0.35, 0.1)], abs=4e-3)
    assert near.push(rest @ turn.T + shift, gap, 0.005, 1.0)[0][0] == 0  # too deep
    # at rest: clear of it, in it a little, and so deep that it does not count
    gaps = PosedBody(points.rest, points.normals).gap(np.array([[0.4, 0, 0], [0.29, 0, 0], [0.2, 0, 0]]), 0.005, 1.0)
    assert gaps[0] == 0.005 and gaps[1] == pytest.approx(-0.01, abs=4e-3) and gaps[2] == -np.inf
