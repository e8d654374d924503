import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from bunraku.errors import OptionError
from bunraku.generation.candidates import ClassifierGuidance, Spoken
from bunraku.generation.denoiser import load_denoiser, load_denoiser_of_few_steps, load_few_steps
from bunraku.generation.extractor import RADIUS, ExtractorConfig
from bunraku.generation.features import FeatureStatistics
from bunraku.generation.sampler import Solver, Steering, Window, alphas_cumprod, sample_windows
from bunraku_lab.evaluation.motion.samples import sample
from bunraku_lab.nn.checkpoints import load_training_state
from bunraku_lab.nn.denoiser import load_denoiser as load_torch_denoiser
from bunraku_lab.nn.denoiser import save_denoiser
from bunraku_lab.nn.text import Extractor, running_extractor, tensors_of
from bunraku_lab.training.few_steps.teacher import Teacher, draw_trajectories, visited_steps
from bunraku_lab.training.few_steps.train import FewStepsConfig, train_few_steps
from bunraku_lab.training.rows.clip_rows import ClipSet
from bunraku_lab.training.rows.clips import load_clips
from bunraku_lab.training.rows.workers import DrawnRows


@pytest.fixture
def teacher(tmp_path, denoiser, swings):
    """Path of a small denoiser with the units of four motions."""
    statistics = FeatureStatistics.measure([entry["features"] for entry in load_clips(swings).values()])
    model = denoiser()
    model.mean.copy_(torch.from_numpy(statistics.mean))
    model.std.copy_(torch.from_numpy(statistics.std))
    return save_denoiser(tmp_path / "diffusion.safetensors", model, half=False)


def rows(teacher, swings, encoder, count=3):
    """A torch denoiser and held rows of different lengths, the last one a creature's."""
    model = load_torch_denoiser(teacher).float()
    batch = ClipSet(load_clips(swings), FeatureStatistics(model.mean.numpy(), model.std.numpy()), frames=60).fixed(
        count
    )
    lengths = batch.lengths - np.arange(count) * 7
    values = torch.from_numpy(batch.values * (np.arange(batch.values.shape[1]) < lengths[:, None])[..., None])
    yes = torch.ones(count, dtype=torch.bool)
    person = yes & (torch.arange(count) < count - 1)
    text = tensors_of(encoder.encode(batch.sentences))
    return model, DrawnRows(values, torch.from_numpy(lengths), text, None, ~yes, person, None), batch.sentences


@pytest.mark.parametrize(("critic", "mesh"), [(False, False), (True, False), (True, True)])
def test_the_teacher_draws_what_users_see(teacher, swings, encoder, critic, mesh):
    """The same noise through the sampler for arrays, with and without the critic's pull and characters."""
    model, own, sentences = rows(teacher, swings, encoder)
    if mesh:
        features = torch.randn(len(own.lengths), model.config.mesh_features, generator=torch.Generator().manual_seed(9))
        own = replace(own, mesh=features, known=torch.ones_like(own.known))
    noise = torch.randn(own.clean.shape, generator=torch.Generator().manual_seed(3))
    network, lengths = model.running(), own.lengths.numpy()
    longest, guidance, pull = noise.shape[1], 2.0, None
    if critic:
        torch.manual_seed(4)
        sizes = {"text_size": encoder.token_size, "pooled_size": encoder.pooled_size}
        pull = Extractor(ExtractorConfig(width=16, layers=1, heads=2, feedforward=16, **sizes)).eval()
        array = running_extractor(pull)
        goals = array.text(encoder.encode(sentences)) / RADIUS
        spans = [(row * longest, row * longest + int(length)) for row, length in enumerate(lengths)]
        spoken = [Spoken(span, goal) for span, goal, person in zip(spans, goals, own.person, strict=True) if person]
        steering = Steering(ClassifierGuidance(array, network.mean, network.std, spoken))
    else:
        steering = Steering()
    windows = [
        Window(np.arange(row * longest, row * longest + length), np.ones(length, np.float32), row)
        for row, length in enumerate(lengths)
    ]
    flat = noise.numpy().reshape(-1, noise.shape[2])
    given = None if own.mesh is None else own.mesh.numpy()
    text, solver = encoder.encode(sentences), Solver(20, guidance)
    wanted = sample_windows(network, text, windows, flat, solver, steering, mesh_features=given).values
    drawn = Teacher(model, pull, guidance)(own, noise)
    for row, (length, one) in enumerate(zip(lengths, wanted.reshape(noise.shape), strict=True)):
        np.testing.assert_allclose(drawn[row, :length], one[:length], atol=2e-3)


def test_targets_lead_from_node_to_node_and_to_the_teachers_motion(teacher, swings, encoder):
    model, own, _ = rows(teacher, swings, encoder)
    draws = Teacher(model, None, 2.0)
    found = draw_trajectories(draws, own, torch.Generator().manual_seed(0))
    noise = torch.randn(own.clean.shape, generator=torch.Generator().manual_seed(0))
    assert found.start == 0 and found.lessons == 12 and torch.equal(found.stations[0], noise.half())
    torch.testing.assert_close(found.stations[-1].float(), draws(own, noise), atol=5e-3, rtol=1e-2)
    nodes = torch.tensor([3, 1])
    told, here, there = found.some(torch.tensor([2, 0]), nodes)
    assert torch.equal(told.lengths, own.lengths[[2, 0]]) and torch.equal(told.text.mask, own.text.mask[[2, 0]])
    assert torch.equal(here[0], found.stations[3, 2].float()) and torch.equal(there[1], found.stations[2, 0].float())
    again = draw_trajectories(draws, own, torch.Generator().manual_seed(0))
    assert torch.equal(again.stations, found.stations)


def test_trajectories_begin_at_noised_captures_or_where_the_student_is(teacher, swings, encoder):
    model, own, _ = rows(teacher, swings, encoder)
    draws = Teacher(model, None, 2.0)
    led = draw_trajectories(draws, own, torch.Generator().manual_seed(0), 2)
    assert led.start == 2 and led.lessons == 6
    noise = torch.randn(own.clean.shape, generator=torch.Generator().manual_seed(0))
    share = alphas_cumprod()[visited_steps(draws)[2]]
    expected = math.sqrt(share) * own.clean + math.sqrt(1 - share) * noise
    torch.testing.assert_close(led.stations[0].float(), expected, atol=4e-3, rtol=1e-3)
    rolled = draw_trajectories(draws, own, torch.Generator().manual_seed(0), 3, lambda _, x, stop: x * 0 + stop)
    assert rolled.lessons == 3 and (rolled.stations[0] == 3).all()


def test_the_student_comes_near_to_its_teacher_and_runs(teacher, swings, encoder, tmp_path):
    """Four steps of a trained student end nearer to twenty guided ones than four steps without changes do."""
    how = {
        "data": swings, "diffusion": teacher, "guidance": 1.5, "rank": 8, "batch": 8, "rows": 8, "rate": 3e-3,
        "critic": False,
    }  # fmt: skip
    config = FewStepsConfig(out=tmp_path / "run", minutes=0, steps=60, validate_every=20, bf16=False, uses=4, **how)
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
        "data": swings, "diffusion": teacher, "minutes": 0, "validate_every": 2, "batch": 4, "rows": 4, "bf16": False,
        "critic": False,
    }  # fmt: skip
    train_few_steps(FewStepsConfig(out=tmp_path / "run", steps=2, **how), encoder=encoder)
    path = train_few_steps(FewStepsConfig(out=tmp_path / "run", steps=4, **how), encoder=encoder)
    state = load_training_state(path.with_name("state.safetensors"))
    assert state.step == 4 and int(state.values["drawn"]) >= 2
    started = train_few_steps(
        FewStepsConfig(out=tmp_path / "next", steps=1, rate=1e-12, start=path, **how), encoder=encoder
    )
    before, after = (load_few_steps(one).changes["steer.weight"] for one in (path, started))
    np.testing.assert_allclose(before[0], after[0], atol=1e-4)
    with pytest.raises(OptionError, match="give their rank"):
        train_few_steps(FewStepsConfig(out=tmp_path / "wide", steps=1, rank=3, start=path, **how), encoder=encoder)
    pooled = train_few_steps(FewStepsConfig(out=tmp_path / "pool", steps=2, workers=1, pool=64, **how), encoder=encoder)
    assert len(load_few_steps(pooled).visited) == 4
    with pytest.raises(OptionError, match="another network"):
        train_few_steps(FewStepsConfig(out=tmp_path / "run", steps=5, rank=3, **how), encoder=encoder)


def test_shares_are_checked(teacher, swings, encoder, tmp_path):
    config = FewStepsConfig(data=swings, diffusion=teacher, out=tmp_path / "run", led=0.8, rolled=0.3)
    with pytest.raises(OptionError, match="at most 1"):
        train_few_steps(config, encoder=encoder)
    with pytest.raises(OptionError, match="leave the critic out"):
        train_few_steps(replace(config, rolled=0.1), encoder=encoder)
