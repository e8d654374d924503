"""Two processes that train together take the step that one would take with both batches."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from bunraku.generation.features import FeatureStatistics
from bunraku_lab.nn.checkpoints import load_training_state
from bunraku_lab.training.diffusion.train import TrainingConfig
from bunraku_lab.training.diffusion.trainer import Trainer
from bunraku_lab.training.losses.motion import motion_losses
from bunraku_lab.training.rows.banks import TextBank
from bunraku_lab.training.rows.clip_rows import ClipSet
from bunraku_lab.training.rows.clips import load_clips

pytest.importorskip("accelerate")

SCRIPT = """
import importlib.util, sys
from pathlib import Path
import torch
from bunraku_lab.training.diffusion.train import TrainingConfig, train_diffusion
torch.set_num_threads(1)
spec = importlib.util.spec_from_file_location("helpers", sys.argv[1])
helpers = importlib.util.module_from_spec(spec)
spec.loader.exec_module(helpers)
config = TrainingConfig(data=Path(sys.argv[2]), out=Path(sys.argv[3]), minutes=None, steps=3, batch=3,
                        device="cpu", bf16=False, validate_every=3)
train_diffusion(config, helpers.tiny_config(), helpers.WordEncoder())
"""


def test_two_processes_are_one_with_both_batches(swings, tmp_path, config, encoder):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    words = [
        sys.executable,
        "-c",
        SCRIPT,
        str(Path(__file__).parents[2] / "conftest.py"),
        str(swings),
        str(tmp_path / "run"),
    ]
    common = {
        **os.environ,
        "WORLD_SIZE": "2",
        "LOCAL_WORLD_SIZE": "2",
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": port,
        "OMP_NUM_THREADS": "1",
    }
    common |= {"ACCELERATE_USE_CPU": "true"}
    started = [
        subprocess.Popen(words, env={**common, "RANK": rank, "LOCAL_RANK": rank}, stdout=-1, stderr=-1, text=True)
        for rank in "01"
    ]
    said = [process.communicate(timeout=120) for process in started]
    assert [process.returncode for process in started] == [0, 0], said
    assert "2 processes" in " ".join(said[0][0].split()) and "saved" not in said[1][0]
    together = load_training_state(tmp_path / "run" / "state.safetensors")

    run = TrainingConfig(data=swings, minutes=None, steps=3, batch=3, device="cpu", bf16=False)
    clips = load_clips(swings)
    statistics = FeatureStatistics.measure([entry["features"] for entry in clips.values() if entry["split"] == "train"])
    train = ClipSet(clips, statistics, "train", 60)
    bank, trainer = TextBank(encoder, train.sentences()), Trainer(run, config(), statistics)
    for step in range(3):
        for group in trainer.optimizer.param_groups:
            group["lr"] = trainer.learning_rate()
        for number in (2 * step, 2 * step + 1):
            batch = train.batch(0, number, 3, run.compose)
            example = trainer.example(batch, bank(batch.sentences), [0, number])
            motion, velocity = (
                part.mean()
                for part in motion_losses(
                    trainer.predict(trainer.model, example)[0], example.clean, example.lengths, trainer.weights
                )
            )
            (0.5 * (motion + run.velocity_weight * velocity)).backward()
        trainer._step(learns=False)
    assert together.step == 3
    for name, value in trainer.model.state_dict().items():
        torch.testing.assert_close(together.models["model"][name], value, atol=2e-5, rtol=1e-3)
