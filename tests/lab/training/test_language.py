"""The tagger of other languages is trained on pairs, and numpy reads what torch learned."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from bunraku.errors import FormatError, OptionError
from bunraku.language.foreign_tagger import TaggerConfig, load_tagger, units
from bunraku.language.lexicon import actions_of
from bunraku_lab.training.language import (
    FILES,
    TaggerNetwork,
    TaggerTrainConfig,
    TaggerTrainer,
    batch_of,
    drawn_number,
    lessons_of,
    read_pairs,
    save_tagger,
    sentence_losses,
    split_of,
    table_pairs,
    train_tagger,
    verbs_of_actions,
)

TINY = TaggerConfig(buckets=256, width=8, hidden=16)


@pytest.fixture
def folder(tmp_path):
    """Made-up pairs: "wup" is always where the English dances."""
    dances = [f"{name} danced in the room {number}.\tdie wup {name} {number}" for name in "ABC" for number in range(12)]
    others = [f"{name} likes tea {number}.\tdie tok {name} {number}" for name in "ABC" for number in range(12)]
    for name in FILES.values():
        (tmp_path / name).write_text("\n".join(dances + others), encoding="utf-8")
    return tmp_path


def test_what_is_held_out_is_drawn_by_the_english_sentence(folder):
    splits = [split_of(f"sentence {number}") for number in range(4000)]
    assert 0.08 < splits.count("held") / 4000 < 0.12 and 0.035 < splits.count("val") / 4000 < 0.065
    assert drawn_number("a") == drawn_number("a") != drawn_number("a", "another draw")
    seen = [{pair.english for pair in read_pairs(folder, [split])} for split in ("train", "val", "held")]
    assert not seen[0] & seen[1] and not seen[0] & seen[2] and len(set.union(*seen)) == 72


def test_a_missing_file_and_a_line_that_is_no_pair_are_refused(folder):
    (folder / "jpn.txt").write_text("no tab", encoding="utf-8")
    with pytest.raises(FormatError, match=r"jpn\.txt: line 1 is not a pair"):
        read_pairs(folder)
    (folder / "deu.txt").unlink()
    with pytest.raises(FormatError, match=r"deu\.txt.*missing"):
        read_pairs(folder)


def test_the_tables_forms_say_one_action_each():
    pairs = table_pairs()
    assert {pair.language for pair in pairs} == set(FILES) and len(pairs) > 4000
    written = {pair.other for pair in pairs if pair.actions == ("dance",)}
    assert {"eine Person tanzt", "人が踊って", "一个人跳舞"} <= written
    assert all(actions_of(pair.english) == pair.actions for pair in pairs)


def test_numpy_reads_what_torch_learned(tmp_path):
    torch.manual_seed(0)
    model = TaggerNetwork(replace(TINY, verbs=("{walk}", "{run}", "{wave}"))).eval()
    torch.nn.init.normal_(model.leave.bias)
    texts = {"de": "Der Mann winkt mit der Hand und geht", "zh": "一个人慢慢地走"}
    path = save_tagger(tmp_path / "tagger.safetensors", model, {})
    network = load_tagger(path)
    with torch.no_grad():
        model.pieces.weight.copy_(torch.from_numpy(network.steps * network.scale))
        for language, text in texts.items():
            pairs = read_lessons(text, language)
            theirs = torch.sigmoid(model(*batch_of(pairs))).numpy()
            assert np.abs(network(units(text, language), language) - theirs).max() < 2e-3
            silence = sentence_losses(model(*batch_of(pairs)), torch.tensor([len(theirs)]))
            assert np.allclose(torch.exp(-silence)[0].numpy(), (1 - theirs).prod(0), atol=1e-4)
        together = torch.sigmoid(model(*batch_of([one for item in texts.items() for one in read_lessons(*item[::-1])])))
    assert np.allclose(together[-len(theirs) :].numpy(), theirs, atol=1e-5)  # sentences do not see each other


def read_lessons(text, language):
    from bunraku_lab.training.language import Pair

    return lessons_of([Pair("", text, language)], ["walk"], TINY.buckets, lambda sentence: {})


def test_it_learns_which_word_says_the_movement(folder, tmp_path):
    network = replace(TINY, verbs=("{dance}", "{walk}"))
    lessons, held = (
        lessons_of(
            read_pairs(folder, [split]), ["dance", "walk"], network.buckets, lambda sentence: {"dance": 1.0}
        )
        for split in ("train", "held")
    )  # fmt: skip
    config = TaggerTrainConfig(
        out=tmp_path, minutes=0, steps=150, batch=32, warmup=5, validate_every=75, decay=0.9, rate=0.02, network=network
    )
    rows = []
    path = TaggerTrainer(config, lessons, held).learn(rows.append)
    assert rows[-1]["validation"] < rows[0]["validation"] and rows[-1]["recall"] == rows[-1]["precision"] == 1
    said = load_tagger(path)(units("die wup X", "de"), "de")[:, 0]
    assert said.argmax() == 1 and said[1] > 0.5 > load_tagger(path)(units("die tok X", "de"), "de")[:, 0].max()


def test_it_goes_on_where_it_stopped_and_with_the_same_network(folder, tmp_path):
    config = TaggerTrainConfig(
        pairs=folder, out=tmp_path / "run", minutes=0, steps=4, batch=8, validate_every=2, encoded=0, network=TINY
    )
    rows = []
    path = train_tagger(config, rows.append)
    assert load_tagger(path).config.verbs[0] in verbs_of_actions().values()
    train_tagger(replace(config, steps=6), rows.append)
    assert [row["step"] for row in rows] == [2, 4, 6]
    with pytest.raises(OptionError, match="another network"):
        train_tagger(replace(config, steps=8, network=replace(TINY, width=4)))
