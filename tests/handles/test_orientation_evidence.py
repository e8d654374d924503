"""What the place and the mirror planes of a mesh, and its format, say about how it stands."""

import numpy as np
import pytest

from bunraku.geometry.axes import AXES, ORIENTATIONS, upright_rotation
from bunraku.handles.orientation_evidence import (
    CALIBRATION,
    asymmetries,
    combined,
    ground_fit,
    has_rule,
    kind_weights,
    witnesses,
)

UP = AXES.index("+y")


def body(seed=0):
    """Points that mirror each other across x = 0 and nowhere else, with the lowest at y = 0 and z around 0."""
    half = np.random.default_rng(seed).uniform([0, 0, -0.3], [0.5, 1, 0.3], (300, 3)) ** np.array([1, 1.5, 1])
    half = np.nan_to_num(half, nan=0.1)
    half[0, 1] = 0
    return np.concatenate([half, half * [-1, 1, 1]]).astype(np.float32)


def test_the_ground_is_under_what_stands_on_it():
    points = body()
    fits = ground_fit(points)
    assert fits.argmax() == UP and fits[UP] > 0.8 and np.delete(fits, UP).max() < 0.01
    assert ground_fit(points * 1000) == pytest.approx(fits, abs=1e-5)
    hanging = ground_fit(points - np.float32([0, 1, 0]) * points[:, 1].max())
    assert hanging.argmax() == AXES.index("-y")
    for up, front in ORIENTATIONS[::5]:
        assert ground_fit(points @ upright_rotation(up, front).astype(np.float32)).argmax() == AXES.index(up)


def test_the_ground_says_nothing_of_what_stands_nowhere():
    points = body()
    middle = points - (points.min(axis=0) + points.max(axis=0)) / 2
    corner = points - points.min(axis=0)
    far = points + np.float32([5, 7, -9])
    flat = np.zeros((5, 3), np.float32) + np.float32([3, 3, 3])
    for moved in (middle, corner, far, flat):
        fits = ground_fit(moved)
        assert np.isfinite(fits).all() and np.ptp(fits) < 0.05


def test_left_and_right_mirror_each_other():
    points = body()
    found = asymmetries(points)
    assert found[0] < 1e-6 and found[1:].min() > 0.01
    assert asymmetries(points + np.float32([40, 0, 0]))[0] < 1e-4
    assert asymmetries(points[:, [1, 0, 2]])[1] < 1e-6
    angle = np.linspace(0, 2 * np.pi, 361)[:-1]
    cone = np.stack([np.cos(angle), np.linspace(0, 1, 360) * 0 + 1, np.sin(angle)], 1).astype(np.float32)
    cone = np.concatenate([cone * (1 - level) * [1, 0, 1] + [0, level, 0] for level in (0.0, 0.3, 0.6)])
    round_about = asymmetries(cone.astype(np.float32))
    assert max(round_about[0], round_about[2]) < 1e-3 and round_about[1] > 0.01  # it may face any way


def test_a_front_lies_in_the_mirror_plane():
    logs = witnesses(body() - np.float32([0, 0.5, 0]))  # hovering: the ground is silent
    sideways = [n for n, (up, front) in enumerate(ORIENTATIONS) if "x" in (up[1], front[1])]
    others = [n for n in range(24) if n not in sideways]
    assert logs[others].min() > logs[sideways].max() + 5


def test_no_witness_is_believed_beyond_its_doubt():
    sure = np.zeros(24)
    sure[5] = 1
    ratio = combined(sure).max() / combined(sure).min()
    assert ratio == pytest.approx(((0.95 + 0.05 / 24) / (0.05 / 24)) ** (1 / CALIBRATION))
    logs = witnesses(body())
    assert np.ptp(logs) <= np.log(195) + np.log(298) + 1e-6


def test_planes_that_hardly_differ_say_little():
    """A lion in mid-step: the odds between its planes are those of their ratio."""
    points = body()
    stride = points + 0.06 * np.random.default_rng(1).normal(size=points.shape).astype(np.float32)
    found = asymmetries(stride)
    assert found.min() > 0.01
    clear, unclear = (
        np.ptp(witnesses(some - np.float32([0, 0.5, 0]))[[0, 5, 10, 15, 20]]) for some in (points, stride)
    )
    assert unclear < clear


def test_few_vertices_tell_little():
    """The same verdict of the network is worth less of a tetrahedron than of a body, and copies of corners are none."""
    network = np.where(np.arange(24) == 20, 0.9, 0.1 / 23)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1.5, 0], [0, 0, 1]], np.float32)
    of_few = combined(network, corners)
    assert 1 / 24 < of_few[20] < 0.3
    np.testing.assert_allclose(combined(network, np.repeat(corners, 500, axis=0)), of_few, rtol=1e-6)
    dense = np.random.default_rng(0).uniform(0, 1, (3000, 3)).astype(np.float32)
    assert combined(network, dense)[20] > 0.7


def test_a_lying_glb_is_turned_if_the_mesh_says_so():
    lying = ORIENTATIONS.index(("+z", "-y"))
    seen = np.full(24, 0.02 / 23)
    seen[lying] = 0.98
    points = body() @ upright_rotation("+z", "-y").astype(np.float32)
    middle = points - (points.min(axis=0) + points.max(axis=0)) / 2
    assert combined(seen, points, kind_weights(".glb"))[lying] > 0.95
    assert combined(seen, middle, kind_weights(".obj"))[lying] > 0.85
    doubtful = np.full(24, 0.8 / 23)
    doubtful[lying] = 0.2
    assert combined(doubtful, None, kind_weights(".glb")).argmax() == ORIENTATIONS.index(("+y", "+z"))
    assert combined(seen, None, kind_weights(".glb", moved=True))[lying] < 0.5  # somebody has animated it as it stands


def test_the_network_alone_never_overrules_a_skin():
    for number in range(24):
        seen = np.zeros(24)
        seen[number] = 1
        found = combined(seen, None, kind_weights(".glb", moved=True))
        assert found.argmax() == ORIENTATIONS.index(("+y", "+z")) or found.max() < 0.85


def test_kinds_of_files_have_habits():
    for suffix in ("", ".obj", ".ply", ".stl", ".glb", ".fbx"):
        for moved in (False, True):
            weights = kind_weights(suffix, moved)
            assert weights.sum() == pytest.approx(1) and weights.min() > 0
    usual = {suffix: ORIENTATIONS[kind_weights(suffix).argmax()] for suffix in (".obj", ".stl", ".ply", ".glb")}
    assert usual == {".obj": ("+y", "+z"), ".stl": ("+z", "-y"), ".ply": ("+z", "-y"), ".glb": ("+y", "+z")}
    assert kind_weights(".glb", moved=True).max() > 0.9 > kind_weights(".glb").max()
    assert has_rule(".glb") and has_rule(".fbx") and not has_rule(".stl") and not has_rule("")
