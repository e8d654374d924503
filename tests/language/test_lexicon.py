"""The lexicon: actions, cues, synonyms, things, ways of moving, parts of the body."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.language.captions import mirror_words
from bunraku.language.clauses import as_parsed, as_present, parts_of, subject_of
from bunraku.language.encoders import CUES, CuedEncoder, sentence_cues
from bunraku.language.lexicon import (
    actions_of,
    goes_ahead,
    in_known_words,
    is_cyclic,
    lexicon,
    main_actions,
    said_cues,
    said_otherwise,
)
from bunraku.language.parse import clause_of, for_body, parse
from bunraku.language.understood import understood


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


@pytest.mark.parametrize(
    ("sentence", "expected"),
    [
        ("a person punches with the left hand", {"left arm"}),
        ("a person throws a right hook", {"right arm"}),
        ("someone waves with their left", {"left arm"}),
        ("a person kicks high with the right leg", {"right leg", "high"}),
        ("a person kicks with the left", {"left leg"}),
        ("a person turns to the left", {"left turn"}),
        ("a person makes a half turn to the right", {"right turn", "half"}),
        ("a person steps to the right twice", {"right go", "twice"}),
        ("a person walks slowly backwards", {"backwards", "slow"}),
        ("a person walks counterclockwise in a circle", {"left turn", "full"}),
        ("a person raises the left arm, then kicks with the right foot", {"left arm", "right leg", "then"}),
        ("a person raises both arms", {"both arms"}),
        ("a person stands up", {"gets up"}),
        ("a person claps", set()),
    ],
)
def test_what_is_said(sentence, expected):
    assert said_cues(sentence) == expected


def test_a_mirrored_sentence_has_mirrored_cues():
    """Over the sentences of all rules above and some long ones."""
    swapped = [
        CUES.index(cue.translate(str.maketrans({})).replace("left", "#").replace("right", "left").replace("#", "right"))
        for cue in CUES
    ]
    for sentence in (
        "a person steps left, turns right around once and punches with the left fist",
        "clockwise circles, then a left roundhouse kick", "he leans to his right and reaches up with the left hand",
    ):  # fmt: skip
        np.testing.assert_array_equal(sentence_cues(mirror_words(sentence)), sentence_cues(sentence)[swapped])


def test_cues_stand_behind_the_vector_of_another_encoder(encoder):
    sentences = ["a person turns left twice", "a person waves"]
    plain, cued = encoder.encode(sentences), CuedEncoder(encoder).encode(sentences)
    assert np.array_equal(cued.tokens, plain.tokens) and np.array_equal(cued.pooled[:, :8], plain.pooled)
    said = cued.pooled[:, 8:] * 8**0.5
    assert said.shape[1] == len(CUES) and not said[1].any()
    assert [CUES[index] for index in np.flatnonzero(said[0])] == ["left turn", "twice"]


@pytest.mark.parametrize(
    ("said", "known"),
    [
        ("a person twirls around", "a person spins around"),
        ("someone is twirling to the left", "someone is spinning to the left"),
        ("a boy tiptoes away", "a boy sneaks away"),
        ("she walks on her tiptoes", "she sneaks"),
        ("a girl bounces a ball", "a girl dribbles a basketball"),
        ("she flings a stone, then collapses", "she throws a stone, then falls down"),
        ("she flings her arms up", "she flings her arms up"),
        ("a woman saunters ahead at a leisurely pace", "a woman strolls ahead slowly"),
        ("he lowers himself onto a chair", "he sits down on a chair"),
        ("a boy sneaks a look over his shoulder", "a boy looks over his shoulder"),
        ("she whirls around to face him", "she turns around to face him"),
        ("somebody gets down on all fours and crawls", "somebody crawls on all fours"),
        ("he makes a quarter turn to the left", "he turns left"),
        ("a boy is doing a 90-degree turn to his right", "a boy is turning right"),
        ("she makes a half turn", "she turns around"),
        ("a woman climbs a flight of stairs", "a woman climbs stairs"),
        ("somebody trips and nearly falls", "somebody stumbles"),
        ("a child is balancing on the left leg", "a child is standing on the left leg"),
        ("a dog bounces", "a dog bounces"),
        ("a person walks", "a person walks"),
    ],
)
def test_rare_words_become_those_of_the_captions_in_the_same_form(said, known):
    assert in_known_words(said) == known


def test_unknown_words_beside_them_keep_their_places():
    found = understood("a person pirouettes and snoofles")
    assert found.english == "a person spins and snoofles"
    assert [(word.word, word.start, word.stop) for word in found.unknown] == [("snoofles", 24, 32)]


@pytest.mark.parametrize(
    ("clause", "way"),
    [
        ("a bird flies away", "fly"),
        ("it is hovering", "fly"),
        ("a fish swims around", "swim"),
        ("slithers to the left", "slither"),
        ("a spider is crawling", "crawl"),
        ("walks forward", "walk"),
        ("a dog runs, flying over the grass", "run"),
        ("jumps", ""),
        ("waves", ""),
    ],
)
def test_the_first_verb_of_moving_counts(clause, way):
    assert clause_of(clause).locomotion == way


@pytest.mark.parametrize(
    ("clause", "verb", "said"),
    [
        ("a dog crawls ahead", "walks", "a dog walks ahead"),
        ("runs", "slithers fast", "slithers fast"),
        ("a snake is walking to the left", "slithers", "a snake slithers to the left"),
        ("waves", "walks", "waves"),
    ],
)
def test_verbs_are_replaced_where_they_stand(clause, verb, said):
    subject, predicate = subject_of(clause)
    assert " ".join([subject, said_otherwise(predicate, verb)]).strip() == said


@pytest.mark.parametrize(
    ("clause", "way"),
    [
        ("walks forward", "step"),
        ("a spider is crawling", "step"),
        ("a horse gallops", "run"),
        ("runs and jumps", "stay"),
        ("attacks", "stay"),
        ("stands still", "stay"),
        ("a hair flies", ""),
        ("climbs a ladder", ""),
        ("walks up the stairs", ""),
        ("does a handstand", ""),
        ("skips", "stay"),
        ("sits down on a chair", ""),
    ],
)
def test_how_long_somebody_is_in_the_air_is_told_by_what_is_said(clause, way):
    (done,) = for_body(parse(clause, force=True), "person").clauses
    assert done.moves == way


@pytest.mark.parametrize(
    ("sentence", "parts"),
    [
        ("a boy throws a ball and stretches", ["a boy throws a ball", "a boy stretches"]),
        ("a boy throwing a ball and stretching out", ["a boy is throwing a ball", "a boy is stretching out"]),
        ("a man steps forward and does a handstand", ["a man steps forward", "a man does a handstand"]),
        ("a man walked ahead and bowed deeply", ["a man walks ahead", "a man bows deeply"]),
        ("a man drinks while reading", []),
        ("a man walks left and right", []),
        ("a man kicks and kicks again", []),
        ("a man walks, looking down", []),
    ],
)
def test_what_nobody_does_at_once_has_parts(sentence, parts):
    assert parts_of(sentence) == parts


def test_parts_share_the_time_of_their_clause_however_long_it_is():
    (clause,) = parse("a person throws a ball and stretches", 6).clauses
    assert sum(part.seconds for part in clause.parts) == pytest.approx(6)
    assert sum(part.seconds for part in clause.lasting(3).parts) == pytest.approx(3)
    assert not parse("a person throws a ball and stretches", 1.5).clauses[0].parts


@pytest.mark.parametrize(
    ("sentence", "told"),
    [
        ("an old guard in a long coat, walking and looking around", "a person is walking and looking around"),
        ("a person walking forward picks a ball up", "a person is walking forward and picks a ball up"),
        ("a person walks forward, looking down", "a person walks forward, looking down"),
        ("a person is doing jumping jacks", "a person is doing jumping jacks"),
    ],
)
def test_participles_tell_what_is_done(sentence, told):
    assert as_parsed(sentence) == told


def test_the_past_is_told_as_captions_tell_it():
    assert as_present("the man walked forward") == "the man walks forward"
    assert as_present("a person holds a raised arm") == "a person holds a raised arm"
    texts = [clause.text for clause in parse("the man walked forward, spun around and walked away").clauses]
    assert texts == ["the man walks forward", "the man spins around", "the man walks away"]


@pytest.mark.parametrize(
    ("sentence", "read"),
    [
        ("a person is pushed but did not fall", "a person is pushed"),
        ("a person squats, not standing up", "a person squats"),
        ("a person walks but does not wave and sits down", "a person walks and sits down"),
    ],
)
def test_what_is_not_done_is_not_read(sentence, read):
    found = parse(sentence)
    assert found.english == read and any("is not done" in note for note in found.notes)


def test_arms_do_what_the_verb_says_and_not_whose_they_are():
    assert parse("a chef cuts vegetables").clauses[0].actions == ("cut food",)
    assert parse("a zombie walks").clauses[0].actions == ("zombie",)
