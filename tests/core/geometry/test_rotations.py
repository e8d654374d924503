"""Axes, rotations, resampling over time, and the rigid motion that fits points best."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import register_reference, registration_case
from scipy.spatial.transform import Rotation, Slerp

from bunraku.core.geometry import rotations as rot
from bunraku.core.geometry.axes import ORIENTATIONS, axis_vector, right_angle_rotations, upright_rotation
from bunraku.core.geometry.rotations import Resampling
from bunraku.core.skinning import part_means, register


def test_the_rotations_are_the_group_of_the_cube():
    rotations = right_angle_rotations()
    assert len(ORIENTATIONS) == len(rotations) == 24
    assert set(np.unique(rotations)) == {-1, 0, 1}
    assert np.array_equal(np.linalg.det(rotations).round(9), np.ones(24))
    keys = {matrix.astype(int).tobytes() for matrix in rotations}
    assert len(keys) == 24 and np.eye(3, dtype=int).tobytes() in keys
    products = np.einsum("aij,bjk->abik", rotations, rotations).reshape(-1, 3, 3)
    assert {matrix.astype(int).tobytes() for matrix in products} == keys
    assert {matrix.T.astype(int).tobytes() for matrix in rotations} == keys


@pytest.mark.parametrize(("up", "front"), ORIENTATIONS)
def test_up_goes_up_and_front_to_the_front(up, front):
    rotation = upright_rotation(up, front)
    assert np.array_equal(rotation @ axis_vector(up), [0, 1, 0]) and np.array_equal(
        rotation @ axis_vector(front), [0, 0, 1]
    )


ROTATION_AXES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, -1, 1], [1, 2, 3], [-3, 1, 0.1]], float)
ROTATION_AXES /= np.linalg.norm(ROTATION_AXES, axis=1, keepdims=True)
ANGLES = np.array([0, 1e-9, 1e-5, 0.3, np.pi / 2, 3.0, np.pi - 1e-6, np.pi])


def samples() -> np.ndarray:
    """Random rotations, none at all, tiny ones, half turns about many axes and nearly half turns, as matrices (R, 3,
    3).
    """
    special = Rotation.from_rotvec((ROTATION_AXES[:, None] * ANGLES[:, None]).reshape(-1, 3)).as_matrix()
    return np.concatenate([Rotation.random(200, random_state=1).as_matrix(), special])


@pytest.fixture(params=["numpy", "torch"])
def kind(request):
    """A function to the kind of array under test, and one back."""
    if request.param == "numpy":
        return np.asarray, np.asarray
    torch = pytest.importorskip("torch", reason="tensors are of PyTorch")
    return torch.as_tensor, lambda tensor: tensor.numpy()


def test_quaternions_agree_with_scipy(kind):
    to, back = kind
    quaternion = back(rot.quaternion_from_matrix(to(samples())))
    theirs = Rotation.from_matrix(samples()).as_quat(canonical=True)
    np.testing.assert_allclose(np.abs((quaternion * theirs).sum(-1)), 1, atol=1e-12)
    assert (quaternion[:, 3] >= 0).all()
    np.testing.assert_allclose(back(rot.matrix_from_quaternion(to(3.5 * quaternion))), samples(), atol=1e-12)


def test_axis_angle_agrees_with_scipy(kind):
    to, back = kind
    rotvec = Rotation.from_matrix(samples()).as_rotvec()
    np.testing.assert_allclose(back(rot.matrix_from_axis_angle(to(rotvec))), samples(), atol=1e-12)
    mine = back(rot.axis_angle_from_matrix(to(samples())))
    assert np.linalg.norm(mine, axis=1).max() <= np.pi + 1e-9
    np.testing.assert_allclose(Rotation.from_rotvec(mine).as_matrix(), samples(), atol=1e-8)


def test_any_six_numbers_give_a_rotation(kind):
    to, back = kind
    six = np.random.default_rng(0).normal(size=(50, 4, 6)) * 7
    matrix = back(rot.matrix_from_6d(to(six)))
    np.testing.assert_allclose(matrix @ matrix.swapaxes(-1, -2), np.broadcast_to(np.eye(3), matrix.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(matrix), 1, atol=1e-12)


def test_float32_keeps_half_turns_sharp(kind):
    to, back = kind
    matrix = samples().astype(np.float32)
    round_trip = back(rot.matrix_from_quaternion(rot.quaternion_from_matrix(to(matrix))))
    np.testing.assert_allclose(round_trip, matrix, atol=2e-6)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-10, 10), min_size=6, max_size=6))
def test_products_of_quaternions_are_products_of_matrices(values):
    a, b = rot.matrix_from_axis_angle(np.array(values[:3])), rot.matrix_from_axis_angle(np.array(values[3:]))
    x1, y1, z1, w1 = rot.quaternion_from_matrix(a)
    x2, y2, z2, w2 = rot.quaternion_from_matrix(b)
    v1, v2 = np.array([x1, y1, z1]), np.array([x2, y2, z2])
    product = np.append(w1 * v2 + w2 * v1 + np.cross(v1, v2), w1 * w2 - v1 @ v2)
    np.testing.assert_allclose(rot.matrix_from_quaternion(product), a @ b, atol=1e-10)


def test_gradients_are_finite_at_no_rotation_and_at_half_turns():
    torch = pytest.importorskip("torch", reason="gradients are those of PyTorch")
    six = torch.tensor([[1.0, 0, 0, 0, 1, 0], [-1.0, 0, 0, 0, 1, 0]], dtype=torch.float64, requires_grad=True)
    rot.matrix_from_6d(six).square().sum().backward()
    assert torch.isfinite(six.grad).all()


def test_rotation_between_directions():
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 40, 3))
    b[0], b[1], b[2] = a[0], -2 * a[1], [-1, 0, 0]
    a[2] = [5, 0, 0]
    matrix = rot.rotation_between(a, b)
    turned = (matrix @ a[..., None])[..., 0]
    np.testing.assert_allclose(
        turned / np.linalg.norm(a, axis=1, keepdims=True), b / np.linalg.norm(b, axis=1, keepdims=True), atol=1e-9
    )
    angle = np.arccos(np.clip((a * b).sum(1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1), -1, 1))
    np.testing.assert_allclose(Rotation.from_matrix(matrix).magnitude(), angle, atol=1e-6)  # no larger turn than needed
    np.testing.assert_array_equal(rot.rotation_between(np.zeros(3), a[0]), np.eye(3))


def test_slerp_agrees_with_scipy():
    ends = Rotation.random(2, random_state=3)
    share = np.linspace(0, 1, 9)
    quaternion = ends.as_quat()
    mine = rot.quaternion_slerp(np.tile(quaternion[0], (9, 1)), np.tile(-quaternion[1], (9, 1)), share)
    np.testing.assert_allclose(Rotation.from_quat(mine).as_matrix(), Slerp([0, 1], ends)(share).as_matrix(), atol=1e-9)
    np.testing.assert_allclose(
        rot.quaternion_slerp(quaternion[0], quaternion[0], np.array(0.5)), quaternion[0], atol=1e-12
    )


@pytest.mark.parametrize("want", [7.0, 20.0, 33.3, 60.0])
def test_values_between_frames_are_those_of_scipy(want):
    rng = np.random.default_rng(0)
    turns = [Rotation.from_rotvec(np.cumsum(0.3 * rng.normal(size=(9, 3)), axis=0)) for _ in range(2)]
    values = rng.normal(size=(9, 2, 3))
    found = Resampling.of(9, 20.0, want)
    assert len(found) == int(8 / 20 * want + 1e-6) + 1
    times = np.arange(len(found)) / want
    known = np.stack([[np.interp(times, np.arange(9) / 20, values[:, i, j]) for j in range(3)] for i in range(2)])
    np.testing.assert_allclose(found.linear(values), known.transpose(2, 0, 1), atol=1e-12)
    got = found.rotations(np.stack([turn.as_matrix() for turn in turns], axis=1))
    for joint, turn in enumerate(turns):
        np.testing.assert_allclose(
            got[:, joint], Slerp(np.arange(9) / 20, turn)(np.minimum(times, 0.4)).as_matrix(), atol=1e-9
        )


def test_quarter_turn_by_hand():
    """A square of side 2 about (1, 0, 0) turns a quarter about +Z and goes up by 5: worked out on paper."""
    source = np.array([[0, -1, 0], [2, -1, 0], [2, 1, 0], [0, 1, 0]], float)
    target = np.array([[[2, -1, 5], [2, 1, 5], [0, 1, 5], [0, -1, 5]]], float)
    rotations, translations = register(source, target, np.ones((4, 1)))
    np.testing.assert_allclose(rotations[0, 0], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-7)
    np.testing.assert_allclose(translations[0, 0], [0, 0, 5], atol=1e-12)


def test_fast_path_equals_reference():
    source, targets, weights = registration_case()
    rotations, translations = register(source, targets, weights)
    for frame in range(5):
        for part in range(6):
            handle, rotation, translation = register_reference(source, targets[frame], weights[:, part])
            np.testing.assert_allclose(rotations[frame, part], rotation, atol=1e-6)
            np.testing.assert_allclose(translations[frame, part], translation, atol=1e-6)
            np.testing.assert_allclose(part_means(source, weights)[part], handle, atol=1e-12)


def test_agrees_with_align_vectors():
    source, targets, weights = registration_case()
    rotations, _ = register(source, targets, weights)
    for part in range(6):
        w = weights[:, part]
        a = targets[3] - np.average(targets[3], axis=0, weights=w)
        b = source - np.average(source, axis=0, weights=w)
        np.testing.assert_allclose(
            rotations[3, part], Rotation.align_vectors(a, b, weights=w)[0].as_matrix(), atol=1e-6
        )


def test_a_mirrored_target_gives_a_rotation_still():
    source, _, weights = registration_case()
    rotations, _ = register(source, (source * [-1, 1, 1])[None], weights)
    np.testing.assert_allclose(np.linalg.det(rotations), 1, atol=1e-9)


def test_parts_that_fix_no_rotation():
    """No weight, one point, two points, a plane: finite rotations, as near to the identity as the points allow."""
    source = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.3, 0.2, 0]], float)
    target = source @ Rotation.from_euler("z", 90, degrees=True).as_matrix().T + [0, 0, 2]
    weights = np.zeros((5, 4))
    weights[0, 1] = 1
    weights[:2, 2] = 1
    weights[:, 3] = 1
    rotations, translations = register(source.astype(np.float32), target[None].astype(np.float32), weights)
    np.testing.assert_allclose(np.linalg.det(rotations), 1, atol=1e-9)
    np.testing.assert_allclose(rotations[0, :2], np.broadcast_to(np.eye(3), (2, 3, 3)), atol=1e-9)
    np.testing.assert_allclose(translations[0, 0], target.mean(0) - source.mean(0), atol=1e-6)
    np.testing.assert_allclose(rotations[0, 2:] @ [1, 0, 0], [[0, 1, 0]] * 2, atol=1e-6)
    np.testing.assert_allclose(rotations[0, 2] @ [0, 0, 1], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(rotations[0, 3] @ [0, 0, 1], [0, 0, 1], atol=1e-6)
