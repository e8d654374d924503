"""The clip library: its table against the examples, what is found by which words, and its motions."""

import json

import numpy as np
import pytest

import bunraku
from bunraku.anatomy.anatomy import reference_anatomy
from bunraku.cli import main
from bunraku.core.body.reference import reference_body
from bunraku.generation.library import all_clips, clip, search
from bunraku.generation.pack import load_examples
from bunraku.language.lexicon import lexicon
from bunraku_lab.synthetic.samples import make_sample


def test_each_row_says_what_its_stretch_is():
    pack = load_examples()
    examples = {one.name: one for one in pack.examples}
    assert len(all_clips()) >= 150 and len({one.stretch for one in all_clips()}) == len(all_clips())
    for one in all_clips():
        example = examples[one.stretch]
        assert one.sentence in example.texts, one.name
        assert one.seconds == pytest.approx(example.frames / 20, abs=0.005), one.name
        assert one.loops == (example.loop is not None), one.name
        assert set(one.tags[1:]) <= set(lexicon().actions), one.name
        assert one.source.credit and one.source.terms


def test_credits_and_terms_are_those_of_the_examples():
    card = (bunraku.__file__.rpartition("/")[0]) + "/weights/examples.md"
    with open(card, encoding="utf-8") as file:
        text = " ".join(file.read().replace("**", "").split())
    for source in {one.source for one in all_clips()}:
        if source.terms != "Apache-2.0":
            assert source.terms.split(";")[0] in text, source
        assert source.begins[0].split("_")[0] in text


@pytest.mark.parametrize(
    ("words", "first"),
    [
        ("wave", "wave"),
        ("waves", "wave"),
        ("waves hello", "wave-hello"),
        ("wav", "wave"),
        ("applauds", "clap"),
        ("somebody strums the strings", "guitar"),
        ("spielt Gitarre", "guitar"),
        ("says no", "shake-head"),
        ("on the phone", "phone"),
        ("walk-robot", "walk-robot"),
    ],
)
def test_words_find_clips(words, first):
    assert search(words)[0].name == first


def test_each_name_and_each_sentence_finds_its_clip():
    for one in all_clips():
        assert one == search(one.name)[0]
        assert one in search(one.sentence)


def test_tags_narrow_a_search():
    assert {one.tags[0] for one in search("", ["dance"])} == {"dance"}
    assert search("zzzzzz") == [] and search("the") == [] and search("walks", ["music"]) == []
    assert search() == list(all_clips())


def test_a_name_that_is_none_is_answered_with_some_like_it():
    with pytest.raises(bunraku.OptionError, match="wave-hello"):
        clip("wave-helo")


def test_a_clip_stands_on_the_ground_and_lasts_as_long_as_is_asked():
    body = reference_body()
    for name in ("wave", "run", "bow"):
        motion = clip(name).motion()
        assert len(motion) == round(20 * clip(name).seconds)
        heights = reference_anatomy().surface_reach.lowest(motion.transforms(body.handles.positions))
        assert np.quantile(heights, 0.05) == pytest.approx(0, abs=0.03)
        long, short = clip(name).motion(12), clip(name).motion(1)
        assert len(long) == 240 and len(short) == 20
        np.testing.assert_allclose(long.rotations[:18], motion.rotations[:18], atol=1e-5)
    assert np.abs(clip("run").motion(12).root_translation[-1]).max() > 20  # it runs on
    assert np.abs(np.diff(clip("bow").motion(12).root_translation[-40:], axis=0)).max() < 1e-3  # it waits
    with pytest.raises(bunraku.OptionError, match="120"):
        clip("run").motion(500)


def test_a_clip_goes_on_a_character():
    character = make_sample("mushroom", 0.3)
    made = bunraku.transfer(character, bunraku.clips.clip("jumping-jacks").motion())
    assert np.isfinite(made.vertices([0, 20])).all() and len(made.motion) > 60


def test_the_command_lists_searches_and_writes(tmp_path, capsys):
    assert main(["clips", "dance", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert "charleston" in [one["name"] for one in found] and all(one["credit"] for one in found)
    assert main(["clips", "--tag", "music"]) == 0
    assert "violin" in capsys.readouterr().out
    assert main(["clips", "bow", "-o", str(tmp_path / "bow.bvh")]) == 0
    assert (tmp_path / "bow.bvh").read_text().startswith("HIERARCHY")
    assert main(["clips", "zzzzzz", "-o", str(tmp_path / "no.bvh")]) == 2
    assert "no clip is found" in capsys.readouterr().err and not (tmp_path / "no.bvh").exists()
