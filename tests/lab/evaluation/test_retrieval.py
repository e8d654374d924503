import json

import numpy as np
import pytest
from swings import PARTS, WordEncoder

from bunraku.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.diffusion.denoiser_config import DenoiserConfig
from bunraku.diffusion.generation import networks
from bunraku.errors import FormatError, OptionError
from bunraku.geometry.rotations import matrix_from_axis_angle, matrix_to_6d
from bunraku_lab.evaluation.motion.retrieval import draw_candidates, retrieval, wilson_interval
from bunraku_lab.nn.diffusion.checkpoint import load_denoiser, save_denoiser
from bunraku_lab.training.diffusion.train import TrainingConfig, train_diffusion


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Six motions, each of one handle, and a small denoiser that was trained on them."""
    folder = tmp_path_factory.mktemp("retrieval")
    data, index = folder / "motions", {}
    data.mkdir()
    for part, verb in PARTS.items():
        for number, split in enumerate(("train", "train", "val", "test")):
            vectors = np.zeros((40, HANDLE_COUNT, 3))
            vectors[:, HANDLE_NAMES.index(part), 2] = (0.8 + 0.1 * number) * np.sin(np.arange(40) / 3)
            six = matrix_to_6d(matrix_from_axis_angle(vectors))
            root = {"root_translation": np.zeros((40, 3)), "root_rotation6d": six[:, 0]}
            np.savez(
                data / f"{verb}{number}.npz",
                translations=np.zeros((40, HANDLE_COUNT, 3)),
                rotations6d=six,
                fps=20.0,
                **root,
            )
            index[f"{verb}{number}"] = {"texts": [f"the figure {verb}"], "split": split, "frames": 40}
    (data / "index.json").write_text(json.dumps({"fps": 20, "clips": index}))
    network = DenoiserConfig(
        width=16,
        layers=2,
        heads=2,
        feedforward=32,
        frames=40,
        mesh_features=12,
        text_encoder="words",
        text_size=8,
        pooled_size=8,
    )
    run = TrainingConfig(
        data=data,
        out=folder / "run",
        minutes=None,
        steps=250,
        batch=12,
        learning_rate=5e-3,
        warmup=10,
        bf16=False,
        device="cpu",
        ema=0.95,
        drop_text=0.02,
    )
    return data, train_diffusion(run, network, WordEncoder())


@pytest.fixture(autouse=True)
def words(monkeypatch):
    """Weights that name the encoder "words" get it."""
    networks._encoder.cache_clear()
    monkeypatch.setattr(networks, "text_encoder", lambda name, folder=None: WordEncoder())


def test_a_model_that_reads_finds_the_sentences(trained):
    data, weights = trained
    calls = []
    result = retrieval(data, checkpoint=weights, candidates=6, progress=lambda done, total: calls.append((done, total)))
    assert result["clips"] == 6 and result["candidates"] == 6 and result["chance"] == pytest.approx(1 / 6)
    assert result["top1"] >= 5 / 6 and result["times_chance"] == pytest.approx(6 * result["top1"])
    assert (
        result["top1"] <= result["top2"] <= result["top3"]
        and result["top1_interval"][0] <= result["top1"] <= result["top1_interval"][1]
    )
    assert calls == [(done, 6) for done in range(1, 7)]
    assert json.loads(json.dumps(result)) == result == retrieval(data, checkpoint=weights, candidates=6)
    assert {row["caption"] for row in result["rows"]} == {f"the figure {verb}" for verb in PARTS.values()}


def test_a_model_that_cannot_read_wins_nothing(trained, tmp_path):
    data, weights = trained
    model = load_denoiser(weights)
    for layer in (model.text_in, model.pooled_in):
        layer.weight.zero_()
    for layer in model.layers:  # nor count the words
        layer.cross_out.weight.zero_()
    result = retrieval(data, checkpoint=save_denoiser(tmp_path / "blind.safetensors", model), candidates=6)
    assert result["top1"] <= 0.5


def test_candidates_are_of_different_meanings():
    labels = ["kick", "a person kicks", "front kick", "walk", "run", "jump", "a person does a squat"]
    for seed in range(10):
        found = draw_candidates(["Front kick", "mawashigeri"], labels, 5, np.random.default_rng(seed))
        assert found[0] == "Front kick" and sorted(found[1:]) == ["a person does a squat", "jump", "run", "walk"]
    with pytest.raises(OptionError, match="fewer than the 6"):
        draw_candidates(["Front kick"], labels, 6, np.random.default_rng(0))


def test_the_interval_is_wilsons():
    assert wilson_interval(10, 20) == pytest.approx((0.2993, 0.7007), abs=1e-4)  # Newcombe 1998, method 3
    low, high = wilson_interval(0, 30)
    assert low == 0 and high == pytest.approx(0.1135, abs=1e-4)
    assert wilson_interval(0, 0) == (0, 1)


def test_bad_settings_and_data_are_clear(trained, tmp_path):
    data, weights = trained
    for how in ({"candidates": 1}, {"levels": ()}, {"levels": (1000,)}, {"frames": 0}, {"candidates": 40}):
        with pytest.raises(OptionError):
            retrieval(data, checkpoint=weights, **how)
    with pytest.raises(FormatError, match="bunraku data motions"):
        retrieval(tmp_path, checkpoint=weights)
