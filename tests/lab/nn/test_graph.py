from dataclasses import replace

import numpy as np
import pytest
import torch

from bunraku.errors import WeightsError
from bunraku.handles.inference.predictor import PredictorConfig
from bunraku_lab.nn.edge_conv import EdgeConv, edge_conv_reference
from bunraku_lab.nn.handles.graph import mesh_graph
from bunraku_lab.nn.handles.predictor import HandlePredictor, grow_predictor, load_predictor, save_predictor

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


def test_gather_and_spread_keep_constants():
    graph, _ = small_graph()
    torch.testing.assert_close(graph.spread @ torch.ones(10, 1), torch.ones(30, 1))
    torch.testing.assert_close(graph.gather @ torch.ones(30, 1), torch.ones(10, 1))
    assert abs(float(graph.areas.sum()) - 1) < 1e-5


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


def test_checkpoint_carries_its_config(tmp_path):
    model = HandlePredictor(SMALL).eval()
    again = load_predictor(save_predictor(tmp_path / "handles.safetensors", model, {"results": {"held_accuracy": 0.5}}))
    assert again.config == SMALL
    graph, _ = small_graph()
    assert torch.equal(again(graph).logits, model(graph).logits)


def test_a_deeper_predictor_begins_as_the_one_it_grew_from(tmp_path):
    shallow = HandlePredictor(replace(SMALL, depth=1)).eval()
    path = save_predictor(tmp_path / "shallow.safetensors", shallow)
    deep = HandlePredictor(replace(SMALL, depth=3)).eval()
    graph, _ = small_graph()
    grow_predictor(deep, path)
    torch.testing.assert_close(deep(graph).logits, shallow(graph).logits)
    with pytest.raises(WeightsError, match="do not fit"):
        grow_predictor(HandlePredictor(replace(SMALL, levels=(8, 12, 20))), path)
    with pytest.raises(WeightsError, match="do not fit"):
        grow_predictor(shallow, save_predictor(tmp_path / "deep.safetensors", deep))


def test_training_draws_other_anchors_each_time():
    graph, (positions, normals, edges) = small_graph()
    rng = np.random.default_rng(0)
    areas = graph.areas.numpy()
    first, second = (mesh_graph(positions, normals, edges, areas, 6, rng).anchors for _ in range(2))
    assert not torch.equal(first, second)
    rows = {tuple(row) for row in positions.astype(np.float32).round(5).tolist()}
    assert all(tuple(row) in rows for row in first.numpy().round(5).tolist())  # anchors stand on vertices, noise or not
