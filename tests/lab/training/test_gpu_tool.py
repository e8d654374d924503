"""`tools/gpu.py` as it is used: what it packed trains in a folder of its own, without the repository."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bunraku_lab.nn.diffusion.checkpoint import load_denoiser

TOOL = Path(__file__).parents[3] / "tools" / "gpu.py"


def call(tool, folder, *words, status=0):
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHONPATH", "BUNRAKU"))}
    done = subprocess.run(
        [sys.executable, str(tool), *map(str, words)],
        cwd=folder,
        env=clean,
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert done.returncode == status, done.stderr
    return done.stdout + done.stderr


@pytest.fixture
def packed(swings, tmp_path):
    bank = tmp_path / "bank.npz"
    np.savez(bank, features=np.random.default_rng(0).normal(size=(3, 448)).astype(np.float32))
    out = tmp_path / "gpu"
    said = call(TOOL, tmp_path, "pack", "--data", swings, "--mesh-bank", bank, "-o", out)
    assert "8 clips" in said and "MiB" in said
    return out


def test_packed_trained_in_two_calls_and_joined(packed, tmp_path):
    """A step, one more where it stopped, and the weights come back in pieces, whole."""
    assert not (packed / "src/bunraku/weights/diffusion.safetensors").exists()
    back = tmp_path / "back"
    how = ("--preset", "small", "--batch", 2, "--device", "cpu", "--threads", 1, "--piece", 4, "--out", back)
    said = call(packed / "gpu.py", tmp_path, "train", *how, "--steps", 1, "--files", 3, status=1)
    assert "are more than 3 files" in said  # what was trained is kept
    said = call(packed / "gpu.py", tmp_path, "train", *how, "--steps", 2)
    assert "from step 1" in said
    pieces = sorted(back.glob("*.piece"))
    assert len(pieces) >= 5 and max(piece.stat().st_size for piece in pieces) <= 4 << 20
    said = call(TOOL, tmp_path, "join", back, "-o", tmp_path / "run")
    assert "2 steps" in said
    whole = tmp_path / "run" / "diffusion.safetensors"
    assert whole.read_bytes() == (packed / "run" / "diffusion.safetensors").read_bytes()
    model = load_denoiser(whole)
    assert model.notes["steps"] == 2 and model.knows_meshes
    with (tmp_path / "run" / "log.csv").open() as file:
        assert csv.DictReader(file).fieldnames[0] == "step"
    pieces[0].unlink()
    said = call(TOOL, tmp_path, "join", back, "-o", tmp_path / "other", status=1)
    assert "piece 0 of diffusion.safetensors is missing" in said


def test_a_limit_that_comes_too_early_is_said(packed, tmp_path):
    """The alarm rings within seconds, while the libraries are still being loaded."""
    said = call(packed / "gpu.py", tmp_path, "train", "--limit", 0.001, "--steps", 1, "--device", "cpu", status=1)
    assert "the limit came before the first step" in said
