import numpy as np
import pytest
import torch
from swings import PARTS, WordEncoder, swing

from bunraku.errors import OptionError, WeightsError
from bunraku.generation.extractor import RADIUS, ExtractorConfig, embed_motions, load_extractor
from bunraku_lab.datasets.motions.clips import write_clip, write_index
from bunraku_lab.evaluation.motion.train_extractor import ExtractorTrainConfig, train_extractor
from bunraku_lab.nn.text import Extractor, embed_sentences, running_extractor, save_extractor

TINY = ExtractorConfig(
    width=16, layers=1, heads=2, feedforward=32, embedding=8, text_size=8, pooled_size=8, text_encoder="words",
    dropout=0.0,
)  # fmt: skip


def extractor(seed=0):
    torch.manual_seed(seed)
    return Extractor(TINY)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Motions of one handle each, told apart by their captions."""
    folder = tmp_path_factory.mktemp("motions")
    index = {}
    for part, verb in list(PARTS.items())[:5]:
        for number, split in enumerate(("train", "train", "val", "test")):
            write_clip(folder / f"{verb}{number}.npz", swing(part, 60, 0.8 + 0.1 * number))
            index[f"{verb}{number}"] = {"texts": [f"the figure {verb}"], "split": split, "frames": 60}
    write_index(folder, index)
    return folder


def settings(data, out, **changes):
    quick = {
        "minutes": 0.0, "steps": 40, "batch": 10, "rate": 3e-3, "warmup": 5, "decay": 0.9, "bf16": False,
        "validate_every": 20,
    }  # fmt: skip
    return ExtractorTrainConfig(data=data, out=out, extractor=TINY, **{**quick, **changes})


def test_padding_does_not_change_a_motion():
    model, random = running_extractor(extractor()), np.random.default_rng(0)
    motions = [random.normal(size=(frames, 271)) for frames in (41, 196, 60)]
    together = embed_motions(model, motions)
    for motion, vector in zip(motions, together, strict=True):
        assert np.allclose(embed_motions(model, [motion])[0], vector, atol=1e-4)
    dirty = np.full((1, 80, 271), 5.0, np.float32)
    dirty[0, :41] = motions[0]
    assert np.allclose(
        model.motion(dirty, np.array([41]))[0], together[0], atol=1e-4
    )  # what lies behind the end does not count
    assert np.allclose(np.linalg.norm(together, axis=1), RADIUS)


def test_a_checkpoint_gives_the_same_vectors(tmp_path):
    model = extractor()
    path = save_extractor(tmp_path / "extractor.safetensors", model, {"steps": 3})
    again = load_extractor(path)
    motion = [np.random.default_rng(0).normal(size=(50, 271))]
    assert again.notes == {"steps": 3}
    assert np.allclose(
        embed_motions(again, motion), embed_motions(running_extractor(model), motion), atol=0.05
    )  # half precision
    with pytest.raises(WeightsError, match="no such checkpoint"):
        load_extractor(tmp_path / "none.safetensors")


def test_training_brings_motions_and_their_sentences_together(data, tmp_path):
    rows = []
    path = train_extractor(settings(data, tmp_path / "run", steps=120), rows.append, WordEncoder())
    assert rows[-1]["loss"] < 0.3 * rows[0]["loss"]
    model = load_extractor(path)
    from bunraku_lab.training.rows.clips import load_clips

    clips = load_clips(data, splits={"test"})
    sentences = embed_sentences(model, WordEncoder(), [entry["texts"][0] for entry in clips.values()])
    vectors = embed_motions(model, [entry["features"] for entry in clips.values()])
    for vector, entry in zip(vectors, clips.values(), strict=True):
        assert min(sentences, key=lambda sentence: np.linalg.norm(vector - sentences[sentence])) == entry["texts"][0]
    assert (tmp_path / "run" / "log.csv").is_file()


def test_bad_settings_are_one_sentence(data, tmp_path):
    with pytest.raises(OptionError, match="batch"):
        train_extractor(settings(data, tmp_path / "run", batch=1), encoder=WordEncoder())
