import subprocess
import sys

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from bunraku.body.layout import HANDLE_NAMES
from bunraku.diffusion.generation.drawing import STANDING
from bunraku.diffusion.generation.generate import adapt, generate_motion, generate_motions
from bunraku.errors import OptionError, WeightsError
from bunraku.language.parse import clauses_of
from bunraku.nn.checkpoints import shipped_checkpoint


@pytest.fixture
def make(denoiser, tmp_path):
    from bunraku_lab.nn.diffusion.checkpoint import save_denoiser

    def make(name="diffusion", **how):
        notes = {"characters": how.pop("characters", 0)}
        model = denoiser(text_encoder="all-MiniLM-L6-v2", text_size=384, pooled_size=384, **how)
        model.motion_out.weight.mul_(0.1)
        return save_denoiser(tmp_path / f"{name}.safetensors", model, notes, half=False)

    return make


def same(a, b):
    return (
        np.array_equal(a.rotations, b.rotations)
        and np.array_equal(a.root_translation, b.root_translation)
        and np.array_equal(a.translations, b.translations)
    )


@pytest.mark.parametrize(("seconds", "frames"), [(0.5, 10), (2, 40), (3.02, 60), (6, 120)])
def test_lengths(make, seconds, frames):
    motion = generate_motion("walks", seconds, steps=2, checkpoint=make())
    assert len(motion) == frames and motion.fps == 20 and motion.translations.shape == (frames, 30, 3)
    np.testing.assert_allclose(motion.root_translation[0, [0, 2]], 0, atol=1e-6)


def test_the_shipped_weights_are_found_and_kept(make, monkeypatch, tmp_path):
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path))
    with pytest.raises(WeightsError, match="missing"):
        generate_motion("walks", 1, steps=1)
    path = make()
    first = generate_motion("a person walks.", 1, steps=2, seed=3)
    assert same(first, generate_motion(" a  person walks", 1, steps=2, seed=3)) and same(
        first, generate_motion("a person walks", 1, steps=2, seed=3, checkpoint=path)
    )
    for how in ({"seed": 4}, {"steps": 3}, {"guidance": 6.0}):
        assert not same(first, generate_motion("a person walks", 1, **{"steps": 2, "seed": 3, **how}))
    assert not same(first, generate_motion("a person jumps", 1, steps=2, seed=3))
    make(seed=1)
    assert not same(first, generate_motion("a person walks", 1, steps=2, seed=3))  # new weights in the same place


def test_the_mesh_feature_counts_only_where_training_knew_it(make):
    mesh = np.ones(12, np.float32)
    for characters in (0, 7):
        path = make(f"with{characters}", characters=characters)
        alone, meshed = (
            generate_motion("walks", 1, steps=2, mesh_feature=feature, checkpoint=path) for feature in (None, mesh)
        )
        assert same(alone, meshed) == (characters == 0)
    with pytest.raises(OptionError, match="12 finite"):
        generate_motion("walks", 1, steps=2, mesh_feature=mesh * np.nan, checkpoint=path)


def test_the_adaptation_moves_local_translations_only(make):
    motion = generate_motion("walks", 1, steps=1, checkpoint=make())
    offsets = np.random.default_rng(0).normal(size=motion.translations.shape).astype(np.float32)
    adapted = adapt(motion, offsets)
    np.testing.assert_allclose(adapted.translations[:, 1:], (motion.translations + offsets)[:, 1:], atol=1e-6)
    assert not adapted.translations[:, 0].any() and np.array_equal(adapted.rotations, motion.rotations)
    assert adapt(motion, np.zeros_like(offsets)) is motion


def test_bad_input_is_refused_before_anything_is_loaded(tmp_path):
    nowhere = tmp_path / "none.safetensors"
    for prompt in ("", "  ", "...", "x" * 10_000):
        with pytest.raises(OptionError, match="prompt"):
            generate_motion(prompt, 6, checkpoint=nowhere)
    for how in (
        {"steps": 0},
        {"steps": 1001},
        {"guidance": -1.0},
        {"guidance": float("nan")},
        {"seconds": 0.0},
        {"seconds": float("inf")},
    ):
        with pytest.raises(OptionError):
            generate_motion("walks", **{"seconds": 1.0, **how}, checkpoint=nowhere)
    with pytest.raises(WeightsError, match=r"none\.safetensors"):
        generate_motion("walks", 6, checkpoint=nowhere)


def threads():
    return {one["filepath"]: one["num_threads"] for one in threadpool_info()}


def test_progress_and_threads(make):
    generate_motion("walks", 1, steps=1, checkpoint=make())  # loads what has threads
    before, calls = threads(), []
    generate_motion("walks", 5, steps=4, checkpoint=make(), progress=lambda name, share: calls.append((name, share)))
    shares = [share for _, share in calls]
    assert (
        {name for name, _ in calls} == {"generate"} and shares[0] == 0 and shares[-1] == 1 and shares == sorted(shares)
    )
    assert threads() == before


@pytest.mark.skipif(not shipped_checkpoint("diffusion").is_file(), reason="the shipped weights are not there")
def test_the_networks_run_without_torch():
    code = (
        "import sys; from bunraku.diffusion.generation.networks import load_generator; load_generator(); "
        "from bunraku.diffusion.generation.generate import generate_motion; "
        "generate_motion('a person walks', 1, steps=2, candidates=2); "
        "assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)  # importing it takes two seconds


def test_who_sits_down_stands_at_first(make):
    """The first frames have the legs and the height of the rest pose, whatever the network says; others do not."""
    sits, walks = generate_motions(
        [clauses_of([("sits down", 2.0)]), clauses_of([("walks", 2.0)])], steps=3, checkpoint=make()
    )
    first = STANDING - 2  # the last ones are steadied with those after
    legs = [HANDLE_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("hip", "knee", "ankle")]
    standing = np.broadcast_to(np.eye(3), (first, len(legs), 3, 3))
    np.testing.assert_allclose(sits.rotations[:first, legs], standing, atol=2e-3)
    np.testing.assert_allclose(sits.root_translation[:first, 1], 0, atol=2e-3)
    assert np.abs(walks.rotations[:first, legs] - standing).max() > 0.05
