"""What is understood of sentences that people type, and what is said of the rest."""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bunraku.errors import OptionError, WeightsError
from bunraku.language.captions import conjugate, known_phrases
from bunraku.language.parse import parse
from bunraku.language.understood import check_understood, understood
from bunraku.language.vocabulary import corrected, own_words, slips, write_own_words

ROOT = Path(__file__).resolve().parents[2]
WATCHED = ROOT / "runs" / "data" / "source" / "captions_watched.json"

_PROMPT = r"(?:bunraku (?:animate|edit) \S+|bunraku\.(?:animate|edit)\([^\"\n]+,) \"([^\"]+)\""

KNOWN = (
    "somersault", "does a backflip", "sneaks past", "limps", "throws a ball overhand", "walks like a penguin",
    "sneaks up behind someone", "jumps for joy", "waves hello", "bows politely",
    "shadow boxing", "does ten push-ups", "climbs a ladder", "picks up a box and carries it to the left",
    "sits cross-legged", "rolls over", "dances salsa", "kneel and pray", "dodges a punch", "staggers as if drunk",
    "the dragon flaps its wings and roars", "spin around twice", "stretching before a run", "spins gracefully",
    "kicks a football", "hops on one foot", "shrugs", "golf swing", "falls asleep", "swing a baseball bat",
    "march in place", "crawls under a table", "zombie walk", "idle", "T-pose", "cartwheel", "make the robot dance",
    "run!", "hunch over", "clap", "turns left then right", "death", "a mushroom hops", "she ran, fell and got up again",
)  # fmt: skip
PARTLY = {
    "plays the trombone": ["trombone"],
    "strolls joyfully across the linoleum": ["linoleum"],
    "walks while juggling chainsaws": ["juggling", "chainsaws"],
    "gets up off the futon": ["futon"],
}
UNKNOWN = (
    "asdf qwer", "lorem ipsum dolor", "lorem ipsum dolor sit amet", "mies kävelee eteenpäin", "kissa hyppää",
    "человек идёт вперёд", "Собака бежит", "사람이 걷는다", "🙂🙂 x", "blorp the zarg", "xyzzy", "sdlkfj lskdjf lkj",
    "a snurfling grompus", "the quick fnord", "photosynthesis of chlorophyll", "den blå himlen", "γεια σου",
    "does a blorp", "東京都知事", "der Kanzler und die Steuer",
)  # fmt: skip


@pytest.mark.parametrize("sentence", KNOWN)
def test_everyday_sentences_are_understood(sentence):
    found = understood(sentence)
    assert found.ok and not found.unknown and not found.corrected and not found.notes and not found.nearest
    assert found.english == sentence.rstrip(".") and found.language == "en"


@pytest.mark.parametrize(("sentence", "words"), PARTLY.items())
def test_harmless_words_are_named_and_the_sentence_goes_on(sentence, words):
    found = understood(sentence)
    assert found.ok and [one.word for one in found.unknown] == words and len(found.nearest) == 3
    assert [sentence[one.start : one.stop] for one in found.unknown] == words
    assert found.notes == ("not understood: " + ", ".join(f"'{word}'" for word in words),)


@pytest.mark.parametrize("sentence", UNKNOWN)
def test_what_says_no_movement_is_refused_with_sentences_that_do(sentence):
    found = understood(sentence)
    assert not found.ok and len(found.nearest) == 3
    with pytest.raises(OptionError, match="no movement is understood") as refused:
        check_understood(sentence)
    said = str(refused.value)
    assert found.nearest[0] in said and "force" not in said and (found.unknown[0].word in said or sentence in said)
    assert check_understood(sentence, force=True) is found


def test_of_words_that_exist_something_is_guessed_and_said():
    assert not understood("hostage").ok and check_understood("hostage").unknown
    (clause,) = (sentence := parse("hostage")).clauses
    assert clause.actions and f"'{clause.actions[0]}' is a guess" in sentence.notes[-1]


@pytest.mark.parametrize(
    ("sentence", "english"),
    [
        ("wlaks forwrad", "walks forward"),
        ("the man jmups up and down", "the man jumps up and down"),
        ("a person wallks", "a person walks"),
        ("does a summersault", "does a somersault"),
        ("turns arround and walks backwrads", "turns around and walks backwards"),
        ("walks and juggling", "walks and juggling"),  # two slips from "jogging", but a short word
        ("walks in a barn", "walks in a barn"),  # a word, though no caption has it: no slip of "bars"
        ("rinse", "rinse"),
    ],
)
def test_typing_errors_are_corrected_and_said_and_words_are_left_alone(sentence, english):
    found = understood(sentence)
    assert found.english == english
    assert (f"read as: {english}" in found.notes) == (sentence != english) == bool(found.corrected)


def test_slips_are_counted_as_by_damerau():
    for one, other, count in (
        ("walk", "walk", 0), ("wlak", "walk", 1), ("wal", "walk", 1), ("walkk", "walk", 1), ("talk", "walk", 1),
        ("forwrad", "forward", 1), ("frwad", "forward", 2), ("run", "jump", 3), ("a", "abcdef", 3),
    ):  # fmt: skip
        assert slips(one, other) == slips(other, one) == count, (one, other)
    assert corrected("wak") == "" and corrected("Jmup") == "jump" and corrected("wallk") == "walk"


def test_nearest_sentences_are_near():
    near = understood("a person jumps over the blorp fnord").nearest
    assert any("jump" in sentence for sentence in near)
    assert any(re.search("box|punch|kick", sentence) for sentence in understood("kikboxxing zzz").nearest)
    for sentence in (*near, *understood("asdf").nearest):
        assert understood(sentence).ok


def test_other_languages_are_put_into_english_with_places_in_the_sentence():
    prompt = "Ein Kobold winkt mit der linken Hand"
    found = understood(prompt)
    assert found.ok and found.english == "a person waves with the left hand" and found.language == "de"
    (unknown,) = found.unknown
    assert prompt[unknown.start : unknown.stop] == unknown.word == "Kobold"
    assert found.notes == ("read as: a person waves with the left hand", "not understood: 'Kobold'")
    found = understood("danse, puis ouvre la porte")
    assert found.ok and found.english == "a person dances, then opens a door" and not found.unknown


def test_the_english_is_given_with_notes():
    found = check_understood("a person walks forward.")
    assert found.english == "a person walks forward" and not found.notes
    found = check_understood("salta dos veces")
    assert found.english == "a person jumps twice" and found.notes == ("read as: a person jumps twice",)
    found = check_understood("qqq zzz", force=True)
    assert found.english == "qqq zzz" and found.notes == ("not understood: 'qqq', 'zzz'",)


@pytest.mark.parametrize("sentence", ["", "  ", "...", "x" * 2000])
def test_what_is_no_sentence_is_refused_as_before(sentence):
    with pytest.raises(OptionError, match="prompt"):
        understood(sentence)


def test_words_are_listed_shortly():
    found = understood(" ".join(f"zq{letter}x" for letter in "abcdefghijkl"))
    assert found.notes[0].endswith("and 4 more") and found.notes[0].count("'") == 16


@pytest.mark.skipif(not WATCHED.is_file(), reason="the watched captions are not unpacked in runs/data/source")
def test_the_captions_of_training_are_understood():
    clips = json.loads(WATCHED.read_text(encoding="utf-8"))["clips"].values()
    sentences = {text for clip in clips for stretch in clip for text in stretch["texts"]}
    found = [understood(sentence) for sentence in sentences]
    assert sum(one.ok for one in found) >= 0.995 * len(found)
    assert all(one.language == "en" for one in found)
    assert sum(bool(one.corrected) for one in found) <= 0.001 * len(found)


def test_the_phrases_of_the_tables_are_understood():
    phrases = sorted({conjugate(one, form) for one in known_phrases() for form in ("third", "gerund", "plain")})[::4]
    assert sum(understood(phrase).ok for phrase in phrases) >= 0.999 * len(phrases)


def test_the_sentences_of_the_docs_are_understood():
    texts = [path.read_text(encoding="utf-8") for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))]
    texts += [path.read_text(encoding="utf-8") for path in sorted((ROOT / "examples").glob("*.py"))]
    prompts = {
        prompt
        for text in texts
        for prompt in re.findall(
            r"(?:bunraku (?:animate|edit) \S+|bunraku\.(?:animate|edit)\([^\"\n]+,) \"([^\"]+)\"", text
        )
    }
    assert len(prompts) >= 8
    for prompt in prompts:
        for part in prompt.split(";"):
            found = understood(part.rpartition(":")[0] or part)
            assert found.ok and (not found.unknown or found.language != "en"), prompt


def test_reading_a_sentence_is_fast_and_loads_no_network():
    script = (
        "import sys, time\n"
        "from bunraku.language.understood import understood\n"
        "assert not {'torch', 'numpy', 'scipy', 'transformers'} & set(sys.modules)\n"
        "first = time.process_time()\n"
        "understood('a person walks forward')\n"
        "print(time.process_time() - first)\n"
    )
    loaded = float(subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout)
    assert loaded < 0.5  # 0.05 s on an idle processor; the bound is for busy ones
    sentences = ["a person runs and claps", "Un chien court vite", "左手を振りながら歩く", "asdf qwer zxcv"]
    for sentence in sentences:
        understood(sentence)
    understood.cache_clear()
    began = time.process_time()
    for _ in range(10):
        for sentence in sentences:
            understood(sentence)
        understood.cache_clear()
    assert (time.process_time() - began) / 40 < 0.05  # under 5 ms


def test_words_of_clips_of_ones_own_are_understood(tmp_path):
    """In a process of its own, since words are read once."""
    write_own_words(tmp_path, ["Florps"])
    asked = "from bunraku.language.understood import understood as u; print([u(t).ok for t in %r], u('florps').unknown)"
    sentences = ["florps", "a person is florping", "zorps"]
    found = []
    for folders in (f"{tmp_path}{os.pathsep}", ""):
        run = [sys.executable, "-c", asked % sentences]
        done = subprocess.run(run, env={**os.environ, "BUNRAKU_WEIGHTS": folders}, capture_output=True, check=True)
        found.append(done.stdout.decode().split("]")[0])
    assert found == ["[True, True, False", "[False, False, False"]


@pytest.mark.parametrize("text", ['{"florps": 1}', "[1]", "[", "null"])
def test_a_list_that_is_none_is_refused(tmp_path, monkeypatch, text):
    (tmp_path / "own_words.json").write_text(text)
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path))
    with pytest.raises(WeightsError, match="not a list of words"):
        own_words.__wrapped__()
