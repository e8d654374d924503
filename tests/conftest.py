import functools
import gc
import json
import os
import signal
import sys
from pathlib import Path

# Before numpy and torch are loaded, here and in every process that tests start. Threads spin while they wait for each
# other, which was a fifth of the processor time of tests/pipelines; tests of threads set their own number.
os.environ.setdefault("OMP_NUM_THREADS", "1")
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell that starts the tests in the background has Ctrl-C ignored, and so would all processes that tests start.
    signal.signal(signal.SIGINT, signal.default_int_handler)
if sys.dont_write_bytecode:  # else each process compiles torch's Python anew, which takes longer than all else it does
    sys.dont_write_bytecode = False
    del os.environ["PYTHONDONTWRITEBYTECODE"]
    sys.pycache_prefix = os.environ["PYTHONPYCACHEPREFIX"] = str(Path(__file__).parents[1] / "build" / "bytecode")

import numpy as np
import pytest

import bunraku.files.samples
import bunraku_lab.synthetic.samples
from bunraku.core.body.layout import HANDLE_COUNT, HANDLE_NAMES
from bunraku.core.geometry.rotations import matrix_from_axis_angle, matrix_to_6d
from bunraku.core.motion import HandleMotion
from bunraku.core.nn.layers import unit
from bunraku.generation.denoiser import DenoiserConfig
from bunraku.generation.features import decode, encode
from bunraku.language.encoders import TextBatch

# Characters are read-only, so tests share the samples.
bunraku.files.samples.sample_character = functools.cache(bunraku.files.samples.sample_character)
bunraku_lab.synthetic.samples.make_sample = functools.cache(bunraku_lab.synthetic.samples.make_sample)


class WordEncoder:
    """A small text encoder: each word is a random vector of its own."""

    name, token_size, pooled_size = "words", 8, 8

    def encode(self, sentences):
        rows = [
            [np.random.default_rng(sum(map(ord, word))).standard_normal(8) for word in text.split()]
            for text in sentences
        ]
        length = max(map(len, rows))
        tokens, mask = np.zeros((len(rows), length, 8), np.float32), np.zeros((len(rows), length), bool)
        for index, row in enumerate(rows):
            tokens[index, : len(row)], mask[index, : len(row)] = np.stack(row), True
        return TextBatch(tokens, mask, unit(tokens.sum(1)))


def tiny_config(**changes):
    sizes = {
        "width": 16,
        "layers": 2,
        "heads": 2,
        "feedforward": 32,
        "frames": 60,
        "mesh_features": 12,
        "text_size": 8,
        "pooled_size": 8,
    }
    return DenoiserConfig(**{**sizes, "text_encoder": "words", **changes})


def tiny_denoiser(seed=0, **changes):
    """A denoiser of the laboratory with random weights everywhere, so that each input has an effect."""
    torch = pytest.importorskip("torch", reason="networks are made with PyTorch")
    from bunraku_lab.nn.denoiser import Denoiser

    torch.manual_seed(seed)
    model = Denoiser(tiny_config(**changes)).eval().requires_grad_(False)
    for value in model.parameters():
        value.copy_(torch.randn(value.shape) * (0.3 if value.ndim < 2 else value.shape[-1] ** -0.5))
    return model


def swing(handle, frames=60, height=0.9, period=20):
    """A handle that turns to and fro about its z axis, the root standing still."""
    vectors = np.zeros((frames, HANDLE_COUNT, 3))
    vectors[:, HANDLE_NAMES.index(handle), 2] = height * np.sin(np.arange(frames) * 2 * np.pi / period)
    still = np.zeros((frames, 3))
    return HandleMotion(
        np.zeros((frames, HANDLE_COUNT, 3)), matrix_from_axis_angle(vectors), still, matrix_from_axis_angle(still)
    )


def write_motions(folder, motions):
    """Clips as `bunraku data motions` writes them, from {name: (motion, caption, split)}."""
    folder.mkdir()
    index = {}
    for name, (motion, text, split) in motions.items():
        np.savez(
            folder / f"{name}.npz", translations=motion.translations, rotations6d=matrix_to_6d(motion.rotations),
            root_translation=motion.root_translation, root_rotation6d=matrix_to_6d(motion.root_rotation),
            fps=motion.fps,
        )  # fmt: skip
        index[name] = {"texts": [text], "split": split, "frames": len(motion)}
    (folder / "index.json").write_text(json.dumps({"fps": 20, "clips": index}))
    return folder


def pytest_collection_finish():
    """What importing all tests made stays to the end, so the collector need not walk through it again and again."""
    gc.freeze()


@pytest.fixture
def encoder():
    return WordEncoder()


@pytest.fixture(scope="session")
def denoiser():
    return tiny_denoiser


@pytest.fixture(scope="session")
def running():
    """A denoiser with random weights as `bunraku` runs it."""

    def make(seed=0, **changes):
        model = tiny_denoiser(seed, **changes)

        return model.running()

    return make


@pytest.fixture
def config():
    return tiny_config


@pytest.fixture
def swings(tmp_path):
    """A folder of four motions that differ in the handle that moves, three clips each, two to train on and one held
    out.
    """
    parts = {"left_elbow": "waves", "right_knee": "kicks", "spine1": "bows", "head": "nods"}
    motions = {
        f"{verb}_{number}": (
            swing(part, 60, 0.8 + 0.1 * number),
            f"the figure {verb}",
            "test" if number == 2 else "val" if number == 1 else "train",
        )
        for part, verb in parts.items()
        for number in range(3)
    }
    return write_motions(tmp_path / "motions", motions)


@pytest.fixture
def features():
    """Features of one swinging handle."""
    return lambda handle, **how: encode(swing(handle, **how))


@pytest.fixture
def motion_of():
    return decode


@pytest.fixture(scope="session")
def bank_path(tmp_path_factory):
    """A bank of characters as `bunraku data character-bank` writes it: the reference body, a dancer, a dog and a
    person, with f_phi of 12 numbers.
    """
    from dataclasses import replace

    from bunraku.anatomy.names.bone_names import rig_handles
    from bunraku_lab.datasets.characters.bank import bank_row, write_rows
    from bunraku_lab.synthetic.samples import make_sample

    random, rows = np.random.default_rng(0), []
    for name in ("dancer", "dog", "person"):
        character = make_sample(name, 0.5, rigged=True)
        handles = replace(rig_handles(character).top(4), features=random.normal(size=12).astype(np.float32))
        rows.append(bank_row(character, f"samples/{name}", lambda plain, handles=handles: handles))
    return write_rows(tmp_path_factory.mktemp("bank") / "bank.npz", rows, np.zeros(12, np.float32))


@pytest.fixture(scope="session")
def bank(bank_path):
    from bunraku_lab.datasets.characters.bank import load_character_bank

    return load_character_bank(bank_path)


@pytest.fixture
def gesture():
    """Local rotations (1, N, 30, 3, 3) and translations (1, N, 30, 3) of a swinging handle."""

    torch = pytest.importorskip("torch", reason="trainings need PyTorch")

    def make(handle, frames, height=0.9):
        motion = swing(handle, frames, height, period=2 * frames)
        return tuple(torch.from_numpy(np.array(part))[None] for part in (motion.rotations, motion.translations))

    return make


@pytest.fixture
def fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Run a command that must fail with one sentence and status 2 and leave no file behind; give the sentence."""

    import re

    from bunraku.cli import main

    def run(*words: object) -> str:
        before = sorted(tmp_path.rglob("*"))
        status = main([str(word) for word in words])
        said = capsys.readouterr()
        lines = [
            line for line in said.err.strip().splitlines() if not re.fullmatch(r"\w+: \d+\.\d s", line)
        ]  # stages that took long
        assert status == 2, said.err
        assert len(lines) == 1 and lines[0].startswith("bunraku: error: "), said.err
        assert "Traceback" not in said.err and said.out == ""
        assert sorted(tmp_path.rglob("*")) == before
        return lines[0].removeprefix("bunraku: error: ")

    return run
