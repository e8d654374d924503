import os
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from bunraku.formats.files import temporary_prefix
from bunraku.nn.checkpoints import TrainingState, save_training_state
from bunraku_lab.training.runs.runs import append_row, plain_settings, resumed


@dataclass
class Settings:
    out: Path = Path("runs/x")
    sizes: tuple[int, ...] = (1, 2)
    nested: dict[str, Path] | None = None


def test_settings_become_what_json_can_say():
    assert plain_settings(asdict(Settings(nested={"a": Path("b")}))) == {
        "out": "runs/x",
        "sizes": [1, 2],
        "nested": {"a": "b"},
    }


def test_rows_go_below_one_head_line(tmp_path):
    log = tmp_path / "log.csv"
    append_row(log, {"step": 1, "loss": 0.123456789, "extra": 3}, ("step", "loss", "later"))
    append_row(log, {"step": 2, "later": 5}, ("step", "loss", "later"))
    assert log.read_text().splitlines() == ["step,loss,later", "1,0.123457,", "2,,5"]


def test_a_log_that_was_only_begun_gets_its_head_line(tmp_path):
    (tmp_path / "log.csv").touch()
    append_row(tmp_path / "log.csv", {"step": 1})
    assert (tmp_path / "log.csv").read_text().split() == ["step", "1"]


def test_a_run_goes_on_from_its_state_or_starts_anew(tmp_path):
    def parts():
        model, average = torch.nn.Linear(2, 1), torch.nn.Linear(2, 1)
        return model, average, torch.optim.Adam(model.parameters())

    first = parts()
    assert resumed(tmp_path, *first) is None
    first[0](torch.ones(1, 2)).sum().backward()
    first[2].step()
    models = {"model": first[0].state_dict(), "average": first[1].state_dict()}
    save_training_state(tmp_path / "state.safetensors", TrainingState(7, models, {"adam": first[2].state_dict()}))
    second = parts()
    assert resumed(tmp_path, *second).step == 7
    assert torch.equal(second[0].weight, first[0].weight) and torch.equal(second[1].weight, first[1].weight)
    assert torch.equal(second[2].state_dict()["state"][0]["exp_avg"], first[2].state_dict()["state"][0]["exp_avg"])


def test_what_a_killed_run_left_is_swept_when_it_goes_on(tmp_path):
    process = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    prefix = temporary_prefix("state.safetensors").replace(f"-{os.getpid()}-", f"-{process.stdout.strip()}-")
    (tmp_path / f"{prefix}abcdefgh.tmp").write_bytes(b"half")
    model = torch.nn.Linear(1, 1)
    assert resumed(tmp_path, model, torch.nn.Linear(1, 1), torch.optim.SGD(model.parameters())) is None
    assert not list(tmp_path.iterdir())
