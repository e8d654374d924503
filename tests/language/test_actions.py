import pytest

from bunraku.language.lexicon.reading import actions_of, goes_ahead, is_cyclic, main_actions
from bunraku.language.lexicon.tables import lexicon


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
        ("walk in a circle left", ("circle",)),
        ("do a cartwheel to the right", ("cartwheel",)),
        ("asdf qwer", ()),
    ],
)
def test_sentences_say_their_actions_in_order(sentence, actions):
    assert actions_of(sentence) == actions


def test_the_tersest_sentence_that_says_anything_decides():
    assert main_actions(["a person runs and then jumps", "jump up high", "hurrah"]) == ("jump",)
    assert main_actions(["nothing known"]) == ("other",)
    rows = lexicon().actions
    assert is_cyclic("walk") and not is_cyclic("jump over") and not is_cyclic("other")
    assert {covered for row in rows.values() for covered in row.covers} <= set(rows)


@pytest.mark.parametrize(
    ("sentence", "action"),
    [("bow", "bow"), ("a person bows politely", "bow"), ("polite bow with joined hands", "bow"), ("draw bow", "shoot"),
     ("aiming with a drawn bow", "shoot"), ("draws a bow", "shoot"), ("shoots an arrow", "shoot")],
)  # fmt: skip
def test_to_bow_is_told_from_an_archers_bow(sentence, action):
    assert actions_of(sentence) == (action,)


@pytest.mark.parametrize(
    ("sentence", "actions"),
    [
        ("marches on the spot", ("march in place",)), ("a soldier marches", ("march",)),
        ("he jogs in place", ("run in place",)), ("does crunches", ("sit-up",)), ("does press-ups", ("push-up",)),
        ("a person throws punches like a boxer", ("box",)), ("shadow boxes", ("box",)), ("throws a punch", ("punch",)),
        ("picks up a box", ("pick up",)), ("plays tennis", ("tennis",)), ("plays table tennis", ("racket",)),
        ("serves a tennis ball", ("serve",)), ("pitches a baseball", ("pitch",)), ("swings a bat", ("bat",)),
        ("bounces a basketball", ("dribble",)), ("jumps over a fence", ("jump over",)), ("hurdles", ("jump over",)),
        ("trips over a stone", ("stumble",)), ("trips and falls", ("fall",)),
        ("climbs a ladder", ("ladder",)), ("climbs down a ladder", ("climb",)),
        ("walks like a zombie, arms stretched out", ("zombie",)), ("walks like a robot", ("imitate",)),
        ("swims front crawl", ("swim",)), ("swims breaststroke", ("breaststroke",)),
        ("waves goodbye with both hands", ("wave both",)),
    ],
)  # fmt: skip
def test_sports_and_steps_are_told_from_what_they_are_a_kind_of(sentence, actions):
    assert actions_of(sentence) == actions


@pytest.mark.parametrize(
    ("text", "action"),
    [("a person rushes to the door", "run"), ("she hurries away", "run"), ("he comes to the window", "walk")],
)
def test_who_comes_or_hurries_goes_somewhere(text, action):
    assert actions_of(text) == (action,) and goes_ahead(actions_of(text))
