import pytest

from bunraku.language.actions import ACTIONS, CYCLIC, actions_of, main_actions


@pytest.mark.parametrize(
    ("sentence", "actions"),
    [
        ("someone strolls off, then sits down", ("walk", "sit")),
        ("a person does several jumping jacks", ("jumping jack",)),
        ("walk and turn right", ("walk", "turn")),
        ("turn around and walk", ("turn around", "walk")),
        ("a person waves with the left hand", ("wave",)),
        ("standing long jump", ("long jump",)),
        ("kick left", ("kick",)),
        ("walk in a circle left", ("walk", "circle")),
        ("do a cartwheel to the right", ("cartwheel",)),
        ("asdf qwer", ()),
    ],
)
def test_sentences_say_their_actions_in_order(sentence, actions):
    assert actions_of(sentence) == actions


def test_the_tersest_sentence_that_says_anything_decides():
    assert main_actions(["a person runs and then jumps", "jump over something", "hurdle"]) == ("jump",)
    assert main_actions(["nothing known"]) == ("other",)
    assert set(ACTIONS) >= CYCLIC


@pytest.mark.parametrize(
    ("sentence", "action"),
    [("bow", "bow"), ("a person bows politely", "bow"), ("polite bow with joined hands", "bow"), ("draw bow", "shoot"),
     ("aiming with a drawn bow", "shoot"), ("draws a bow", "shoot"), ("shoots an arrow", "shoot")],
)  # fmt: skip
def test_to_bow_is_told_from_an_archers_bow(sentence, action):
    assert actions_of(sentence) == (action,)
