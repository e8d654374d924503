"""The axioms of every conversion, against scipy's Rotation, for numpy and torch alike."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from bunraku.geometry import rotations as rot

AXES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0, -1, 1], [1, 2, 3], [-3, 1, 0.1]], float)
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
ANGLES = np.array([0, 1e-9, 1e-5, 0.3, np.pi / 2, 3.0, np.pi - 1e-6, np.pi])


def samples() -> np.ndarray:
    """Random rotations, none at all, tiny ones, half turns about many axes and nearly half turns, as matrices (R, 3,
    3).
    """
    special = Rotation.from_rotvec((AXES[:, None] * ANGLES[:, None]).reshape(-1, 3)).as_matrix()
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


def test_six_numbers_are_the_first_two_columns(kind):
    to, back = kind
    six = back(rot.matrix_to_6d(to(samples())))
    np.testing.assert_array_equal(six, np.concatenate([samples()[:, :, 0], samples()[:, :, 1]], axis=1))
    np.testing.assert_allclose(back(rot.matrix_from_6d(to(six))), samples(), atol=1e-12)


def test_any_six_numbers_give_a_rotation(kind):
    to, back = kind
    six = np.random.default_rng(0).normal(size=(50, 4, 6)) * 7
    matrix = back(rot.matrix_from_6d(to(six)))
    np.testing.assert_allclose(matrix @ matrix.swapaxes(-1, -2), np.broadcast_to(np.eye(3), matrix.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(matrix), 1, atol=1e-12)


@pytest.mark.parametrize("name", ["matrix_to_6d", "quaternion_from_matrix", "axis_angle_from_matrix"])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_type_and_leading_shape_are_kept(kind, name, dtype):
    to, _ = kind
    out = getattr(rot, name)(to(samples()[:24].reshape(2, 3, 4, 3, 3).astype(dtype)))
    assert tuple(out.shape[:-1]) == (2, 3, 4)
    assert str(out.dtype).endswith(dtype)


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


def test_turning_about_y(kind):
    to, back = kind
    angle = np.array([0.0, 0.4, -2.0])
    np.testing.assert_allclose(
        back(rot.matrix_y(to(angle))), Rotation.from_euler("y", angle[:, None]).as_matrix(), atol=1e-12
    )
    np.testing.assert_allclose(back(rot.matrix_y(to(np.array(np.pi / 2)))) @ [0, 0, 1], [1, 0, 0], atol=1e-12)


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


def test_adjugates_are_inverses_times_determinants():
    matrices = np.random.default_rng(0).normal(size=(5, 4, 3, 3))
    wanted = np.linalg.inv(matrices) * np.linalg.det(matrices)[..., None, None]
    np.testing.assert_allclose(rot.adjugates(matrices), wanted, atol=1e-12)
    # of a matrix without an inverse too
    np.testing.assert_allclose(rot.adjugates(np.diag([2.0, 3.0, 0.0])), np.diag([0.0, 0.0, 6.0]))


def test_inverses_by_cofactors():
    matrices = np.random.default_rng(0).normal(size=(50, 3, 3))
    np.testing.assert_allclose(rot.inverses(matrices), np.linalg.inv(matrices), rtol=1e-9)
