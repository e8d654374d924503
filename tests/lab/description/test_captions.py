"""Captions of motions, and their grammar."""

import json
import os
from importlib import resources
from pathlib import Path

import pytest

from bunraku.language.captions import conjugate, mirror_words
from bunraku_lab.description.captions import (
    caption_group,
    caption_variants,
    creature_clauses,
    creature_names,
    creature_variants,
    fill,
    normalise_label,
    sentence_forms,
)


def test_every_verb_of_a_phrase_changes_and_nothing_else():
    phrase = "slowly {sit} down while singing and {wait}"
    assert conjugate(phrase, "third") == "slowly sits down while singing and waits"
    assert fill("the character is {gerund}", phrase) == "the character is slowly sitting down while singing and waiting"


def test_sentences_are_of_several_styles_and_always_the_same():
    found = sentence_forms("{jump} up")
    for sentence in ("a person jumps up", "a person is jumping up", "jump up", "jumps up", "jumping up"):
        assert sentence in found
    assert len(set(found)) == len(found) > 7 and found == sentence_forms("{jump} up")
    styles = {
        sentence
        for phrase in ("{jump}", "{hop}", "{leap}", "{sit}", "{bow}", "{nod}")
        for sentence in sentence_forms(phrase)
    }
    assert any(sentence.startswith(("make", "please", "can you", "let")) for sentence in styles)
    assert any(sentence.startswith(("he ", "she ", "it ")) for sentence in styles)


def test_labels_are_cleaned_and_grouped_by_meaning():
    assert normalise_label("  Walk_Forward. ") == "walk forward"
    assert caption_group("A person kicks.") is caption_group("kick") is caption_group("front kick")
    assert caption_group("kick") is not caption_group("walk")
    unknown = caption_group("Juggles seven swords")
    assert unknown.name == "juggles seven swords" and unknown.phrases == () and unknown.weight == 1


def shipped():
    return json.loads(resources.files("bunraku.language").joinpath("captions.json").read_text(encoding="utf-8"))[
        "groups"
    ]


def test_all_shipped_phrases_make_sentences():
    groups = shipped()
    labels = [label for group in groups for label in group["labels"]]
    assert len(set(labels)) == len(labels) and all(label == normalise_label(label) for label in labels)
    for group in groups:
        for sentence in caption_variants(group["labels"][0]):
            assert "{" not in sentence and "  " not in sentence and sentence == sentence.strip()


def enough(label):
    sentences = caption_variants(label)
    lengths = {len(sentence.split()) for sentence in sentences}
    return bool(caption_group(label).phrases) and len(sentences) >= 20 and min(lengths) <= 6 and max(lengths) >= 8


def test_game_clips_have_rewordings():
    table = json.loads(
        resources.files("bunraku_lab.datasets.motions").joinpath("game_clips.json").read_text(encoding="utf-8")
    )
    texts = {
        text.format(hand=side, leg=side)
        for clips in table.values()
        for text in clips.values()
        for side in ("left", "right")
    }
    assert [text for text in texts if not enough(text)] == []


def test_all_clips_of_the_archive_are_watched_or_have_labels_with_rewordings():
    folder = Path(os.environ.get("BUNRAKU_DATA", "../shared/data"))
    if not (folder / "captions_watched.json").is_file():
        pytest.skip("the motion archive is absent; name its folder with BUNRAKU_DATA")
    watched = json.loads((folder / "captions_watched.json").read_text(encoding="utf-8"))["clips"]
    clips = json.loads((folder / "motions.json").read_text(encoding="utf-8"))["clips"]
    captions = {text for name, clip in clips.items() if name not in watched for text in clip["texts"]}
    short = [text for text in captions if not enough(text) and not text.startswith("a person ")]
    assert len(watched) > 1500 and len(captions) > 5 and short == []


def test_creatures_have_sentences_by_name_as_it_and_as_a_person():
    variants = creature_variants("horse", "gallop")
    said = {"a horse gallops", "it gallops", "gallops", "gallop", "galloping", "the creature gallops"}
    assert said | {"a person gallops", "a person runs"} <= set(variants)
    assert any(sentence.startswith(("the horse", "a horse is")) for sentence in variants)
    assert variants == creature_variants("horse", "gallop") and len(set(variants)) == len(variants)
    assert any(sentence.startswith("the character ") for sentence in variants)


@pytest.mark.parametrize(
    ("species", "action", "words"),
    [
        ("eagle", "fly", "flaps its wings"), ("snake", "walk", "slithers"), ("koi", "swim", "swims"), ("koi", "idle",
        "floats in place"),
        ("spider", "walk", "crawls"), ("bee", "fly", "buzzes around"), ("frog", "jump", "hops"), ("wolf", "attack",
        "bites"),
        ("cow", "eat", "grazes"),
    ],
)  # fmt: skip
def test_species_have_verbs_of_their_own(species, action, words):
    assert any(words in sentence for sentence in creature_variants(species, action))
    assert words in creature_clauses(species, action)


def test_names_articles_sides_and_unknown_words():
    assert (
        creature_names("husky") == ("husky", "dog")
        and creature_names("goldfish") == ("goldfish", "fish")
        and creature_names("gryphon") == ("gryphon",)
    )
    assert "an eagle flies" in creature_variants("eagle", "fly") and "a gryphon flies" in creature_variants(
        "gryphon", "fly"
    )
    assert creature_variants("horse", "Gallop_Jump") == creature_variants("horse", "running jump")
    assert "a gryphon juggles balls" in creature_variants("gryphon", "juggle balls")
    left, right = (creature_variants("horse", f"hit reaction {side}") for side in ("left", "right"))
    assert any("left side" in sentence for sentence in left) and any("right side" in sentence for sentence in right)
    assert creature_variants("horse", "hit reaction left", mirrored=True) == tuple(map(mirror_words, left))


def test_the_table_of_creature_clips_uses_actions_that_have_words():
    table = json.loads(
        resources.files("bunraku_lab.datasets.motions").joinpath("creature_clips.json").read_text(encoding="utf-8")
    )
    words = json.loads(
        resources.files("bunraku.language").joinpath("creature_captions.json").read_text(encoding="utf-8")
    )
    actions = {label["action"] for label in table["labels"].values()}
    assert {words["aliases"].get(action, action) for action in actions} <= set(words["actions"])
    assert set(words["aliases"].values()) <= set(words["actions"])
    for kind in words["kinds"]:
        assert set(kind["phrases"]) <= set(words["actions"])
