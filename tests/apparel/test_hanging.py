"""What hangs by its shape: a skirt is found whole where a network says nothing, trousers and faces are not."""

import numpy as np
import pytest

from bunraku.apparel.hanging import hanging_mask
from bunraku.body.layout import JOINT_COUNT, JOINT_NAMES

Mesh = tuple[np.ndarray, np.ndarray]
SEGMENTS = 24


def _tube(rings: list[tuple[float, float]], x: float = 0.0, z: float = 0.0) -> Mesh:
    """A surface of revolution about a vertical line, by radius and height of each ring [m]."""
    turn = np.linspace(0, 2 * np.pi, SEGMENTS, endpoint=False)
    points = [np.stack([x + r * np.sin(turn), np.full(SEGMENTS, y), z + r * np.cos(turn)], axis=1) for r, y in rings]
    faces = []
    for row in range(len(rings) - 1):
        a = SEGMENTS * row + np.arange(SEGMENTS)
        b = SEGMENTS * row + (np.arange(SEGMENTS) + 1) % SEGMENTS
        faces += [np.stack([a, b, a + SEGMENTS], axis=1), np.stack([b, b + SEGMENTS, a + SEGMENTS], axis=1)]
    return np.concatenate(points), np.concatenate(faces)


def _person(*worn: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces, joints, weights, and the number of the part of each vertex: legs, trunk, head, and what is
    worn.
    """
    joints = np.zeros((JOINT_COUNT, 3))
    places = {"pelvis": (0, 0.9, 0), "spine1": (0, 1.02, 0), "left_hip": (0.1, 0.85, 0), "right_hip": (-0.1, 0.85, 0),
              "left_knee": (0.1, 0.45, 0), "right_knee": (-0.1, 0.45, 0), "head": (0, 1.4, 0)}  # fmt: skip
    joints[:, 1] = 1.2
    for name, place in places.items():
        joints[JOINT_NAMES.index(name)] = place
    body = [_tube([(0.07, 0.8), (0.06, 0.4), (0.05, 0.0)], x) for x in (0.1, -0.1)]
    body += [_tube([(0.15, 0.82), (0.15, 1.3)]), _tube([(0.05, 1.38), (0.1, 1.5), (0.02, 1.6)])]
    vertices, faces, number = [], [], []
    for place, (points, corners) in enumerate([*body, *worn]):
        faces.append(corners + sum(len(one) for one in vertices))
        vertices.append(points)
        number.append(np.full(len(points), place))
    every = np.concatenate(vertices)
    weights = np.zeros((len(every), JOINT_COUNT))
    head = every[:, 1] > 1.38
    weights[~head, 0], weights[head, JOINT_NAMES.index("head")] = 1, 1
    return every, np.concatenate(faces), joints, weights, np.concatenate(number)


def _marked(likely: float, *worn: Mesh) -> list[float]:
    """The share of each thing worn that is marked, where a network says the same of all of it."""
    vertices, faces, joints, weights, number = _person(*worn)
    said = np.where(number >= 4, likely, 0.0)
    mask, _ = hanging_mask(vertices, faces, joints, weights, np.ones(len(vertices)), said, said > 1 / 3)
    assert not mask[number < 4].any()
    return [float(mask[number == 4 + place].mean()) for place in range(len(worn))]


SKIRT = _tube([(0.17, 0.95), (0.2, 0.8), (0.25, 0.65), (0.3, 0.5)])


@pytest.mark.parametrize("likely", [0.0, 0.2, 0.4])
def test_a_skirt_is_taken_whole(likely: float) -> None:
    assert _marked(likely, SKIRT) == [1.0]


def test_trousers_are_not() -> None:
    """Two legs that are joined at the hips, and go round one leg each, however likely they are."""
    left = _tube([(0.1, 0.81), (0.09, 0.5), (0.09, 0.1)], 0.1)
    right = _tube([(0.1, 0.81), (0.09, 0.5), (0.09, 0.1)], -0.1)
    points = np.concatenate([left[0], right[0]])
    faces = np.concatenate([left[1], right[1] + len(left[0]), [[0, 1, len(left[0])], [0, len(left[0]) + 1, 1]]])
    (share,) = _marked(0.45, (points, faces))
    assert share == 0


def test_long_hair_is_hair_and_a_face_is_none() -> None:
    tail = _tube([(0.02, 1.55), (0.04, 1.3), (0.04, 0.9), (0.01, 0.7)], z=-0.18)
    chin = _tube([(0.02, 1.5), (0.03, 1.42), (0.01, 1.36)], z=0.09)
    assert _marked(0.1, tail, chin) == [1.0, 0.0]
