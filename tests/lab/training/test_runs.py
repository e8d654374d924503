"""What all training runs share."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from bunraku.core.files import temporary_prefix
from bunraku.errors import OptionError
from bunraku_lab.training.runs.run import AveragedRun, append_row, bf16_is_fast, share_done


def test_rows_go_below_one_head_line(tmp_path):
    log = tmp_path / "log.csv"
    append_row(log, {"step": 1, "loss": 0.123456789, "extra": 3}, ("step", "loss", "later"))
    append_row(log, {"step": 2, "later": 5}, ("step", "loss", "later"))
    assert log.read_text().splitlines() == ["step,loss,later", "1,0.123457,", "2,,5"]


def test_a_processor_without_bf16_in_hardware_is_not_asked_for_it():
    info = Path("/proc/cpuinfo")
    if not info.is_file() or "flags" not in info.read_text():
        pytest.skip("this system does not list the processor's instructions")
    flags = set(info.read_text().split())
    assert bf16_is_fast("cpu") == bool(flags & {"avx512_bf16", "amx_bf16"})
    assert bf16_is_fast(torch.device("cpu")) == bf16_is_fast("cpu")


def run(folder, width=2):
    model, average = (torch.nn.Linear(width, 1, bias=False) for _ in range(2))
    return AveragedRun(folder, model, average, torch.optim.SGD(model.parameters(), lr=0.0))


def test_a_run_ends_by_its_minutes_or_by_its_steps():
    assert share_done(30, 1, 7, 10) == 0.5 and share_done(30, 0, 7, 10) == 0.7
    assert share_done(90, 1, 0, 10) == 1 and share_done(0, 0, 20, 10) == 1


def test_the_mean_follows_quickly_at_first(tmp_path):
    one = run(tmp_path)
    start = one.model.weight.detach().clone()
    assert torch.equal(one.average.weight, start)
    one.set_rate(1.0, 1, 0.0)
    one.model.weight.grad = torch.tensor([[0.6, 0.0]])  # shorter than 1, so it is not clipped
    one.update(decay=0.9)
    moved = start - torch.tensor([[0.6, 0.0]])
    assert torch.allclose(one.model.weight, moved) and one.model.weight.grad is None
    keep = 1 / 11  # the first step of 10 + 1
    assert torch.allclose(one.average.weight, keep * start + (1 - keep) * moved)


def test_it_goes_on_from_its_state_and_not_from_that_of_another_network(tmp_path):
    one, again = run(tmp_path), run(tmp_path)
    assert again.restore_state() is None
    one.step, one.seconds = 5, 2.5
    one.save_state({}, {"epoch": 3})
    assert again.restore_state().values["epoch"] == 3 and (again.step, again.seconds) == (5, 2.5)
    assert torch.equal(again.model.weight, one.model.weight)
    with pytest.raises(OptionError, match="another network"):
        run(tmp_path, width=3).restore_state()


def test_it_goes_on_with_the_optimisers_moments(tmp_path):
    def parts():
        model, average = torch.nn.Linear(2, 1), torch.nn.Linear(2, 1)
        return AveragedRun(tmp_path, model, average, torch.optim.Adam(model.parameters()))

    first = parts()
    first.model(torch.ones(1, 2)).sum().backward()
    first.update(decay=0.9)
    first.save_state({}, {})
    second = parts()
    assert second.restore_state().step == 1
    assert torch.equal(second.model.weight, first.model.weight) and torch.equal(
        second.average.weight, first.average.weight
    )
    moments = [one.optimizer.state_dict()["state"][0]["exp_avg"] for one in (first, second)]
    assert torch.equal(*moments)


def test_what_a_killed_run_left_is_swept_when_it_goes_on(tmp_path):
    process = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    prefix = temporary_prefix("state.safetensors").replace(f"-{os.getpid()}-", f"-{process.stdout.strip()}-")
    (tmp_path / f"{prefix}abcdefgh.tmp").write_bytes(b"half")
    assert run(tmp_path).restore_state() is None
    assert not list(tmp_path.iterdir())
