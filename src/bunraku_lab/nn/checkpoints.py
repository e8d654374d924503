"""Checkpoints of what is trained: networks of torch, and training states that survive a kill.

A network's weights are the file that `bunraku.core.nn.checkpoints` reads without torch. Training states are of the same
form: safetensors with JSON in the metadata, never pickle.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar, cast

import numpy as np
import torch
from safetensors.torch import save

from bunraku.core.files import weights_file
from bunraku.core.nn import checkpoints as files
from bunraku.core.nn.checkpoints import FORMAT, config_of, fitting_config, read_tensors, write_tensors
from bunraku.errors import WeightsError

LAB_WEIGHTS = Path(__file__).resolve().parents[1] / "weights"
"""Where the checkpoints lie that no animation reads; they are in a checkout and not in the wheel."""

Network = TypeVar("Network", bound=torch.nn.Module)


def lab_checkpoint(name: str) -> Path:
    """Path of a checkpoint that only the laboratory reads, or of one that comes with Bunraku, for example
    `lab_checkpoint("extractor")`. A folder that BUNRAKU_WEIGHTS names comes first.

    Raises:
        WeightsError: It is not there.
    """
    shipped, own = weights_file(f"{name}.safetensors"), LAB_WEIGHTS / f"{name}.safetensors"
    if shipped.is_file():
        return shipped
    if not own.is_file():
        raise WeightsError(
            f"{own}: the '{name}' weights are missing; take them from a checkout of Bunraku, train them, or set "
            "BUNRAKU_WEIGHTS to their folder"
        )
    return own


def _plain(value: torch.Tensor) -> torch.Tensor:
    return value.detach().to("cpu").contiguous().clone()


def save_checkpoint(
    path: str | Path, state_dict: Mapping[str, torch.Tensor], config: dict[str, object], kind: str, half: bool = False
) -> Path:
    """Write weights with the config that builds their network: `core.nn.checkpoints.save_checkpoint` of tensors.

    Raises:
        WeightsError: The file cannot be written.
    """
    arrays = {name: _plain(value).numpy() for name, value in state_dict.items()}
    return files.save_checkpoint(path, arrays, config, kind, half)


def load_checkpoint(path: str | Path, kind: str) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Read weights and their config; float16 comes back as float32.

    Raises:
        WeightsError: The file is missing, of another kind, damaged or cut short, or holds values that are not numbers.
    """
    state, config = files.load_checkpoint(path, kind)
    return {name: torch.from_numpy(value) for name, value in state.items()}, config


def fitted_network(build: Callable[[], Network], state: Mapping[str, torch.Tensor]) -> Network:
    """A network with its weights. Its sizes are compared with those of the weights before it takes any memory, as a
    config may ask for more than there is.

    Raises:
        ValueError: A weight is missing, or has another size.
    """
    with torch.device("meta"):
        sizes = {name: tuple(value.shape) for name, value in build().state_dict().items()}
    for name, size in sizes.items():
        if name not in state or tuple(state[name].shape) != size:
            found = f"the file has {list(state[name].shape)}" if name in state else "the file has none"
            raise ValueError(f"its config makes '{name}' of size {list(size)}, and {found}")
    model = build()
    model.load_state_dict(state)
    return model


def save_network(
    path: str | Path, model: torch.nn.Module, kind: str, note: Mapping[str, object] | None = None, half: bool = False,
    *, key: str = "network",
) -> Path:  # fmt: skip
    """Write a network's weights with its config, a dataclass.

    Args:
        path: The file.
        model: The network, its shape in `config`.
        kind: Of the checkpoint.
        note: Anything else to carry, for example the training's settings and results.
        half: Store the matrices as float16.
        key: Under which the config stands.
    """
    config = {key: asdict(cast(Any, model.config)), **(note or {})}
    return save_checkpoint(path, model.state_dict(), config, kind, half=half)


def load_network(
    path: str | Path, kind: str, build: Callable[[dict[str, object]], Network], *, key: str = "network"
) -> Network:
    """Read what `save_network` wrote, ready to use.

    Args:
        path: The file.
        kind: Of the checkpoint.
        build: The network of its config's fields.
        key: Under which the config stands.

    Raises:
        WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    state, config = load_checkpoint(path, kind)
    with fitting_config(path):
        model = fitted_network(lambda: build(config[key]), state)
    return model.eval().requires_grad_(False)


class SavedNetwork(torch.nn.Module):
    """A network with a `config` that makes it, and a kind of checkpoint."""

    kind: ClassVar[str]
    shape: ClassVar[type]
    """Of its config, a dataclass."""
    key: ClassVar[str] = "network"
    """Under which the config stands."""

    @classmethod
    def config_from(cls, fields: dict[str, object]) -> Any:
        """The config of what a checkpoint carries."""
        return config_of(cls.shape, fields)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a checkpoint, ready to use.

        Raises:
            WeightsError: The file is missing, damaged, of another kind, or its weights do not fit its config.
        """
        return load_network(path, cls.kind, lambda fields: cls(cls.config_from(fields)), key=cls.key)

    def save(self, path: str | Path, note: Mapping[str, object] | None = None, half: bool = False) -> Path:
        """Write the weights with their config (`save_network`)."""
        return save_network(path, self, self.kind, note, half, key=self.key)


@dataclass
class TrainingState:
    """All that a training run needs to go on as if it had never stopped.

    Args:
        step: Optimiser steps done.
        models: State dicts by name, for example {"model": ..., "ema": ...}.
        optimizers: `state_dict()` of each optimiser by name.
        config: The run's settings, anything JSON can say.
        values: Other JSON values: best loss so far, seconds spent, a numpy generator's `bit_generator.state`.
        generators: `get_state()` of torch generators by name.
    """

    step: int
    models: dict[str, dict[str, torch.Tensor]]
    optimizers: dict[str, dict[str, Any]] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    values: dict[str, Any] = field(default_factory=dict)
    generators: dict[str, torch.Tensor] = field(default_factory=dict)


def _pack(value: Any, name: str, tensors: dict[str, torch.Tensor]) -> Any:
    """A JSON image of nested dicts, lists and tensors; tensors move to `tensors`."""
    if isinstance(value, torch.Tensor):
        tensors[name] = _plain(value)
        return {"tensor": name}
    if isinstance(value, Mapping):
        return {"dict": [[key, _pack(item, f"{name}/{key}", tensors)] for key, item in value.items()]}
    if isinstance(value, (list, tuple)):
        return {
            "list" if isinstance(value, list) else "tuple": [
                _pack(item, f"{name}/{index}", tensors) for index, item in enumerate(value)
            ]
        }
    if isinstance(value, np.generic):
        value = value.item()
    return {"value": value}


def _unpack(image: Any, tensors: Mapping[str, torch.Tensor]) -> Any:
    ((form, value),) = image.items()
    if form == "tensor":
        return tensors[value]
    if form == "dict":
        return {key: _unpack(item, tensors) for key, item in value}
    if form in ("list", "tuple"):
        items = [_unpack(item, tensors) for item in value]
        return items if form == "list" else tuple(items)
    return value


def save_training_state(path: str | Path, state: TrainingState) -> Path:
    """Write a training state; a kill at any moment leaves either the last one or this one, whole.

    Raises:
        WeightsError: The file cannot be written.
    """
    tensors: dict[str, torch.Tensor] = {}
    image = {
        name: _pack(getattr(state, name), name, tensors)
        for name in ("models", "optimizers", "config", "values", "generators")
    }
    path = Path(path)
    said = json.dumps({"step": int(state.step), "image": image})
    write_tensors(path, save(tensors, metadata={"format": FORMAT, "kind": "training", "config": said}))
    return path


def load_training_state(path: str | Path) -> TrainingState:
    """Read what `save_training_state` wrote; hand its parts to `load_state_dict` and `set_state`.

    Raises:
        WeightsError: The file is missing, damaged or not a training state.
    """
    path = Path(path)
    tensors, config = read_tensors(path, "training", "pt")
    try:
        return TrainingState(
            step=int(config["step"]), **{name: _unpack(image, tensors) for name, image in config["image"].items()}
        )
    except Exception as error:
        raise WeightsError(
            f"{path}: the training state is damaged ({error}); start the run again in another folder"
        ) from error
