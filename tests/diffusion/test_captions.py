import pytest

from bunraku.diffusion.captions import caption, caption_group, caption_variants, mirror_words, normalise_label


@pytest.mark.parametrize(
    ("sentence", "mirrored"),
    [
        ("kicks with the left foot", "kicks with the right foot"),
        ("Right hand up, left hand down", "Left hand up, right hand down"),
        ("turns clockwise", "turns counterclockwise"),
        ("steps leftwards and rightward", "steps rightwards and leftward"),
        ("stands upright on bright leftovers", "stands upright on bright leftovers"),
    ],
)
def test_left_and_right_change_places_both_ways(sentence, mirrored):
    assert mirror_words(sentence) == mirrored and mirror_words(mirrored) == sentence


def test_labels_are_cleaned_and_grouped_by_meaning():
    assert normalise_label("  Walk_Forward. ") == "walk forward"
    assert caption_group("A person kicks.") is caption_group("kick") is caption_group("front kick")
    assert caption_group("kick") is not caption_group("walk")
    unknown = caption_group("Juggles seven swords")
    assert unknown.name == "juggles seven swords" and unknown.phrases == () and unknown.weight == 1


@pytest.mark.parametrize(
    "label", ["walk", "run/jog", "Kick", "jump up to grab, reach for, tiptoe", "a person does a squat", "A human dances.", "Juggles seven swords"]
)
def test_every_label_has_sentences(label):
    variants = caption_variants(label)
    assert variants and len(set(variants)) == len(variants)
    assert not any(letter in sentence for sentence in variants for letter in "{}_") and all(
        sentence == " ".join(sentence.split()) for sentence in variants
    )
    assert caption(label, 5) == caption(label, 5) in variants
    assert [mirror_words(sentence) for sentence in caption_variants(label, mirrored=True)] == list(variants)


def test_grammar():
    variants = caption_variants("kick")
    for sentence in ("a person kicks", "someone is kicking forward", "the character kicks something in front", "kick", "kicking"):
        assert sentence in variants
    assert any("running" in sentence for sentence in caption_variants("run")) and not any(
        "runing" in sentence for sentence in caption_variants("run")
    )


def test_all_shipped_phrases_make_sentences():
    import json
    from importlib import resources

    groups = json.loads(resources.files("bunraku.diffusion").joinpath("captions.json").read_text(encoding="utf-8"))["groups"]
    labels = [label for group in groups for label in group["labels"]]
    assert len(set(labels)) == len(labels) and all(label == normalise_label(label) for label in labels)
    for group in groups:
        for sentence in caption_variants(group["labels"][0]):
            assert "{" not in sentence and "  " not in sentence and sentence == sentence.strip()
