"""Small denoisers with thin changes: what a distillation writes, as it runs."""

import numpy as np
import pytest

from bunraku.diffusion.generation.drawing import Drawing
from bunraku.diffusion.inference.denoiser import load_denoiser, load_denoiser_of_few_steps
from bunraku.diffusion.inference.few_steps import KIND, fingerprint
from bunraku.diffusion.sampling.sampler import Solver, sample
from bunraku.diffusion.sampling.solvers import alphas_cumprod
from bunraku.errors import WeightsError
from bunraku.language.encoders import TextBatch
from bunraku.nn.checkpoints import load_checkpoint, save_checkpoint

VISITED = [999, 700, 400, 90]


@pytest.fixture
def teacher(tmp_path, denoiser):
    """Path of a small denoiser."""
    from bunraku_lab.nn.diffusion.checkpoint import save_denoiser

    return save_denoiser(tmp_path / "diffusion.safetensors", denoiser(features=6, handles=3), half=False)


def changed(teacher, visited=VISITED, of=None, **matrices):
    """Path of changes to the matrices that are named, with "__" for each dot."""
    state = load_checkpoint(teacher, "diffusion")[0]
    config = {"of": of or fingerprint(state), "visited": visited, "guidance": 3.5}
    parts = {
        f"{name.replace('__', '.')}.{part}": value
        for name, pair in matrices.items()
        for part, value in zip(("up", "down"), pair, strict=True)
    }
    return save_checkpoint(teacher.with_name("few-steps.safetensors"), parts, config, KIND)


def thin(rows, columns, seed=0):
    random = np.random.default_rng(seed)
    return random.normal(size=(rows, 2)).astype(np.float32), random.normal(size=(2, columns)).astype(np.float32)


def told(rows):
    random = np.random.default_rng(5)
    tokens = random.normal(size=(rows, 3, 8)).astype(np.float32)
    return TextBatch(tokens, np.ones((rows, 3), bool), random.normal(size=(rows, 8)).astype(np.float32))


def test_matrices_get_their_changes_and_no_others(teacher):
    up, down = thin(16, 16)
    few = load_denoiser_of_few_steps(teacher, changed(teacher, step_in__0__weight=(up, down)))
    plain = load_denoiser(teacher)
    assert few.visited == tuple(VISITED) and plain.visited == ()
    np.testing.assert_allclose(few.step_in[0].matrix, plain.step_in[0].matrix + (up @ down).T, atol=1e-5)
    np.testing.assert_array_equal(few.motion_out.matrix, plain.motion_out.matrix)


def test_changes_of_another_denoiser_are_left_alone(teacher):
    assert load_denoiser_of_few_steps(teacher, changed(teacher, of="0" * 32)) is None


def test_a_sampler_goes_by_ddim_through_these_steps_and_asks_the_sentence_alone(teacher):
    """Against DDIM written out: x' = alpha' x0 + sigma' (x - alpha x0) / sigma; guidance would need a second row."""
    few = load_denoiser_of_few_steps(teacher, changed(teacher))
    text, seen = told(2), []

    class Watched:
        def __getattr__(self, name):
            return getattr(few, name)

        def __call__(self, x, step, lengths, condition, adapts=True):
            found = few(x, step, lengths, condition, adapts)
            seen.append((step, x.copy(), found[0]))
            return found

    sample(Watched(), text, 4, Solver(20, guidance=5.0), seed=3)
    runs = [one for one in seen if one[1].shape[1] == 4]  # the last step looks again, half a token later
    assert [step for step, _, _ in runs[::2]] == VISITED and all(len(x) == 1 for _, x, _ in runs)
    curve = alphas_cumprod()
    for (step, x, x0), (after, there, _) in zip(runs[::2], runs[2::2], strict=False):
        alpha, sigma = (np.sqrt(share) for share in (curve[step], 1 - curve[step]))
        noise = (x - alpha * x0) / sigma
        np.testing.assert_allclose(there, np.sqrt(curve[after]) * x0 + np.sqrt(1 - curve[after]) * noise, atol=1e-3)


@pytest.mark.parametrize("visited", [[], [90, 400], [400, 400], [1000, 3], [4.5], "all"])
def test_steps_that_do_not_fall_are_refused(teacher, visited):
    with pytest.raises(WeightsError, match=r"few-steps\.safetensors.*falling diffusion steps"):
        load_denoiser_of_few_steps(teacher, changed(teacher, visited=visited))


def test_changes_of_other_sizes_are_refused(teacher):
    with pytest.raises(WeightsError, match=r"'motion_out\.weight' is no matrix"):
        load_denoiser_of_few_steps(teacher, changed(teacher, motion_out__weight=thin(7, 16)))
    with pytest.raises(WeightsError, match="is no matrix"):
        load_denoiser_of_few_steps(teacher, changed(teacher, nothing=thin(7, 16)))


def test_who_asks_for_steps_or_guidance_gets_the_denoiser_itself(teacher):
    changed(teacher)
    assert Drawing(checkpoint=teacher).denoiser.visited == tuple(VISITED)
    for how in ({"steps": 8}, {"guidance": 2.0}):
        assert Drawing(checkpoint=teacher, **how).denoiser.visited == ()
    teacher.with_name("few-steps.safetensors").unlink()
    assert Drawing(checkpoint=teacher).denoiser.visited == ()
