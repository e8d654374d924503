import pytest

from bunraku.errors import OptionError
from bunraku.language.prompts import check_prompt, parse_sequence, timed_sequence


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
