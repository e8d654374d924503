"""Rows kept on a device, encoded sentences, and rehearsed examples."""

import threading
from dataclasses import replace

import numpy as np
import pytest
import torch

from bunraku.errors import OptionError
from bunraku.generation.features import FeatureStatistics
from bunraku.generation.pack import load_examples
from bunraku.language.encoders import MiniLMEncoder
from bunraku_lab.nn.denoiser import load_denoiser
from bunraku_lab.training.diffusion.train import TrainingConfig, train_diffusion, training_card, write_card
from bunraku_lab.training.rows.banks import MeshBank, TextBank
from bunraku_lab.training.rows.clip_rows import ClipSet, Mixture
from bunraku_lab.training.rows.clips import ClipEntry, load_clips, rehearsal_clips
from bunraku_lab.training.rows.workers import FedPool, MadeRows, RowMaker, RowPool, RowWorkers

CPU = torch.device("cpu")


@pytest.fixture
def maker(swings, encoder):
    clips = load_clips(swings)
    statistics = FeatureStatistics.measure([entry["features"] for entry in clips.values()])
    meshes = MeshBank(torch.arange(12.0).view(3, 4), {}, np.arange(3))
    return RowMaker(ClipSet(clips, statistics, frames=60), TextBank(encoder, []), 5, 0.0, meshes)


def rows(first, count=4, frames=5, found=()):
    """Made rows that each tell their number in all that they hold."""
    numbers = np.arange(first, first + count)
    values = np.broadcast_to(numbers[:, None, None], (count, frames, 3)).astype(np.float16)
    examples = np.array([[3, 8]] * count if found else np.zeros((count, 0)), np.int64)
    tokens = np.broadcast_to(numbers[:, None, None], (count, 2, 6)).astype(np.float16)
    pooled = np.broadcast_to(numbers[:, None], (count, 6)).astype(np.float32)
    return MadeRows(
        values, np.full(count, frames), tokens, np.full(count, 2), pooled, numbers % 3 - 1, numbers % 2 == 0,
        examples, examples[:, ::-1], dict(found),
    )  # fmt: skip


def test_processes_make_what_this_one_makes_and_tell_what_went_wrong(maker):
    workers = RowWorkers(maker, 2, first=3)
    try:
        found = [made for made, _ in zip(workers, range(4), strict=False)]
    finally:
        workers.close()
    wanted = [maker(number) for number in range(3, 9)]
    for made in found:
        assert any(
            made.values.shape == one.values.shape
            and (made.values == one.values).all()
            and (made.mesh == one.mesh).all()
            and (made.tokens == one.tokens).all()
            for one in wanted
        )
    assert len({made.values.tobytes() for made in found}) == 4
    broken = RowWorkers(RowMaker(maker.clips, None, 5, 0.0), 1)
    try:
        with pytest.raises(TypeError):
            next(iter(broken))
    finally:
        broken.close()


def test_a_pool_gives_rows_whole_and_keeps_the_newest():
    features = {
        3: (np.full((4, 3), 0.5, np.float16), np.full(6, 3.0)),
        8: (np.ones((2, 3), np.float16), np.full(6, 8.0)),
    }
    meshes = MeshBank(torch.arange(12.0).view(3, 4), {}, np.arange(3))
    pool = RowPool(8, 7, CPU, meshes)
    for first in (0, 4, 8):
        pool.add(rows(first, found=features.items()))
    assert len(pool) == 8 and pool.added == 12
    drawn = pool.draw(200, torch.Generator().manual_seed(0))
    number = drawn.clean[:, 0, 0]
    assert set(number.int().tolist()) == set(range(4, 12))
    assert drawn.clean.shape == (200, 7, 3) and not drawn.clean[:, 5:].any() and (drawn.lengths == 5).all()
    assert (drawn.clean[:, :5] == number[:, None, None]).all() and (drawn.text.pooled == number[:, None]).all()
    assert (drawn.text.tokens[:, :2] == number[:, None, None]).all() and (drawn.text.mask.sum(1) == 2).all()
    assert (drawn.known == (number % 3 > 0)).all() and (drawn.person == (number % 2 == 0)).all()
    known = drawn.known
    assert (drawn.mesh[known] == meshes.features[(number[known] % 3 - 1).long()]).all()
    assert (drawn.examples.lengths == torch.tensor([4, 2])).all() and (drawn.examples.values[:, 0, :4] == 0.5).all()
    assert (drawn.examples.pooled[:, 0] == 3).all() and not drawn.examples.values[:, 1, 2:].any()
    turned = pool.draw(3, torch.Generator().manual_seed(0), nearest=True)
    assert (turned.examples.lengths == torch.tensor([2, 4])).all()


def test_a_pool_whose_processes_fail_is_closed():
    """While more waits to be taken than is taken."""

    class Failing:
        closed = False

        def __iter__(self):
            yield from (rows(4 * number) for number in range(8))
            raise ValueError("out of clips")

        def close(self):
            self.closed = True

    workers = Failing()
    fed = FedPool(RowPool(8, 7, CPU), workers)
    closing = threading.Thread(target=fed.close)
    closing.start()
    closing.join(20)
    assert workers.closed and not closing.is_alive()


def test_a_denoiser_trains_on_a_pool(swings, tmp_path, config, encoder):
    how = {"data": swings, "minutes": None, "batch": 4, "device": "cpu", "workers": 1, "pool": 64}
    path = train_diffusion(TrainingConfig(out=tmp_path / "run", steps=3, **how), config(), encoder)
    assert load_denoiser(path).notes["steps"] == 3
    train_diffusion(TrainingConfig(out=tmp_path / "run", steps=5, **how), config(), encoder)  # it goes on
    assert load_denoiser(path).notes["steps"] == 5
    with pytest.raises(OptionError, match="pool must hold a batch"):
        train_diffusion(TrainingConfig(out=tmp_path / "other", **{**how, "pool": 2}), config(), encoder)


def test_what_is_kept_is_what_the_first_sitting_learned_from(tmp_path):
    sentences = ["a person walks", "a person waves", "somebody jumps over the fence and laughs"]
    first = TextBank(MiniLMEncoder(), sentences, tmp_path / "captions.safetensors")
    second = TextBank(MiniLMEncoder(), sentences, tmp_path / "captions.safetensors")
    ours, theirs = first(sentences), second(sentences)
    assert torch.equal(ours.tokens, theirs.tokens) and torch.equal(ours.mask, theirs.mask)
    assert torch.equal(ours.pooled, theirs.pooled)


@pytest.fixture(scope="module")
def clips():
    pack = load_examples()
    if pack is None:
        pytest.skip("the shipped examples are not there")
    told = [one for one in pack.examples if one.texts and not one.made]
    places = [pack.examples.index(one) for one in told[:20]]
    few = replace(pack, examples=tuple(told[:20]), data=tuple(pack.data[place] for place in places))
    known = rehearsal_clips(few)
    features = next(iter(known.values()))["features"]
    own = ClipEntry(
        features=features, frames=len(features), texts=["a person yodels"], watched=True, licence="CC BY 4.0",
        credit="A. Person",
    )  # fmt: skip
    return {"own_yodel": own} | known


def test_the_share_of_what_is_rehearsed_is_that_which_is_wanted(clips):
    statistics = FeatureStatistics.measure([entry["features"] for entry in clips.values()])
    rows = ClipSet(clips, statistics, mixture=Mixture(creatures=0.0, borrowed=0.0, events=0.0, rehearse=0.75))
    known = np.array([clip.rehearsed for clip in rows.clips])
    assert known.sum() == 20 and rows.probability[known].sum() == pytest.approx(0.75)
    assert rows.probability[~known].sum() == pytest.approx(0.25)
    alone = ClipSet({"own_yodel": clips["own_yodel"]}, statistics, mixture=Mixture(rehearse=0.75))
    assert alone.probability.tolist() == [1.0]


def test_the_card_names_terms_and_people_also_of_what_the_run_started_from(clips, tmp_path):
    start = tmp_path / "first.safetensors"
    write_card(start, "# Model card\n\n- no credit\n\n## Credits\n\n- Somebody. Licence: MIT.\n")
    own = {"own_yodel": clips["own_yodel"], "cmu_01_01": clips["own_yodel"] | {"licence": "CMU", "credit": ""}}
    card = training_card(own, TrainingConfig(start=start))
    seconds = len(clips["own_yodel"]["features"]) / 20
    assert f"| CC BY 4.0 | {seconds / 60:.1f} |" in card and "first.safetensors" in card
    assert "- A. Person. Licence: CC BY 4.0." in card and "mocap.cs.cmu.edu" in card
    assert "- Somebody. Licence: MIT." in card and "- no credit" not in card
