"""The orientation network: turning what it sees by one of the 24 rotations permutes its scores and changes nothing
else.
"""

import numpy as np
import pytest
import torch

from bunraku.errors import WeightsError
from bunraku.geometry.axes import right_angle_rotations
from bunraku.handles.inference.orientation import OrientationConfig, shape_tokens
from bunraku_lab.nn.handles.orientation_net import (
    OrientationPredictor,
    load_orientation_predictor,
    save_orientation_predictor,
    turned_tokens,
)

ROTATIONS = right_angle_rotations()


def cloud(count=600, seed=0):
    """A lopsided lump: points, normals, areas."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = normals * [1, 2, 0.5] + 0.3 * np.sin(3 * normals[:, [1, 2, 0]])
    return points, normals, rng.uniform(0.5, 1.5, count)


def tiny():
    torch.manual_seed(0)
    return OrientationPredictor(OrientationConfig(width=16, layers=2, heads=2, anchors=32)).eval()


def permutation(rotation):
    """Where each of the 24 goes when the mesh is turned first: R_i R = R_p(i)."""
    return [int(np.abs(ROTATIONS - turn @ rotation).max(axis=(1, 2)).argmin()) for turn in ROTATIONS]


def test_tokens_say_what_is_nearest_to_them():
    points, normals, areas = cloud()
    tokens = shape_tokens(points, normals, areas, 32)
    assert tokens.shape == (32, 10) and tokens.dtype == np.float32 and np.isfinite(tokens).all()
    mass = np.exp(tokens[:, 9]) / 32
    assert mass.sum() == pytest.approx(1, abs=1e-5)
    low, high = points.min(axis=0), points.max(axis=0)
    share = areas / areas.sum()
    centre = (share @ points - (low + high) / 2) / (high - low).max()
    assert (
        np.abs(mass @ tokens[:, :3] - centre).max() < 1e-3
        and np.abs(mass @ tokens[:, 3:6] - share @ normals).max() < 1e-3
    )


def test_tokens_do_not_depend_on_place_and_size():
    points, normals, areas = cloud()
    tokens = shape_tokens(points, normals, areas, 32)
    for scale, move in ((1e-4, 0.0), (1000.0, 5000.0)):
        assert np.abs(shape_tokens(points * scale + move, normals, 7 * areas, 32) - tokens).max() < 1e-4


def test_turning_tokens_is_turning_the_mesh():
    points, normals, areas = cloud()
    tokens = torch.from_numpy(shape_tokens(points, normals, areas, 32))
    turned = turned_tokens(tokens, torch.from_numpy(ROTATIONS).float()).numpy()
    for rotation, expected in zip(ROTATIONS, turned, strict=True):
        assert np.abs(shape_tokens(points @ rotation.T, normals @ rotation.T, areas, 32) - expected).max() < 1e-5


def test_turning_the_mesh_permutes_the_scores():
    model = tiny()
    tokens = torch.from_numpy(shape_tokens(*cloud(), 32))
    with torch.no_grad():
        scores = model.scores(tokens[None])[0]
        chances = model.probabilities(tokens)
        for rotation in ROTATIONS:
            there = permutation(rotation)
            assert sorted(there) == list(range(24))
            turned = turned_tokens(tokens, torch.from_numpy(rotation[None]).float())[0]
            assert (model.scores(turned[None])[0] - scores[there]).abs().max() < 1e-5
            assert (model.probabilities(turned) - chances[there]).abs().max() < 1e-6
    assert scores.std() > 1e-4 and chances.sum() == pytest.approx(1, abs=1e-5)


def test_a_mirror_image_keeps_up_and_front():
    model = tiny()
    points, normals, areas = cloud()
    flip = np.array([-1.0, 1, 1])
    with torch.no_grad():
        one, other = (
            model.probabilities(torch.from_numpy(shape_tokens(p, n, areas, 32)))
            for p, n in ((points, normals), (points * flip, normals * flip))
        )
    from bunraku.geometry.axes import ORIENTATIONS

    for here, (up, front) in enumerate(ORIENTATIONS):
        mirrored = tuple(axis if axis[1] != "x" else ("-x" if axis == "+x" else "+x") for axis in (up, front))
        assert float(other[ORIENTATIONS.index(mirrored)]) == pytest.approx(float(one[here]), abs=1e-5)


def test_checkpoints_come_back(tmp_path):
    model = tiny()
    path = save_orientation_predictor(tmp_path / "o.safetensors", model)
    again = load_orientation_predictor(path)
    tokens = torch.from_numpy(shape_tokens(*cloud(), 32))
    with torch.no_grad():
        assert again.config == model.config and torch.equal(again.probabilities(tokens), model.probabilities(tokens))
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(WeightsError, match="damaged"):
        load_orientation_predictor(path)
