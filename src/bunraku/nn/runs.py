"""What training runs have in common: settings that JSON can say, a log, and a state to go on from."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from bunraku.nn.checkpoints import TrainingState, load_training_state

__all__ = ["append_row", "plain_settings", "resumed"]


def plain_settings(value: Any) -> Any:
    """Settings (`dataclasses.asdict`) in values that JSON can say: paths as text, tuples as lists."""
    if isinstance(value, dict):
        return {key: plain_settings(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_settings(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def append_row(path: Path, row: dict[str, float], columns: Sequence[str] | None = None) -> None:
    """Add a row to a CSV log, with a head line where the file is new.

    Args:
        path: The log.
        row: Its figures by column.
        columns: The columns, of which a row may lack some or have more; those of the row when None.
    """
    new = not path.is_file()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, list(columns or row), extrasaction="ignore")
        if new:
            writer.writeheader()
        writer.writerow({name: f"{value:.6g}" for name, value in row.items()})


def resumed(folder: Path, model: torch.nn.Module, average: torch.nn.Module, optimizer: torch.optim.Optimizer) -> TrainingState | None:
    """Load a run's state into its network, the running mean of that, and its optimiser; None where there is no state yet.

    Raises:
        WeightsError: The state is damaged.
    """
    path = folder / "state.safetensors"
    if not path.is_file():
        return None
    state = load_training_state(path)
    model.load_state_dict(state.models["model"])
    average.load_state_dict(state.models["average"])
    optimizer.load_state_dict(state.optimizers["adam"])
    return state
