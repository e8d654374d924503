import math

import numpy as np
import pytest
import torch

from bunraku.diffusion.features import FeatureStatistics
from bunraku.diffusion.inference.denoiser import load_denoiser, load_denoiser_of_few_steps
from bunraku.diffusion.sampling.sampler import Solver, sample
from bunraku.diffusion.sampling.solvers import alphas_cumprod
from bunraku.errors import OptionError
from bunraku_lab.nn.checkpoints import load_training_state
from bunraku_lab.nn.diffusion.checkpoint import save_denoiser
from bunraku_lab.nn.diffusion.low_rank import changes_of, with_changes
from bunraku_lab.training.diffusion.clip_data import load_clips
from bunraku_lab.training.diffusion.clip_rows import ClipSet
from bunraku_lab.training.few_steps.train import FewStepsConfig, train_few_steps
from bunraku_lab.training.few_steps.trajectories import Lessons, ddim, places


@pytest.fixture
def teacher(tmp_path, denoiser, swings):
    """Path of a small denoiser with the units of four motions."""
    statistics = FeatureStatistics.measure([entry["features"] for entry in load_clips(swings).values()])
    model = denoiser()
    model.mean.copy_(torch.from_numpy(statistics.mean))
    model.std.copy_(torch.from_numpy(statistics.std))
    return save_denoiser(tmp_path / "diffusion.safetensors", model, half=False)


def rows(teacher, swings, count=3):
    model = load_denoiser(teacher)
    return model, ClipSet(load_clips(swings), FeatureStatistics(model.mean, model.std), frames=60).fixed(count)


def test_a_change_begins_without_effect_and_alone_learns():
    torch.manual_seed(0)
    plain = torch.nn.Sequential(torch.nn.Linear(5, 4), torch.nn.Linear(4, 3))
    x = torch.randn(2, 5)
    said = plain(x)
    model = with_changes(plain, 2, without=("1",))
    torch.testing.assert_close(model(x), said)
    model(x).square().sum().backward()
    learns = {name for name, value in model.named_parameters() if value.requires_grad}
    assert learns == {f"0.parametrizations.weight.0.{part}" for part in ("up", "down")}
    found = changes_of(model)
    assert {name: tuple(value.shape) for name, value in found.items()} == {
        "0.weight.up": (4, 2),
        "0.weight.down": (2, 5),
    }


def test_places_are_those_of_ddim():
    """By hand from the shares of signal; the last step ends at the clean motion."""
    curve = alphas_cumprod()
    own, clean = places((936, 562))[0]
    assert own == pytest.approx(math.sqrt((1 - curve[562]) / (1 - curve[936])))
    assert clean == pytest.approx(math.sqrt(curve[562]) - own * math.sqrt(curve[936]))
    np.testing.assert_allclose(places((936, 562))[1], (0, 1))


def test_targets_lead_from_node_to_node_and_to_the_teachers_motion(teacher, swings, encoder):
    model, batch = rows(teacher, swings)
    lessons = Lessons(model, encoder, None, 2.0)
    found = lessons.draw(batch, None, np.random.default_rng(0))
    assert [one.node for one in found] == [node for node in range(4) for _ in range(3)]
    for row in range(3):
        own = found[row::3]
        for one, after in zip(own, own[1:], strict=False):
            np.testing.assert_allclose(ddim(lessons.visited, one.node, one.noisy, one.target), after.noisy, atol=5e-3)
    noise = np.random.default_rng(0).standard_normal(batch.values.shape, np.float32)
    np.testing.assert_array_equal(found[0].noisy, noise[0, : batch.lengths[0]].astype(np.float16))
    drawn = Lessons(model, encoder, None, 2.0).draw(batch, None, np.random.default_rng(0))
    np.testing.assert_array_equal(drawn[-1].target, found[-1].target)


def test_trajectories_begin_at_noised_captures_or_where_the_student_is(teacher, swings, encoder):
    model, batch = rows(teacher, swings)
    lessons = Lessons(model, encoder, None, 2.0)
    led = lessons.draw(batch, None, np.random.default_rng(0), 2)
    assert {one.node for one in led} == {2, 3}
    noise = np.random.default_rng(0).standard_normal(batch.values.shape, np.float32)
    share = alphas_cumprod()[lessons.visited[2]]
    expected = math.sqrt(share) * batch.values[1] + math.sqrt(1 - share) * noise[1]
    np.testing.assert_allclose(led[1].noisy, expected[: batch.lengths[1]], atol=4e-3)
    rolled = lessons.draw(batch, None, np.random.default_rng(0), 3, lambda x, *_: x * 0 + 0.25)
    assert {one.node for one in rolled} == {3} and (rolled[0].noisy == np.float16(0.25)).all()


def test_the_student_comes_near_to_its_teacher_and_runs(teacher, swings, encoder, tmp_path):
    """Four steps of a trained student end nearer to twenty guided ones than four steps without changes do."""
    how = {"data": swings, "diffusion": teacher, "guidance": 1.5, "rank": 8, "batch": 8, "rows": 8, "rate": 3e-3}
    config = FewStepsConfig(out=tmp_path / "run", minutes=0, steps=150, validate_every=50, bf16=False, uses=4, **how)
    log = []
    path = train_few_steps(config, log.append, encoder=encoder)
    assert log[-1]["ends"] < 0.8 * log[0]["ends"] or log[-1]["loss"] < 0.5 * log[0]["loss"]
    few = load_denoiser_of_few_steps(teacher, path)
    assert len(few.visited) == 4
    text = encoder.encode(["a person waves", "a person kicks"])
    many, untrained, own = (
        sample(model, text, 40, solver, seed=1).values
        for model, solver in (
            (load_denoiser(teacher), Solver(20, 1.5)),
            (load_denoiser(teacher), Solver(4, 1.0)),
            (few, Solver()),
        )
    )
    assert np.square(own - many).mean() < np.square(untrained - many).mean()


def test_a_stopped_run_goes_on(teacher, swings, encoder, tmp_path):
    how = {
        "data": swings,
        "diffusion": teacher,
        "minutes": 0,
        "validate_every": 2,
        "batch": 4,
        "rows": 4,
        "bf16": False,
    }
    train_few_steps(FewStepsConfig(out=tmp_path / "run", steps=2, **how), encoder=encoder)
    path = train_few_steps(FewStepsConfig(out=tmp_path / "run", steps=4, **how), encoder=encoder)
    state = load_training_state(path.with_name("state.safetensors"))
    assert state.step == 4 and int(state.values["drawn"]) >= 2
    with pytest.raises(OptionError, match="another network"):
        train_few_steps(FewStepsConfig(out=tmp_path / "run", steps=5, rank=3, **how), encoder=encoder)


def test_shares_are_checked(teacher, swings, encoder, tmp_path):
    config = FewStepsConfig(data=swings, diffusion=teacher, out=tmp_path / "run", led=0.8, rolled=0.3)
    with pytest.raises(OptionError, match="at most 1"):
        train_few_steps(config, encoder=encoder)
