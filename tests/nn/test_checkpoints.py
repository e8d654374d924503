import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import torch

from bunraku.errors import WeightsError
from bunraku.nn.checkpoints import (
    TrainingState,
    load_checkpoint,
    load_training_state,
    save_checkpoint,
    save_training_state,
    shipped_checkpoint,
)


def _state():
    generator = torch.Generator().manual_seed(3)
    return {
        "a.weight": torch.randn(64, 32, generator=generator),
        "a.bias": torch.randn(32, generator=generator),
        "steps": torch.tensor(7),
    }


def test_roundtrip_is_exact_in_float32(tmp_path):
    save_checkpoint(tmp_path / "deep" / "m.safetensors", _state(), {"width": 3, "names": ["é", None]}, "thing")
    state, config = load_checkpoint(tmp_path / "deep" / "m.safetensors", "thing")
    assert config == {"width": 3, "names": ["é", None]}
    assert all(torch.equal(state[name], value) for name, value in _state().items()) and set(state) == set(_state())


def test_half_stores_matrices_in_half_the_size_and_loads_float32(tmp_path):
    big = {"w": torch.randn(256, 256), "huge": torch.full((2048,), 1e6), "bias": torch.randn(8) * 1e-9}
    full = save_checkpoint(tmp_path / "f.safetensors", big, {}, "thing").stat().st_size
    half = save_checkpoint(tmp_path / "h.safetensors", big, {}, "thing", half=True).stat().st_size
    state, _ = load_checkpoint(tmp_path / "h.safetensors", "thing")
    assert full - half == 2 * 256 * 256
    assert all(value.dtype == torch.float32 for value in state.values())
    assert torch.equal(state["huge"], big["huge"]) and torch.equal(state["bias"], big["bias"])
    torch.testing.assert_close(state["w"], big["w"], rtol=1e-3, atol=1e-6)


def test_bad_files_are_one_clear_error(tmp_path):
    good = save_checkpoint(tmp_path / "m.safetensors", _state(), {}, "thing")
    data = good.read_bytes()
    cases = {
        "missing": None,
        "empty": b"",
        "header": data[:40],
        "cut": data[:-100],
        "noise": bytes(range(256)) * 20,
        "huge": b"\xff" * 8 + data[8:],
    }
    for name, content in cases.items():
        path = tmp_path / f"{name}.safetensors"
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(WeightsError, match=name):
            load_checkpoint(path, "thing")
    with pytest.raises(WeightsError, match="kind 'thing', but 'other'"):
        load_checkpoint(good, "other")
    from safetensors.torch import save_file

    save_file({"x": torch.zeros(1)}, tmp_path / "foreign.safetensors")
    with pytest.raises(WeightsError, match="not a Bunraku checkpoint"):
        load_checkpoint(tmp_path / "foreign.safetensors", "thing")
    save_checkpoint(tmp_path / "nan.safetensors", {"x": torch.tensor([float("nan")])}, {}, "thing")
    with pytest.raises(WeightsError, match="not numbers"):
        load_checkpoint(tmp_path / "nan.safetensors", "thing")


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = save_checkpoint(tmp_path / "m.safetensors", _state(), {"n": 1}, "thing")
    with pytest.raises(TypeError):
        save_checkpoint(path, _state(), {"n": object()}, "thing")
    with pytest.raises(WeightsError, match="cannot be written"):
        save_checkpoint(path / "below" / "a-file.safetensors", _state(), {}, "thing")
    assert load_checkpoint(path, "thing")[1] == {"n": 1}
    assert [entry.name for entry in tmp_path.iterdir()] == ["m.safetensors"]


def test_shipped_checkpoint_looks_where_the_environment_says(tmp_path, monkeypatch):
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path))
    with pytest.raises(WeightsError, match="'demo' weights are missing"):
        shipped_checkpoint("demo")
    save_checkpoint(tmp_path / "demo.safetensors", _state(), {}, "thing")
    assert shipped_checkpoint("demo") == tmp_path / "demo.safetensors"


def _train(model, optimizer, generator, steps):
    for _ in range(steps):
        optimizer.zero_grad()
        (model(torch.randn(4, 5, generator=generator)) ** 2).sum().backward()
        optimizer.step()


def _parts():
    torch.manual_seed(0)
    model = torch.nn.Linear(5, 3)
    return model, torch.optim.AdamW(model.parameters(), lr=0.1), torch.Generator().manual_seed(5)


def test_a_resumed_run_is_the_uninterrupted_one(tmp_path):
    whole = _parts()
    _train(*whole, 6)
    model, optimizer, generator = _parts()
    _train(model, optimizer, generator, 3)
    numpy_state = np.random.default_rng(4).bit_generator.state
    state = TrainingState(
        3,
        {"model": model.state_dict()},
        {"adam": optimizer.state_dict()},
        {"lr": 0.1},
        {"rng": numpy_state},
        {"noise": generator.get_state()},
    )
    save_training_state(tmp_path / "s.safetensors", state)
    back = load_training_state(tmp_path / "s.safetensors")
    model, optimizer, _ = _parts()
    model.load_state_dict(back.models["model"])
    optimizer.load_state_dict(back.optimizers["adam"])
    generator = torch.Generator()
    generator.set_state(back.generators["noise"])
    assert back.step == 3 and back.config == {"lr": 0.1} and back.values["rng"] == numpy_state
    _train(model, optimizer, generator, 3)
    assert all(torch.equal(a, b) for a, b in zip(model.parameters(), whole[0].parameters(), strict=True))


def test_a_kill_while_saving_never_leaves_a_broken_state(tmp_path):
    code = (
        "import sys, torch; from bunraku.nn.checkpoints import *\n"
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
