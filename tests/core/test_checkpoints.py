"""Files that are written whole, checkpoints, and configs that do not fit their weights."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from bunraku.anatomy.handles.networks import load_orientation_predictor, load_predictor
from bunraku.apparel.learned.network import load_displacement
from bunraku.apparel.part_network import load_parts
from bunraku.core.files import PACKAGE_WEIGHTS, STALE, atomic_write, remove_leftovers, weights_file
from bunraku.core.nn.checkpoints import load_checkpoint, save_checkpoint, shipped_checkpoint
from bunraku.errors import WeightsError
from bunraku.generation.denoiser import load_denoiser
from bunraku.generation.extractor import load_extractor

KILLED = """
import os, signal, sys
from pathlib import Path
from bunraku.core.files import atomic_write
with atomic_write(Path(sys.argv[1])) as file:
    file.write(b"half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_run_left_is_removed(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "out.glb")], check=False)
    assert len(list(tmp_path.iterdir())) == 1
    assert remove_leftovers(tmp_path) == 1 and list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs the /proc of Linux")
def test_a_killed_process_that_nobody_has_asked_after_is_gone(tmp_path):
    with subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path / "out.glb")]) as process:
        while Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z":
            time.sleep(0.01)
        assert len(list(tmp_path.iterdir())) == 1
        assert remove_leftovers(tmp_path) == 1


def test_what_is_being_written_and_what_is_not_ours_stays(tmp_path):
    others = [".notes.tmp", "scene.tmp", ".x.abc123-1-12345678.tmp.glb", ".x.part"]
    for name in others:
        (tmp_path / name).write_bytes(b"")
        os.utime(tmp_path / name, (0, 0))
    with atomic_write(tmp_path / "out.glb") as file:
        file.write(b"whole")
        assert remove_leftovers(tmp_path) == 0
    assert (tmp_path / "out.glb").read_bytes() == b"whole"
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*others, "out.glb"])


def test_what_another_machine_gave_up_is_removed_after_an_hour(tmp_path):
    path = tmp_path / ".out.glb.000000-1-abcdefgh.tmp"
    path.write_bytes(b"half")
    assert remove_leftovers(tmp_path) == 0
    old = time.time() - STALE - 1
    os.utime(path, (old, old))
    assert remove_leftovers(tmp_path) == 1


def test_weights_are_found_in_the_first_folder_that_has_them(tmp_path, monkeypatch):
    for folder, name in (("one", "a"), ("two", "a"), ("two", "b")):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / name).write_text("")
    monkeypatch.setenv("BUNRAKU_WEIGHTS", os.pathsep.join([str(tmp_path / "one"), str(tmp_path / "two"), ""]))
    assert [weights_file(name).parent.name for name in "ab"] == ["one", "two"]
    assert weights_file("diffusion.md").parent == PACKAGE_WEIGHTS and weights_file("c").parent.name == "one"
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path / "one"))
    assert weights_file("diffusion.md").parent.name == "one"
    monkeypatch.delenv("BUNRAKU_WEIGHTS")
    assert weights_file("diffusion.md").parent == PACKAGE_WEIGHTS


def _state():
    random = np.random.default_rng(3)
    return {
        "a.weight": random.standard_normal((64, 32)).astype(np.float32),
        "a.bias": random.standard_normal(32).astype(np.float32),
        "steps": np.array(7),
    }


def test_roundtrip_is_exact_in_float32(tmp_path):
    save_checkpoint(tmp_path / "deep" / "m.safetensors", _state(), {"width": 3, "names": ["é", None]}, "thing")
    state, config = load_checkpoint(tmp_path / "deep" / "m.safetensors", "thing")
    assert config == {"width": 3, "names": ["é", None]}
    assert all(np.array_equal(state[name], value) for name, value in _state().items()) and set(state) == set(_state())
    assert state["steps"].shape == ()


def test_half_stores_matrices_in_half_the_size_and_loads_float32(tmp_path):
    big = {
        "w": np.random.default_rng(1).standard_normal((256, 256)).astype(np.float32),
        "huge": np.full(2048, 1e6, np.float32),
        "bias": np.full(8, 1e-9, np.float32),
    }
    full = save_checkpoint(tmp_path / "f.safetensors", big, {}, "thing").stat().st_size
    half = save_checkpoint(tmp_path / "h.safetensors", big, {}, "thing", half=True).stat().st_size
    state, _ = load_checkpoint(tmp_path / "h.safetensors", "thing")
    assert full - half == pytest.approx(2 * 256 * 256, abs=64)  # but for the header
    assert all(value.dtype == np.float32 for value in state.values())
    assert np.array_equal(state["huge"], big["huge"]) and np.array_equal(state["bias"], big["bias"])
    np.testing.assert_allclose(state["w"], big["w"], rtol=1e-3, atol=1e-6)


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
    from safetensors.numpy import save_file

    save_file({"x": np.zeros(1)}, tmp_path / "foreign.safetensors")
    with pytest.raises(WeightsError, match="not a Bunraku checkpoint"):
        load_checkpoint(tmp_path / "foreign.safetensors", "thing")
    save_checkpoint(tmp_path / "nan.safetensors", {"x": np.array([np.nan])}, {}, "thing")
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


LOADERS = {
    "handles": (load_predictor, "predictor"),
    "orientation": (load_orientation_predictor, "predictor"),
    "diffusion": (load_denoiser, ""),
    "ranker": (lambda path: load_extractor(path, kind="ranker"), ""),
    "apparel": (load_displacement, "network"),
    "parts": (load_parts, "network"),
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
