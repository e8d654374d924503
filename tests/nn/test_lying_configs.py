"""Checkpoints whose config lies: whatever it says, loading them is one sentence that names the file."""

import json

import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from bunraku.apparel.displacement.weights import load_displacement
from bunraku.apparel.segmentation.scores import load_segmentation
from bunraku.diffusion.inference.denoiser import load_denoiser
from bunraku.diffusion.inference.extractor import load_extractor
from bunraku.errors import WeightsError
from bunraku.handles.inference.orientation import load_orientation_predictor
from bunraku.handles.inference.predictor import load_predictor
from bunraku.nn.checkpoints import shipped_checkpoint

LOADERS = {
    "handles": (load_predictor, "predictor"),
    "orientation": (load_orientation_predictor, "predictor"),
    "diffusion": (load_denoiser, ""),
    "ranker": (lambda path: load_extractor(path, kind="ranker"), ""),
    "apparel": (load_displacement, "network"),
    "apparel-mask": (load_segmentation, "network"),
}


def rewritten(name, path, change):
    """A shipped checkpoint with another config."""
    with safe_open(shipped_checkpoint(name), framework="np") as file:
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 -- not a dict
        metadata = file.metadata()
    config = json.loads(metadata["config"])
    key = LOADERS[name][1]
    if key:
        config[key] = change(config[key])
    else:
        config = change(config)
    save_file(tensors, path, {**metadata, "config": json.dumps(config)})
    return path


def first_size(shape):
    return next(key for key, value in shape.items() if isinstance(value, int) and not isinstance(value, bool))


CHANGES = {
    "another size": lambda shape: {**shape, first_size(shape): shape[first_size(shape)] + 1},
    "no size": lambda shape: {**shape, first_size(shape): 0},
    "a negative size": lambda shape: {**shape, first_size(shape): -4},
    "more than there is": lambda shape: {**shape, first_size(shape): 10**12},
    "much": lambda shape: {**shape, first_size(shape): 999_999},
    "a text": lambda shape: {**shape, first_size(shape): "many"},
    "nothing": lambda shape: {**shape, first_size(shape): None},
    "a list": lambda shape: {**shape, first_size(shape): [1, 2]},
    "an unknown key": lambda shape: {**shape, "wheels": 4},
    "another kind": lambda shape: [1, 2, 3],
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", LOADERS)
def test_a_config_that_lies_is_one_sentence(name, change, tmp_path):
    if not shipped_checkpoint(name).is_file():
        pytest.skip("the shipped weights are not there")
    if name in ("diffusion", "ranker") and change == "another kind":
        pytest.skip("the config is the whole object")
    path = rewritten(name, tmp_path / "lying.safetensors", CHANGES[change])
    with pytest.raises(WeightsError, match="lying.safetensors") as told:
        LOADERS[name][0](path)
    assert "\n" not in str(told.value)


def test_a_predictor_of_other_handles_or_meshes_is_refused(tmp_path):
    for change in ({"mesh_vertices": 3}, {"anchors": "many"}, {"heads": 7}, {"depth": 1.5}):
        path = rewritten("handles", tmp_path / "lying.safetensors", lambda shape, change=change: {**shape, **change})
        with pytest.raises(WeightsError, match="lying.safetensors"):
            load_predictor(path)
