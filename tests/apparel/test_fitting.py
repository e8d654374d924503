import numpy as np
import pytest

from bunraku.apparel.fitting import fitted_clothes, without_worn
from bunraku.apparel.parts import whole_pieces
from bunraku.body.layout import JOINT_NAMES
from bunraku.body.reference import reference_body


def tube(radius, low, high, around=24, rings=12):
    """An upright tube about the axis through the origin."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, around, endpoint=False), np.linspace(low, high, rings))
    points = np.stack([radius * np.sin(angle), height, radius * np.cos(angle)], axis=-1).reshape(-1, 3)
    here = np.arange(len(points)).reshape(rings, around)
    after = np.roll(here, -1, axis=1)
    quads = np.stack([here[:-1], after[:-1], after[1:], here[1:]], axis=-1).reshape(-1, 4)
    return points, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])


def worn(joint, *radii):
    """A trunk that one joint moves, and skirts that hang from it."""
    tubes = [tube(0.1, 0.9, 1.6), *(tube(radius, 0.4, 0.9) for radius in radii)]
    count = len(tubes[0][0])
    vertices = np.concatenate([points for points, _ in tubes]).astype(np.float32)
    faces = np.concatenate([own + number * count for number, (_, own) in enumerate(tubes)])
    weights = np.zeros((len(vertices), 22), np.float32)
    weights[:, JOINT_NAMES.index(joint)] = 1
    blank = np.zeros(len(vertices), np.float32)
    joints = np.array(reference_body().joints[:22], np.float32)
    return fitted_clothes(vertices, faces, joints, weights, np.arange(len(vertices)) >= count, blank, blank)


@pytest.mark.parametrize(
    ("joint", "radii", "parts"),
    [
        ("pelvis", (0.12, 0.14), 1),  # two layers of a skirt
        ("pelvis", (0.12, 0.14, 0.16), 1),
        ("pelvis", (0.12, 0.22), 2),
        ("spine3", (0.12, 0.14), 2),  # what hangs from elsewhere stays apart, as locks of hair do
    ],
)
def test_layers_of_a_skirt_are_one_part(joint, radii, parts):
    clothed = worn(joint, *radii)
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
    blank = np.zeros(len(vertices), np.float32)
    joints = np.array(reference_body().joints[:22], np.float32)
    clothed = fitted_clothes(vertices, faces, joints, weights, apparel, blank, blank)
    assert clothed.apparel.any()
    assert (clothed.weights[clothed.apparel].argmax(axis=1) == JOINT_NAMES.index("head")).all()


def test_what_goes_round_an_arm_is_worn_by_it():
    """Of a shirt with sleeves the sleeves stay with the arms; a sheet on one side of an arm is no sleeve."""
    body = reference_body()
    points, faces, weights = body.vertices, body.faces, np.asarray(body.joint_weights)
    arm = weights[:, [JOINT_NAMES.index(f"left_{part}") for part in ("shoulder", "elbow", "wrist")]].sum(axis=1) > 0.5
    legs = points[:, 1] < body.joints[0, 1]
    shirt = ~legs
    found = without_worn(points, faces, body.joints, weights, shirt)
    assert not found[arm].any() and found[shirt & (np.abs(points[:, 0]) < 0.08)].all() and not found[legs].any()
    behind = shirt & (points[:, 2] < body.joints[JOINT_NAMES.index("left_elbow"), 2])
    assert without_worn(points, faces, body.joints, weights, behind)[arm & behind].any()
