"""Word pieces, by hand and beside the package that the published model comes with."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bunraku.language.encoders import TEXT_LENGTH
from bunraku.language.known.tokenizer import WordPieces, encoder_file, read_header

TEXT = read_header(encoder_file())["tokenizer"]
MINE = WordPieces(TEXT)
RANGES = ((0x01, 0x52F), (0x1E00, 0x1FFF), (0x2000, 0x206F), (0x3040, 0x30FF), (0x4E00, 0x9FA5), (0xFF00, 0xFF60))
"""Letters of Europe and of East Asia, and signs; the package has the other scripts as they were some years ago."""


@pytest.fixture(scope="module")
def published():
    tokenizers = pytest.importorskip("tokenizers", reason="tokenizers is not installed; make develop brings it")
    found = tokenizers.Tokenizer.from_str(TEXT)
    found.enable_truncation(TEXT_LENGTH)
    return lambda sentence: found.encode(sentence).ids


def test_by_hand():
    pieces = {number: piece for piece, number in MINE._pieces.items()}

    def said(text, most=TEXT_LENGTH):
        return " ".join(pieces[number] for number in MINE.numbers(text, most)[1:-1])

    assert said("A Café, naïvely!") == "a cafe , naive ##ly !"
    assert said("走る 2x 人山") == "[UNK] [UNK] 2 ##x [UNK] [UNK]"  # of each letter one
    assert said("a b c d e", 5) == "a b c"
    assert said("x" * 101 + " walks") == "[UNK] walks"
    assert said("") == "" and MINE.numbers("", 30) == MINE.numbers(" \t\n\u200b", 30)


def test_another_tokenizer_is_refused():
    with pytest.raises(ValueError, match="another"):
        WordPieces('{"model": {"type": "BPE"}, "normalizer": {"type": "BertNormalizer", "lowercase": true}}')


@pytest.mark.parametrize("low, high", RANGES)
def test_each_letter_is_read_as_the_published_tokenizer_reads_it(published, low, high):
    wrong = [code for code in range(low, high + 1) if MINE.numbers(f"a{chr(code)}b", 30) != published(f"a{chr(code)}b")]
    assert [hex(code) for code in wrong] == []


@given(st.text(st.one_of([st.characters(min_codepoint=low, max_codepoint=high) for low, high in RANGES]), max_size=80))
def test_sentences_are_read_as_the_published_tokenizer_reads_them(published, text):
    assert MINE.numbers(text, TEXT_LENGTH) == published(text)


@pytest.mark.parametrize(
    "text", ["a [MASK] b[CLS]", "[UNK]walks [PAD]", "[mask]", "don't  stop-now... 3.5m", "#tag ##ing"]
)
def test_marks_and_signs(published, text):
    assert MINE.numbers(text, TEXT_LENGTH) == published(text)
