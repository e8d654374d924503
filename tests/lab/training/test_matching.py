from dataclasses import replace

import numpy as np
import pytest

from bunraku.errors import OptionError, WeightsError
from bunraku.generation.extractor import RANKER, ExtractorConfig, load_extractor
from bunraku.generation.features import mirror
from bunraku.language.encoders import CUES, text_encoder
from bunraku_lab.training.matching import RankerTrainConfig, alike, corrupted, train_ranker
from bunraku_lab.training.rows.banks import batched

TINY = ExtractorConfig(width=16, layers=1, heads=2, feedforward=16, embedding=8, dropout=0.0)


def test_sentences_of_one_meaning_are_not_wrong_for_each_other():
    found = alike(["walk", "a person walks", "kick left", "kick right", "kick with the left leg"])
    assert found[0, 1] and found[2, 4] and not found[2, 3] and not found[0, 2] and not found.diagonal().any()


def test_spoilt_motions_are_mirrored_small_backwards_trembling_or_twice(features):
    values, random = features("left_elbow", frames=80), np.random.default_rng(0)
    seen = set()
    for _ in range(60):
        wrong = corrupted(values, random, True)
        assert wrong.shape[0] <= 80 and np.isfinite(wrong).all() and not np.array_equal(wrong, values)
        backwards = values[::-1].copy()
        backwards[:, :3] *= -1
        if np.array_equal(wrong, mirror(values)):
            seen.add("mirrored")
        elif np.array_equal(wrong, backwards):
            seen.add("backwards")
        elif wrong.std() < 0.7 * values.std() or np.ptp(wrong, axis=0).max() < 0.7 * np.ptp(values, axis=0).max():
            seen.add("small")
    assert {"mirrored", "backwards", "small"} <= seen
    assert not any(np.array_equal(corrupted(values, random, False), mirror(values)) for _ in range(60))


def test_it_learns_and_goes_on_where_it_stopped(swings, encoder, tmp_path):
    config = RankerTrainConfig(
        data=swings,
        out=tmp_path / "run",
        minutes=0,
        steps=10,
        batch=8,
        warmup=5,
        bf16=False,
        validate_every=5,
        network=TINY,
    )
    rows = []
    path = train_ranker(config, rows.append, encoder)
    assert rows[-1]["step"] == 10 and all(np.isfinite(list(row.values())).all() for row in rows)
    assert load_extractor(path, kind=RANKER).notes["steps"] == 10
    with pytest.raises(WeightsError):
        load_extractor(path)  # a ranker does not judge
    train_ranker(replace(config, steps=15), rows.append, encoder)
    assert rows[-1]["step"] == 15
    with pytest.raises(OptionError, match="another network"):
        train_ranker(replace(config, steps=20, network=replace(TINY, width=24)), None, encoder)


def test_sentences_are_read_by_the_encoder_that_is_asked_for(swings, tmp_path):
    cued = replace(TINY, text_encoder="all-MiniLM-L6-v2+cues")
    config = RankerTrainConfig(data=swings, out=tmp_path / "run", minutes=0, steps=1, batch=4, bf16=False, network=cued)
    found = load_extractor(train_ranker(config), kind=RANKER).config
    assert (found.text_encoder, found.pooled_size) == ("all-MiniLM-L6-v2+cues", 384 + len(CUES))


def test_sentences_side_by_side_are_those_of_each_alone():
    alone = text_encoder("all-MiniLM-L6-v2+cues")
    sentences = ["a person waves", "Sword_Slash_01", "walks left", "she lowers herself slowly onto the chair", "jump"]
    together = batched(alone).encode(sentences)
    for row, sentence in enumerate(sentences):
        one = alone.encode([sentence])
        np.testing.assert_allclose(together.tokens[row][together.mask[row]], one.tokens[0], atol=1e-4)
        np.testing.assert_allclose(together.pooled[row], one.pooled[0], atol=1e-5)


def test_a_run_goes_on_from_the_weights_of_another_in_their_units(swings, encoder, tmp_path):
    def run(name, **changes):
        settings = {"minutes": 0, "batch": 8, "warmup": 0, "bf16": False, "network": TINY, **changes}
        return train_ranker(RankerTrainConfig(data=swings, out=tmp_path / name, **settings), None, encoder)

    first = run("first", steps=40, rate=3e-3)
    on = run("on", steps=1, rate=1e-9, start=first, seed=1)
    before, after = (load_extractor(path, kind=RANKER) for path in (first, on))
    assert after.notes["steps"] == 1
    motion, lengths = np.random.default_rng(0).normal(size=(2, 60, 271)).astype(np.float32), np.array([60, 40])
    assert np.allclose(after.motion(motion, lengths), before.motion(motion, lengths), atol=0.05)  # half precision
    afresh = load_extractor(run("afresh", steps=1, rate=1e-9, seed=1), kind=RANKER)
    assert not np.allclose(afresh.motion(motion, lengths), before.motion(motion, lengths), atol=1)
    with pytest.raises(OptionError, match="whose width differ"):
        run("other", steps=1, start=first, network=replace(TINY, width=24))
    with pytest.raises(WeightsError):
        run("none", steps=1, start=tmp_path / "none.safetensors")
