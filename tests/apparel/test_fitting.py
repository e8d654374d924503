"""Apparel on a body: depth and fitting."""

import numpy as np
import pytest
import trimesh

from bunraku.apparel.body import PosedBody, surface_points
from bunraku.apparel.clothed import ClothedCharacter
from bunraku.apparel.fitting import fitted_clothes
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
