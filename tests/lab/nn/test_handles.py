"""The networks of handles and orientation."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bunraku.anatomy.handles.networks import OrientationConfig, PredictorConfig, shape_tokens, turned_tokens
from bunraku.core.geometry.axes import right_angle_rotations
from bunraku.errors import WeightsError
from bunraku_lab.nn.graph import EdgeConv, edge_conv_reference, mesh_graph
from bunraku_lab.nn.handles import HandlePredictor, OrientationPredictor, grow_predictor

SMALL = PredictorConfig(levels=(8, 12, 16), hidden=(16, 16), anchors=10)


def small_graph(seed: int = 0, count: int = 30):
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(count, 3)) * 0.2
    normals = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    edges = np.unique(np.sort(rng.integers(0, count - 1, (70, 2)), axis=1), axis=0)
    edges = edges[edges[:, 0] != edges[:, 1]]  # the last vertex has no edge at all
    return mesh_graph(positions, normals, edges, rng.random(count) + 0.1, anchors=10), (positions, normals, edges)


def test_edge_conv_equals_its_definition_and_its_gradient():
    torch.manual_seed(0)
    graph, _ = small_graph()
    layer = EdgeConv(6, 5)
    x = graph.inputs.clone().requires_grad_()
    fast, slow = layer(x, graph), edge_conv_reference(layer, x, graph)
    torch.testing.assert_close(fast, slow, atol=1e-6, rtol=1e-5)
    pull = torch.randn_like(fast)
    torch.testing.assert_close(
        torch.autograd.grad(fast, x, pull)[0], torch.autograd.grad(slow, x, pull)[0], atol=1e-5, rtol=1e-4
    )


def test_predictor_shapes_and_that_order_does_not_matter():
    torch.manual_seed(1)
    model = HandlePredictor(SMALL).eval()
    graph, (positions, normals, edges) = small_graph()
    out = model(graph)
    assert out.weights.shape == (30, 30) and out.features.shape == (36,)
    torch.testing.assert_close(out.weights.sum(1), torch.ones(30))
    order = np.random.default_rng(3).permutation(30)
    back = np.empty(30, int)
    back[order] = np.arange(30)
    areas = graph.areas.numpy()[order]
    shuffled = model(mesh_graph(positions[order], normals[order], back[edges], areas, anchors=10))
    torch.testing.assert_close(shuffled.weights, out.weights[order], atol=1e-3, rtol=1e-2)
    assert HandlePredictor().config.levels == (64, 128, 256)


def test_a_deeper_predictor_begins_as_the_one_it_grew_from(tmp_path):
    shallow = HandlePredictor(replace(SMALL, depth=1)).eval()
    path = shallow.save(tmp_path / "shallow.safetensors")
    deep = HandlePredictor(replace(SMALL, depth=3)).eval()
    graph, _ = small_graph()
    grow_predictor(deep, path)
    torch.testing.assert_close(deep(graph).logits, shallow(graph).logits)
    with pytest.raises(WeightsError, match="do not fit"):
        grow_predictor(HandlePredictor(replace(SMALL, levels=(8, 12, 20))), path)
    with pytest.raises(WeightsError, match="do not fit"):
        grow_predictor(shallow, deep.save(tmp_path / "deep.safetensors"))


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


def test_turning_the_mesh_permutes_the_scores():
    model = tiny()
    tokens, running = shape_tokens(*cloud(), 32), model.running()
    with torch.no_grad():
        scores = model.scores(tokens[None])[0]
        chances = running.probabilities(tokens)
        for rotation in ROTATIONS:
            there = permutation(rotation)
            assert sorted(there) == list(range(24))
            turned = turned_tokens(tokens, rotation[None].astype(np.float32))[0]
            assert (model.scores(turned[None])[0] - scores[there]).abs().max() < 1e-5
            assert np.abs(running.probabilities(turned) - chances[there]).max() < 1e-6
    assert scores.std() > 1e-4 and chances.sum() == pytest.approx(1, abs=1e-5)


def test_a_mirror_image_keeps_up_and_front():
    running = tiny().running()
    points, normals, areas = cloud()
    flip = np.array([-1.0, 1, 1])
    one, other = (
        running.probabilities(shape_tokens(p, n, areas, 32))
        for p, n in ((points, normals), (points * flip, normals * flip))
    )
    from bunraku.core.geometry.axes import ORIENTATIONS

    for here, (up, front) in enumerate(ORIENTATIONS):
        mirrored = tuple(axis if axis[1] != "x" else ("-x" if axis == "+x" else "+x") for axis in (up, front))
        assert float(other[ORIENTATIONS.index(mirrored)]) == pytest.approx(float(one[here]), abs=1e-5)


def test_checkpoints_come_back(tmp_path):
    model = tiny()
    path = model.save(tmp_path / "o.safetensors")
    again = OrientationPredictor.load(path)
    tokens = shape_tokens(*cloud(), 32)[None]
    assert again.config == model.config and torch.equal(again.scores(tokens), model.scores(tokens))
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(WeightsError, match="damaged"):
        OrientationPredictor.load(path)
