"""Networks of torch against those that `bunraku` runs, and states of training."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
import torch

from bunraku.anatomy.handles.networks import OrientationConfig, PredictorConfig, mesh_graph, shape_tokens, turned_tokens
from bunraku.core.body.reference import reference_body
from bunraku.core.geometry.axes import right_angle_rotations
from bunraku.core.geometry.simplify import network_mesh
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.core.nn.layers import gelu, gelu_slope
from bunraku.generation.denoiser import DenoiserConfig
from bunraku.generation.denoiser import load_denoiser as load_running_denoiser
from bunraku.generation.extractor import RADIUS, ExtractorConfig
from bunraku.generation.extractor import load_extractor as load_running_extractor
from bunraku_lab.nn import graph as tensors
from bunraku_lab.nn.checkpoints import load_training_state
from bunraku_lab.nn.denoiser import (
    Denoiser,
    RetrievedExamples,
    load_denoiser,
    running_examples,
    save_denoiser,
)
from bunraku_lab.nn.handles import HandlePredictor, OrientationPredictor
from bunraku_lab.nn.text import Extractor, load_extractor, running_extractor, save_extractor

KINDS = {
    "plain": {}, "one frame a token": {"frames_per_token": 1}, "examples": {"examples": 3},
    "mesh in the adaptation": {"adaptation_mesh": True},
    "joints": {"features": 271, "handles": 30, "adaptation_frame": "joints"},
}  # fmt: skip


def randomised(model, seed=0):
    torch.manual_seed(seed)
    for value in model.parameters():
        value.data.copy_(torch.randn(value.shape) * (0.3 if value.ndim < 2 else value.shape[-1] ** -0.5))
    return model.eval().requires_grad_(False)


def tiny_denoiser(config, **changes):
    model = randomised(Denoiser(config(features=12, handles=3) if "features" not in changes else config()))
    return model if not changes else randomised(Denoiser(replace(model.config, **changes)))


def denoised(model, found, keep, examples=None):
    """What both say of four rows, of which the last is shorter: x0 and adaptation."""
    config = model.config
    x, text, pooled = (torch.randn(4, n, c) for n, c in ((30, config.features), (5, config.text_size), (1, 8)))
    mask, lengths = torch.rand(4, 5) < 0.7, torch.tensor([30, 30, 30, 13])
    mesh, pooled = torch.randn(4, config.mesh_features), torch.randn(4, config.pooled_size)
    told = (text, mask, pooled, mesh, keep, keep)
    with torch.inference_mode():
        theirs = model(x, torch.full((4,), 640), lengths, model.condition(*told, examples))
    shown = None if examples is None else running_examples(examples)
    condition = found.condition(*(part.numpy() for part in told), shown)
    return theirs, found(x.numpy(), 640, lengths.numpy(), condition)


@pytest.mark.parametrize("kind", KINDS)
def test_denoisers(config, kind):
    model = tiny_denoiser(config, **KINDS[kind])
    found = model.running()
    torch.manual_seed(2)
    keep = torch.tensor([True, False, True, True])
    examples = None
    if model.config.examples:
        count = model.config.examples
        values, lengths = torch.randn(4, count, 37, model.config.features), torch.randint(0, 38, (4, count))
        examples = RetrievedExamples(values, lengths, torch.randn(4, count, model.config.pooled_size))
    for shown in (examples, None):
        theirs, ours = denoised(model, found, keep, shown)
        for one, other in zip(theirs, ours, strict=True):
            for row, frames in enumerate((30, 30, 30, 13)):
                # random weights enlarge what rounding does, to 5e-5 in torch too
                np.testing.assert_allclose(other[row, :frames], one[row, :frames], atol=2e-4, rtol=1e-4)
    rows = found.condition(None, None, None, None, np.zeros(4, bool), np.zeros(4, bool))
    whole = found(np.zeros((4, 8, model.config.features), np.float32), 3, np.full(4, 8), rows)[0]
    part = found(np.zeros((2, 8, model.config.features), np.float32), 3, np.full(2, 8), rows.rows(slice(1, 3)), False)
    np.testing.assert_allclose(part[0], whole[1:3], atol=1e-5)
    assert part[1] is None


def test_the_shipped_denoiser():
    path = shipped_checkpoint("diffusion")
    model, found = load_denoiser(path), load_running_denoiser(path)
    assert found.config == model.config and found.notes == model.notes and found.knows_meshes == model.knows_meshes
    torch.manual_seed(4)
    for one, other in zip(*denoised(model, found, torch.tensor([True, False, True, True])), strict=True):
        np.testing.assert_allclose(other[:3], one[:3], rtol=5e-6, atol=5e-5)


def test_a_checkpoint_of_the_laboratory_runs(config, tmp_path):
    model = tiny_denoiser(config)
    found = load_running_denoiser(save_denoiser(tmp_path / "d.safetensors", model, {"steps": 3}, half=False))
    assert isinstance(found.config, DenoiserConfig) and found.config == model.config and found.notes == {"steps": 3}


def tiny_extractor():
    sizes = {"width": 16, "layers": 2, "heads": 2, "feedforward": 24, "embedding": 8, "text_size": 8, "pooled_size": 8}
    model = randomised(Extractor(ExtractorConfig(features=14, dropout=0.0, **sizes)))
    model.mean.normal_(0, 0.3)
    model.std.uniform_(0.5, 1.5)
    model.weights.uniform_(0.2, 1)
    return model


@pytest.mark.parametrize("shipped", [False, True])
def test_extractors_and_their_gradient(shipped, encoder, tmp_path):
    model, found = tiny_extractor(), running_extractor(tiny_extractor())
    if shipped:
        path = shipped_checkpoint("critic")
        model, found = load_extractor(path, kind="ranker"), load_running_extractor(path, kind="ranker")
    torch.manual_seed(5)
    size = model.config.features
    values, lengths = 3 * torch.randn(3, 41, size), torch.tensor([41, 8, 30])  # some are beyond what counts
    goals = torch.nn.functional.normalize(torch.randn(3, model.config.embedding), dim=-1)
    values.requires_grad_(True)
    vectors = model.motion(values, lengths)
    ((vectors * goals).sum() / RADIUS).backward()
    np.testing.assert_allclose(found.motion(values.detach().numpy(), lengths.numpy()), vectors.detach(), atol=1e-4)
    ours = found.cosine_gradient(values.detach().numpy(), lengths.numpy(), goals.numpy())
    np.testing.assert_allclose(ours, values.grad, atol=2e-5 * float(values.grad.abs().max()) + 1e-8, rtol=1e-3)
    if not shipped:
        text = encoder.encode(["walks far", "jumps"])
        np.testing.assert_allclose(found.text(text.arrays()), model.text(text), atol=1e-4)
        again = load_running_extractor(save_extractor(tmp_path / "e.safetensors", model, {"steps": 2}))
        assert again.config == model.config and again.notes == {"steps": 2}


def test_orientation():
    model = randomised(OrientationPredictor(OrientationConfig(16, 2, 2, 24, 1.3)))
    points = np.random.default_rng(0).normal(size=(200, 3))
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    tokens = shape_tokens(points * [1, 2, 0.5], normals, np.ones(200), 24)
    turned = turned_tokens(tokens, right_angle_rotations().astype(np.float32))
    both = np.stack([turned, turned * np.array([-1, 1, 1, -1, 1, 1, 1, 1, 1, 1], np.float32)])
    expected = (model(torch.from_numpy(both).flatten(0, 1)).reshape(2, -1).mean(0) / 1.3).softmax(-1)
    np.testing.assert_allclose(model.running().probabilities(tokens), expected, atol=1e-5, rtol=1e-4)


def test_handles():
    body = reference_body()
    mesh = network_mesh(body.vertices, body.faces, 600)
    model = randomised(HandlePredictor(PredictorConfig((8, 12, 16), (24, 16), heads=2, anchors=40, depth=2)))
    arrays = mesh.vertices, mesh.normals, mesh.edges, mesh.areas, 40
    graph, theirs = mesh_graph(*arrays), tensors.mesh_graph(*arrays)
    found = model.running()
    for one, other in ((graph, theirs), (graph.mirrored(), theirs.mirrored())):
        ours, expected = found(one), model(other)
        np.testing.assert_allclose(ours.weights[one.position], expected.weights, atol=1e-5)
        np.testing.assert_allclose(ours.features, expected.features, atol=2e-5, rtol=1e-4)


def test_gelu_and_its_slope():
    x = torch.linspace(-12, 12, 40_001, requires_grad=True)
    value = torch.nn.functional.gelu(x)
    value.sum().backward()
    np.testing.assert_allclose(gelu(x.detach().numpy().copy()), value.detach(), atol=1e-6)
    np.testing.assert_allclose(gelu_slope(x.detach().numpy()), x.grad, atol=3e-6)


def test_a_kill_while_saving_never_leaves_a_broken_state(tmp_path):
    code = (
        "import sys, torch; from bunraku_lab.nn.checkpoints import TrainingState, save_training_state\n"
        "step = 0\n"
        "while True:\n"
        "    step += 1\n"
        "    save_training_state(sys.argv[1], TrainingState(step, {'m': {'w': torch.full((200_000,), float(step))}}))\n"
    )
    path = tmp_path / "s.safetensors"
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(path)],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"},
    )
    try:
        for _ in range(600):
            if path.exists():
                break
            time.sleep(0.05)
        time.sleep(0.05)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    state = load_training_state(path)
    assert state.step >= 1 and bool((state.models["m"]["w"] == state.step).all())
