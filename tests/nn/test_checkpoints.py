import numpy as np
import pytest

from bunraku.errors import WeightsError
from bunraku.nn.checkpoints import halves_of, load_checkpoint, planes_of, save_checkpoint, shipped_checkpoint


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


def test_shipped_checkpoint_looks_where_the_environment_says(tmp_path, monkeypatch):
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path))
    with pytest.raises(WeightsError, match="'demo' weights are missing"):
        shipped_checkpoint("demo")
    save_checkpoint(tmp_path / "demo.safetensors", _state(), {}, "thing")
    assert shipped_checkpoint("demo") == tmp_path / "demo.safetensors"


def test_halves_in_planes_come_back():
    values = np.random.default_rng(0).normal(size=(7, 5)).astype(np.float16)
    planes = planes_of(values)
    assert planes.shape == (2, 7, 5) and planes.dtype == np.uint8
    np.testing.assert_array_equal(halves_of(planes), values)
    np.testing.assert_array_equal(halves_of(planes[:, 3]), values[3])
