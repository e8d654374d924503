"""Phrases of captions: the forms of their verbs, and their mirror image."""

import pytest

from bunraku.language.captions import conjugate, mirror_words


@pytest.mark.parametrize(
    ("verb", "third", "gerund"),
    [
        ("walk", "walks", "walking"), ("run", "runs", "running"), ("wave", "waves", "waving"), ("carry", "carries",
        "carrying"),
        ("do", "does", "doing"), ("go", "goes", "going"), ("lie", "lies", "lying"), ("be", "is", "being"), ("push",
        "pushes", "pushing"),
        ("box", "boxes", "boxing"), ("play", "plays", "playing"), ("flee", "flees", "fleeing"), ("clap", "claps",
        "clapping"),
        ("begin", "begins", "beginning"), ("have", "has", "having"), ("tiptoe", "tiptoes", "tiptoeing"), ("sidestep",
        "sidesteps", "sidestepping"),
    ],
)  # fmt: skip
def test_verbs(verb, third, gerund):
    assert [conjugate(f"{{{verb}}}", form) for form in ("plain", "third", "gerund")] == [verb, third, gerund]


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
