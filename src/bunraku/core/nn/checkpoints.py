"""Checkpoints: weights that carry their own config.

They are safetensors files with JSON in the metadata, never pickle, and written so that a file by that name is always
complete.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from bunraku.core.files import atomic_write, weights_file
from bunraku.core.nn.layers import Weights
from bunraku.core.request import from_json
from bunraku.errors import FormatError, OptionError, WeightsError

FORMAT = "bunraku-1"
_LARGE = 1024
_PLANES = "planes"
"""Key of the metadata that lists the arrays which `planes_of` took apart, as JSON."""
_LARGEST = 1_000_000
"""More than any size, rate or count in a config."""

_ENDLESS = np.uint16(0x7C00)
"""Bits of a float16 that are all set in NaN and infinity."""

Network = TypeVar("Network")
Config = TypeVar("Config")


def write_tensors(path: Path, data: bytes) -> None:
    """Write a file safely: on any failure the old one is untouched. WeightsError if it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            file.write(data)
    except (OSError, FormatError) as error:
        raise WeightsError(
            f"{path}: the checkpoint cannot be written ({error}); check the folder and the free space"
        ) from error


def read_tensors(path: Path, kind: str, framework: str = "np") -> tuple[dict[str, Any], dict[str, Any]]:
    """Tensors by name, of a framework, and the config. WeightsError if the file is missing, of another kind, damaged or
    cut short.
    """
    with _opened(path, kind, framework) as (file, config):
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
        halves_of(tensors, json.loads((file.metadata() or {}).get(_PLANES, "[]")))
        return tensors, config


def read_config(path: Path, kind: str) -> dict[str, Any]:
    """The config alone; errors are those of `read_tensors`."""
    with _opened(path, kind) as (_, config):
        return config


@contextmanager
def _opened(path: Path, kind: str, framework: str = "np") -> Iterator[tuple[Any, dict[str, Any]]]:
    """An open checkpoint and its config; any failure within becomes one sentence."""
    from safetensors import safe_open

    if not os.path.isfile(path):
        raise WeightsError(f"{path}: there is no such checkpoint; train one, or give another path")
    try:
        with safe_open(path, framework=framework) as file:
            metadata = file.metadata() or {}
            stored = metadata.get("kind")
            if metadata.get("format") != FORMAT or stored is None:
                raise WeightsError(
                    f"{path}: this is a safetensors file but not a Bunraku checkpoint; give one that Bunraku wrote"
                )
            if stored != kind:
                raise WeightsError(
                    f"{path}: this is a checkpoint of kind '{stored}', but '{kind}' is needed here; give another file"
                )
            config = json.loads(metadata["config"])
            if not isinstance(config, dict):
                raise ValueError("the config is not an object")
            yield file, config
    except WeightsError:
        raise
    except Exception as error:
        raise WeightsError(
            f"{path}: the checkpoint is damaged or cut short ({error}); copy or train it again"
        ) from error


def stored_as_half(count: int, largest: float) -> bool:
    """Whether an array of float32 with this size and largest magnitude is stored as float16 where that is asked for."""
    return count >= _LARGE and largest < 6e4


def planes_of(values: np.ndarray) -> np.ndarray:
    """Numbers as float16, all low bytes before all high ones, shape (2, ...), uint8: these compress better."""
    halves = np.ascontiguousarray(values, "<f2")
    return np.ascontiguousarray(np.moveaxis(halves.view(np.uint8).reshape(*halves.shape, 2), -1, 0))


def halves_of(tensors: dict[str, np.ndarray], names: Iterable[str]) -> None:
    """Put the float16 arrays that `planes_of` took apart together again, those of these names."""
    for name in names:
        low, high = tensors[name]
        tensors[name] = (low | high.astype("<u2") << np.uint16(8)).view("<f2")


def save_checkpoint(
    path: str | Path, state: Mapping[str, np.ndarray], config: dict[str, object], kind: str, half: bool = False
) -> Path:
    """Write weights of a kind, such as "diffusion", by name, with the config, JSON values, that builds their network.
    With `half`, matrices are stored as float16 (`planes_of`); arrays of fewer than 1,024 numbers (statistics, biases)
    and any that overflow float16 stay as they are. WeightsError if the file cannot be written.
    """
    from safetensors.numpy import save

    arrays, planes = {}, []
    for name, value in state.items():
        value = np.asarray(value, order="C")  # `ascontiguousarray` makes a list of a single number
        if half and value.dtype == np.float32 and stored_as_half(value.size, float(np.abs(value).max(initial=0))):
            value = planes_of(value)
            planes.append(name)
        arrays[name] = value
    path = Path(path)
    metadata = {"format": FORMAT, "kind": kind, "config": json.dumps(config), _PLANES: json.dumps(planes)}
    write_tensors(path, save(arrays, metadata=metadata))
    return path


def load_checkpoint(path: str | Path, kind: str, half: bool = False) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Read the weights of a kind and their config; float16 comes as float32, or with `half` as it is, for `Weights` to
    convert. WeightsError if the file is missing, of another kind, damaged or cut short, or holds values that are not
    numbers.
    """
    path = Path(path)
    tensors, config = read_tensors(path, kind)
    for name, value in tensors.items():
        if value.dtype == np.float16:  # by its bits, ten times as fast as numpy's way
            finite = bool((value.view(np.uint16) & _ENDLESS).max(initial=0) < _ENDLESS)
        else:
            finite = value.dtype.kind != "f" or bool(np.isfinite(value).all())
        if not finite:
            raise WeightsError(
                f"{path}: the weights '{name}' hold values that are not numbers; copy or train them again"
            )
    if half:
        return tensors, config
    return {
        name: value.astype(np.float32) if value.dtype == np.float16 else value for name, value in tensors.items()
    }, config


def load_network(
    path: str | Path, kind: str, build: Callable[[dict[str, object], Weights], Network], *, key: str = "network"
) -> Network:
    """A network made of its config's fields, under a key of the checkpoint's, and its weights by `build`. WeightsError
    if the file is missing, damaged, of another kind, or its weights do not fit its config.
    """
    state, config = load_checkpoint(path, kind, half=True)
    with fitting_config(path):
        weights = Weights(state)
        network = build(config[key], weights)
        weights.done()
    return network


@contextmanager
def fitting_config(path: str | Path) -> Iterator[None]:
    """Turn any failure while a network is built into a WeightsError: its weights do not fit its config."""
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
    """The config of a network, a dataclass, from the JSON object of a checkpoint. OptionError if a value is missing or
    unknown, of another type, or no size that a network has.
    """
    config = from_json(kind, data, "the config")
    for name, value in vars(config).items():
        for entry in value if isinstance(value, tuple) else (value,):
            if isinstance(entry, int | float) and not 0 <= entry <= _LARGEST:
                raise OptionError(f"{name} must be from 0 to {_LARGEST}, not {entry:g}")
    return config


def dated_checkpoint(name: str, path: str | Path | None = None) -> tuple[Path, int]:
    """Path and time of change of a shipped checkpoint, or of another in its place; loaders cache networks by these.
    WeightsError if the shipped one is not there.
    """
    return dated(shipped_checkpoint(name) if path is None else Path(path))


def dated(path: Path) -> tuple[Path, int]:
    """A file and its time of change [ns], 0 where there is none."""
    return (path.resolve(), path.stat().st_mtime_ns) if os.path.isfile(path) else (path, 0)


def shipped_checkpoint(name: str) -> Path:
    """Path of a checkpoint that comes with Bunraku, for example `shipped_checkpoint("diffusion")` (see `weights_file`).
    WeightsError if it is not there.
    """
    path = weights_file(f"{name}.safetensors")
    if not path.is_file():
        raise WeightsError(f"{path}: the '{name}' weights are missing; install Bunraku again, or set BUNRAKU_WEIGHTS")
    return path
