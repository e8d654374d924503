import os
import signal
import subprocess
import sys
import time

import numpy as np
import torch

from bunraku_lab.nn.checkpoints import TrainingState, load_training_state, save_training_state


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
        "import sys, torch; from bunraku_lab.nn.checkpoints import *\n"
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
