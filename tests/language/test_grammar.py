import pytest

from bunraku.language.captions.grammar import conjugate, fill, is_stative, sentence_forms


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


def test_nobody_is_being_angry():
    assert is_stative("{be} angry") and not is_stative("{stand} and {be} quiet")
    assert not any("being" in sentence for sentence in sentence_forms("{be} angry"))
    assert "a person is angry" in sentence_forms("{be} angry")
