"""Checkpoints: weights that carry their own config, and training states that survive a kill.

Both are safetensors files with JSON in the metadata, never pickle, and both are written beside their target and
renamed, so a file by that name is always whole.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import torch
from safetensors import safe_open
from safetensors.torch import save

from bunraku.core.request.json_form import from_json
from bunraku.errors import FormatError, OptionError, WeightsError
from bunraku.formats.files import atomic_write, weights_file
from bunraku.nn.threads import one_thread

__all__ = [
    "TrainingState",
    "config_of",
    "dated_checkpoint",
    "fitted_network",
    "fitting_config",
    "load_checkpoint",
    "load_network",
    "load_training_state",
    "save_checkpoint",
    "save_network",
    "save_training_state",
    "shipped_checkpoint",
]

_FORMAT = "bunraku-1"
_LARGE = 1024
_LARGEST = 1_000_000
"""More than any size, rate or count in a config."""

Network = TypeVar("Network", bound=torch.nn.Module)
Config = TypeVar("Config")


def _write(path: Path, tensors: dict[str, torch.Tensor], metadata: dict[str, str]) -> None:
    """Write beside the target and rename; on any failure the old file is untouched and nothing is left over."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            file.write(save(tensors, metadata=metadata))
    except (OSError, FormatError) as error:
        raise WeightsError(
            f"{path}: the checkpoint cannot be written ({error}); check the folder and the free space"
        ) from error


def _read(path: Path, kind: str) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    if not path.is_file():
        raise WeightsError(f"{path}: there is no such checkpoint; train one, or give another path")
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            metadata = file.metadata() or {}
            found = metadata.get("kind")
            if metadata.get("format") != _FORMAT or found is None:
                raise WeightsError(
                    f"{path}: this is a safetensors file but not a Bunraku checkpoint; give one that Bunraku wrote"
                )
            if found != kind:
                raise WeightsError(
                    f"{path}: this is a checkpoint of kind '{found}', but '{kind}' is needed here; give another file"
                )
            config = json.loads(metadata["config"])
            if not isinstance(config, dict):
                raise ValueError("the config is not an object")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
    except WeightsError:
        raise
    except Exception as error:
        raise WeightsError(
            f"{path}: the checkpoint is damaged or cut short ({error}); copy or train it again"
        ) from error
    return tensors, config


def _plain(value: torch.Tensor) -> torch.Tensor:
    return value.detach().to("cpu").contiguous().clone()


def save_checkpoint(
    path: str | Path, state_dict: Mapping[str, torch.Tensor], config: dict[str, object], kind: str, half: bool = False
) -> Path:
    """Write weights with the config that builds their network.

    Args:
        path: The safetensors file, replaced at once when the new one is whole.
        state_dict: Tensors by name.
        config: What the network needs to be built again; anything JSON can say.
        kind: What the weights are, for example "diffusion"; `load_checkpoint` asks for the same word.
        half: Store matrices as float16, half the size. Tensors under 1,024 numbers (statistics, biases) and any that
            overflow float16 stay as they are.

    Raises:
        WeightsError: The file cannot be written.
    """
    tensors = {}
    for name, value in state_dict.items():
        value = _plain(value)
        if half and value.dtype == torch.float32 and value.numel() >= _LARGE and float(value.abs().max()) < 6e4:
            value = value.half()
        tensors[name] = value
    path = Path(path)
    _write(path, tensors, {"format": _FORMAT, "kind": kind, "config": json.dumps(config)})
    return path


def load_checkpoint(path: str | Path, kind: str) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    """Read weights and their config; float16 comes back as float32.

    Raises:
        WeightsError: The file is missing, of another kind, damaged or cut short, or holds values that are not numbers.
    """
    path = Path(path)
    tensors, config = _read(path, kind)
    with one_thread():
        state = {
            name: value.float() if value.dtype in (torch.float16, torch.bfloat16) else value
            for name, value in tensors.items()
        }
        for name, value in state.items():
            if value.is_floating_point() and not bool(torch.isfinite(value).all()):
                raise WeightsError(
                    f"{path}: the weights '{name}' hold values that are not numbers; copy or train them again"
                )
    return state, config


@contextmanager
def fitting_config(path: str | Path) -> Iterator[None]:
    """What goes wrong while a network is built of a checkpoint's config and given its weights, as one sentence.

    Raises:
        WeightsError: The weights do not fit their config.
    """
    try:
        yield
    except WeightsError:
        raise
    except Exception as error:
        reason = next(iter(str(error).splitlines()), "") or type(error).__name__
        raise WeightsError(
            f"{path}: the weights do not fit their config ({reason}); train or copy them again"
        ) from error


def config_of(kind: type[Config], data: object) -> Config:
    """The config of a network from what a checkpoint carries.

    Args:
        kind: A dataclass, which says the type of each value.
        data: The JSON object of the checkpoint.

    Raises:
        OptionError: A value is missing or unknown, of another type, or no size that a network has.
    """
    config = from_json(kind, data, "the config")
    for name, value in vars(config).items():
        for one in value if isinstance(value, tuple) else (value,):
            if isinstance(one, int | float) and not 0 <= one <= _LARGEST:
                raise OptionError(f"{name} must be from 0 to {_LARGEST}, not {one:g}")
    return config


def fitted_network(build: Callable[[], Network], state: Mapping[str, torch.Tensor]) -> Network:
    """A network with its weights. Its sizes are compared with those of the weights before it takes any memory, as a
    config may ask for more than there is.

    Args:
        build: Makes the network of its config.
        state: The weights by name.

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
    path: str | Path,
    model: torch.nn.Module,
    kind: str,
    note: Mapping[str, object] | None = None,
    half: bool = False,
    *,
    key: str = "network",
) -> Path:
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


def dated_checkpoint(name: str, path: str | Path | None = None) -> tuple[Path, int]:
    """A checkpoint and when it was changed, by which a loader keeps networks between calls.

    Args:
        name: Of the shipped one.
        path: Another in its place.

    Raises:
        WeightsError: The shipped one is not there.
    """
    found = shipped_checkpoint(name) if path is None else Path(path)
    return found.resolve(), found.stat().st_mtime_ns if found.is_file() else 0


def shipped_checkpoint(name: str) -> Path:
    """Path of a checkpoint that comes with Bunraku, for example `shipped_checkpoint("diffusion")`.

    The environment variable BUNRAKU_WEIGHTS names other folders to look in (`weights_file`).

    Raises:
        WeightsError: It is not there.
    """
    path = weights_file(f"{name}.safetensors")
    if not path.is_file():
        raise WeightsError(
            f"{path}: the '{name}' weights are missing; install Bunraku again, train them, or set BUNRAKU_WEIGHTS to "
            "their folder"
        )
    return path


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
    _write(
        path,
        tensors,
        {"format": _FORMAT, "kind": "training", "config": json.dumps({"step": int(state.step), "image": image})},
    )
    return path


def load_training_state(path: str | Path) -> TrainingState:
    """Read what `save_training_state` wrote; hand its parts to `load_state_dict` and `set_state`.

    Raises:
        WeightsError: The file is missing, damaged or not a training state.
    """
    path = Path(path)
    tensors, config = _read(path, "training")
    try:
        return TrainingState(
            step=int(config["step"]), **{name: _unpack(image, tensors) for name, image in config["image"].items()}
        )
    except Exception as error:
        raise WeightsError(
            f"{path}: the training state is damaged ({error}); start the run again in another folder"
        ) from error
