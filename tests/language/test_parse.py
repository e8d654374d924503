"""Prompts as sentences: parsing, and scripts of several prompts."""

from __future__ import annotations

import numpy as np
import pytest

from bunraku.errors import OptionError
from bunraku.language.lexicon import lexicon, words_of
from bunraku.language.parse import clause_of, for_body, parse
from bunraku.language.prompts import check_prompt, parse_sequence, timed_sequence


def test_a_prompt_is_clauses_with_fields():
    sentence = parse("walks forward, then waves with the left hand", 6.0)
    walk, wave = sentence.clauses
    assert sentence.language == "en" and sentence.seconds == 6.0 and not sentence.notes
    assert (walk.text, walk.actions, walk.locomotion, walk.part) == (
        "a person walks forward",
        ("walk",),
        "walk",
        "legs",
    )
    assert walk.straight and walk.turn is None and wave.cues == {"left arm"} and wave.part == "arms"
    assert walk.seconds == wave.seconds == 3.0


@pytest.mark.parametrize(
    ("prompt", "text"),
    [
        ("Kick a ball", "a person kicks a ball"),
        ("slowly walk backwards", "a person slowly walks backwards"),
        ("run and clap", "a person runs and claps"),
        ("raise your left arm", "a person raises their left arm"),
        ("walking forward", "walking forward"),
        ("jumping jacks", "jumping jacks"),
        ("sit ups", "sit ups"),
        ("the dog walks", "the dog walks"),
    ],
)
def test_what_names_nobody_is_read_as_captions_say_it(prompt, text):
    (clause,) = parse(prompt).clauses
    assert clause.text == text


@pytest.mark.parametrize("whose", ["the", "her", "their", "your", "its"])
def test_whose_a_part_is_says_nothing_of_what_is_done(whose):
    assert parse(f"shake {whose} head").clauses[0].actions == ("shake head",)
    assert parse(f"raise {whose} right arm").clauses[0].actions == ("raise arm",)


def test_who_does_it_says_nothing_of_what_is_done():
    turn = clause_of("a left-handed guard turns right").turn
    assert turn is not None and turn.side == -1


@pytest.mark.parametrize("verb", ["walks", "limps", "sneaks", "hobbles", "trudges", "ambles"])
def test_a_snake_slithers_whatever_walk_is_said(verb):
    (clause,) = for_body(parse(f"a snake {verb} ahead"), "snake", as_people=False).clauses
    assert (clause.text, clause.moves) == ("a snake slithers ahead", "slither")


def test_a_snake_that_dashes_slithers_fast_and_it_is_said():
    sentence = for_body(parse("dashes away"), "snake", as_people=False)
    assert [clause.text for clause in sentence.clauses] == ["it slithers fast away"]
    assert "it slithers instead" in sentence.cannot[0]


@pytest.mark.parametrize(
    ("sentence", "voices"),
    [
        ("limps while clapping", ["limps", "clapping"]),
        ("a man trudges along while waving", ["a man trudges along", "a man is waving"]),
        ("dashes off and waves", ["dashes off", "waves"]),
    ],
)
def test_any_way_of_walking_goes_together_with_a_gesture(sentence, voices):
    assert [voice.text for voice in clause_of(sentence).voices] == voices


@pytest.mark.parametrize("verb", ["walks", "limps", "hobbles", "trudges", "dashes"])
def test_any_way_of_walking_stops_for_a_salute(verb):
    assert len(parse(f"{verb} forward and salutes").clauses) == 2


@pytest.mark.parametrize("sentence", ["trudges on", "limps straight ahead", "a dog trots along"])
def test_who_goes_on_goes_straight_in_any_way(sentence):
    assert clause_of(sentence).straight


def test_a_strafe_is_a_sidestep():
    (clause,) = parse("strafes left").clauses
    assert clause.text == "a person sidesteps to the left" and clause.actions == ("sidestep",)
    assert "left go" in clause.cues and {"goes", "aside"} <= clause.traits


@pytest.mark.parametrize("prompt", ["does not walk", "doesn't walk", "a person isn't really walking", "never jumps"])
def test_what_is_not_done_is_beyond_it(prompt):
    with pytest.raises(OptionError, match="what is not done"):
        parse(prompt)
    assert parse(prompt, force=True).clauses


def test_what_else_is_not_done_is_told():
    (note,) = parse("walks but does not wave").notes
    assert "does not wave" in note and "what is done instead" in note


def test_the_words_of_animators_are_understood():
    death, cycle = parse("death animation"), parse("walk cycle")
    assert death.clauses[0].actions == ("fall",) and not death.unknown and not death.loop
    assert cycle.clauses[0].actions == ("walk",) and cycle.loop and "--loop" in cycle.notes[0]


def test_full_width_letters_are_plain_ones():
    wide, plain = parse("ｗａｌｋｓ　ｆｏｒｗａｒｄ：４；ｊｕｍｐｓ"), parse("walks forward:4; jumps")
    assert wide.clauses == plain.clauses and not wide.unknown


@pytest.mark.parametrize("seconds", ["nan", "inf", "-1", "NaN", "-inf"])
def test_a_length_that_is_no_length_is_refused(seconds):
    with pytest.raises(OptionError, match="'walks' cannot last"):
        parse(f"walks:{seconds}")


def test_an_action_is_one_row_of_the_lexicon():
    """What `lexicon.tables` says of a new one, shown with "cower"."""
    (clause,) = parse("a person is cowering").clauses
    assert clause.actions == ("cower",)
    assert [one.text for one in parse("runs forward and cowers").clauses] == [
        "a person runs forward",
        "a person cowers",
    ]


def test_the_lexicon_is_whole():
    table = lexicon()
    for forms in table.verbs.values():
        assert len(forms) >= 2 and all(form.isalpha() for form in forms)
    for name, row in table.actions.items():
        assert (row.said or row.like) and {*row.covers, row.like} <= {*table.actions, ""}, name
        assert row.part in ("", "legs", "arms", "head", "arms and head")
        assert row.locomotion in ("", "fly", "swim", "slither", "crawl", "walk", "run")
    for said in table.synonyms:
        assert not any(letter.isupper() for letter in said)


def test_words_are_parted_by_hyphens_and_apostrophes_and_punctuation_stands_alone():
    assert words_of("Push-ups, don't!")[0] == ["push", "ups", ",", "don", "t", "!"]
    assert words_of("a  dog")[1] == [(0, 1), (3, 6)]


def test_a_quoted_sentence_is_read_as_the_same_without_quotes():
    assert parse('"a man kicks with his right foot.",').clauses == parse("a man kicks with his right foot").clauses


def test_who_spins_or_goes_in_a_circle_turns_all_the_way_round_to_either_side():
    for text in ("a person does a spin", "a person is running in a circle", "a dancer twirls"):
        turn = clause_of(text).turn
        assert turn is not None and turn.side == 0 and turn.least > np.radians(180) and turn.most > np.radians(700)
    for text in ("makes circles with the arms", "walks forward", "looks around", "2H Melee Attack Spin"):
        assert clause_of(text).turn is None


@pytest.mark.parametrize(
    ("prompt", "side"),
    [("look right", "right"), ("looks to her left", "left"), ("turns the head to the right", "right")],
)
def test_who_looks_to_a_side_does_not_turn_to_it(prompt, side):
    (clause,) = parse(prompt).clauses
    assert clause.actions == ("look aside",) and clause.part == "head" and clause.turn is None
    assert clause.cues == {f"{side} go"}
    assert parse("looks left and right").clauses[0].actions == ("look around",)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("walks", [("walks", None)]),
        ("walks:4; jumps:2; waves:3", [("walks", 4), ("jumps", 2), ("waves", 3)]),
        ("walks : 4 s ;jumps;", [("walks", 4), ("jumps", None)]),
        ("a person says: hello", [("a person says: hello", None)]),
        ("he shouts: stop:1.5; runs:.5", [("he shouts: stop", 1.5), ("runs", 0.5)]),
        ("", [("", None)]),
    ],
)
def test_prompts_and_seconds(text, parts):
    assert parse_sequence(text) == parts


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("walks;;jumps", "part 2 .* no prompt"),
        (":4", "part 1 .* no prompt"),
        ("walks:0", "'walks' cannot last 0 seconds"),
        ("walks:nan", "'walks' cannot last nan seconds"),
        ("walks:inf", "cannot last inf"),
        ("walks:-3", "cannot last -3"),
        ("walks:1e9", "cannot last 1e"),
        ("walks:20000; runs:20000", "40000 seconds in all"),
    ],
)
def test_what_cannot_be_is_refused(text, said):
    with pytest.raises(OptionError, match=said):
        parse_sequence(text)


def test_parts_without_seconds_share_what_there_is():
    assert timed_sequence(parse_sequence("a; b:4; c"), 6.0) == [("a", 3.0), ("b", 4.0), ("c", 3.0)]
    assert timed_sequence(parse_sequence("a:119"), 6.0) == [("a", 119.0)]
    with pytest.raises(OptionError, match="cannot share 1 second"):
        timed_sequence(parse_sequence("a; b; c"), 1.0)
    with pytest.raises(OptionError, match="36001 seconds in all"):
        timed_sequence(parse_sequence("a; b:35995"), 6.0)
    for seconds in (0.1, 36001.0, float("nan")):
        with pytest.raises(OptionError, match=r"0.5 to 36000"):
            timed_sequence([("a", None)], seconds)


@pytest.mark.parametrize(
    ("copied", "said"),
    [
        ('"a person waves.",', "a person waves"),
        (': "A person waves', "A person waves"),
        ("“a person waves,”", "a person waves"),
        ("- a person waves; ", "a person waves"),
        ("'a man's dog runs'", "a man's dog runs'"),
        ("run!", "run!"),
        ("a person says 'hi' and waves", "a person says 'hi' and waves"),
    ],
)
def test_signs_around_a_sentence_are_none_of_it(copied, said):
    assert check_prompt(copied) == said


@pytest.mark.parametrize(
    ("text", "action"),
    [("turns around and marches back", "march"), ("walks, then turns around, then jogs back to the door", "run")],
)
def test_a_way_back_after_a_turn_is_a_way_forward(text: str, action: str) -> None:
    sentence = parse(text)
    last = (sentence.clauses[-1].parts or sentence.clauses)[-1]
    assert last.actions == (action,) and "forward" in last.cues and "backwards" not in last.cues
    assert sentence.notes == ()
    (away,) = parse("marches back").clauses
    assert "backwards" in away.cues


@pytest.mark.parametrize(
    ("name", "action", "cue"),
    [
        ("Wave_L", "wave", "left arm"), ("StrafeR_Loop", "sidestep", "right go"),
        ("UE4_Jog_Bwd_Left_45", "backward", "left go"), ("CrouchWalkFwd", "crouch walk", "forward"),
        ("Kick_R", "kick", "right leg"), ("Uppercut_L", "punch", "left arm"),
        ("knee strike left", "knee lift", "left leg"),
    ],
)  # fmt: skip
def test_names_of_clips_say_sides_and_ways_by_letters(name: str, action: str, cue: str) -> None:
    sentence = parse(name)
    (clause,) = sentence.clauses
    assert clause.actions == (action,) and cue in clause.cues and clause.count is None
    assert not any("'R'" in note or "'L'" in note for note in sentence.notes)


@pytest.mark.parametrize(
    ("prompt", "hand"),
    [
        ("she walks while holding a cup in her right hand", "right"),
        ("carries a bucket in the left hand", "left"),
        ("a man is carrying a torch in his right hand", "right"),
    ],
)
def test_who_carries_something_in_a_hand_walks(prompt, hand):
    (clause,) = parse(prompt).clauses
    legs, arm = clause.voices
    assert legs.actions == ("walk",) and legs.detail is None and arm.part == "arms" and arm.detail.hands == hand
    assert not parse("a person carries a box").clauses[0].voices  # as captured people do
