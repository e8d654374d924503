"""Training of the reader: what is composed, kept and learned."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bunraku.errors import FormatError, OptionError
from bunraku.language.encoders import MiniLMEncoder
from bunraku.language.reader import FIELDS, dequantised, load_reader
from bunraku_lab.training import reader as training
from bunraku_lab.training.reader import ReaderTrainConfig
from bunraku_lab.training.reader_sentences import (
    UNKNOWN,
    Composed,
    Composer,
    dealings_of,
    grammar,
    phrases_of,
)

WATCHED = Composed([("a person walks on", -1)], [("walk", -1, dict.fromkeys(FIELDS, UNKNOWN))])
VERBS = {"walk": "walks", "jump": "jumps", "wave": "waves", "idle": "stands", "none": "blinks", "sidestep": "strafes"}


@pytest.fixture
def config(tmp_path: Path) -> ReaderTrainConfig:
    lines = [f"{action}\t{verb} {index}" for action, verb in VERBS.items() for index in range(60)]
    said = grammar()
    named = [action for row in (*said["templates"], *said["clips"]) for action, _ in row["says"]]
    more = {*named, *said["gaits"], *said["in posture"].values(), "climb", "ladder"} - {*VERBS}
    lines += [f"{action}\t{action}" for action in sorted(more) if action[0] != "$"]
    (tmp_path / "phrases.tsv").write_text("\n".join(lines), encoding="utf-8")
    labels = json.dumps([["deed pat", {"height": "0.6", "side": "left"}]])
    (tmp_path / "things.tsv").write_text("\n".join(f"{labels}\tpats dog {n}" for n in range(9)), encoding="utf-8")
    (tmp_path / "captions_watched.json").write_text(json.dumps({"clips": {}}), encoding="utf-8")
    (tmp_path / "captions_asked.tsv").write_text("", encoding="utf-8")
    return ReaderTrainConfig(
        phrases=(tmp_path / "phrases.tsv",), dealings=tmp_path / "things.tsv", data=tmp_path,
        out=tmp_path / "run", held_out=32, minutes=0, batch=8, validate_every=16, warmup=4, rate=4e-3, steps=48,
    )  # fmt: skip


def test_sentences_name_what_their_clauses_are_made_of(config: ReaderTrainConfig) -> None:
    phrases = phrases_of(config.phrases)
    composer = Composer(phrases, [WATCHED], 1)
    for sentence in (composer.sentence() for _ in range(500)):
        clauses = {clause for _, clause in sentence.pieces}
        assert sentence.text.strip()
        for action, clause, fields in sentence.said:
            assert action in phrases and clause in clauses
            assert all(-1 <= fields[name] <= len(values) for name, values in FIELDS.items())
    again = Composer(phrases, [WATCHED], 1)
    assert again.sentence().text == Composer(phrases, [WATCHED], 1).sentence().text


def test_a_row_says_no_more_than_its_text(config: ReaderTrainConfig) -> None:
    says = [["turn", {"turn side": "$side", "degrees": "$degrees"}]]
    row = {"forms": ["{codes.$side} turn"], "says": says, "vary": {"side": ["left"], "degrees": ["90"]}}
    text, ((action, fields),) = Composer(phrases_of(config.phrases), [], 1).filled(row)
    assert action == "turn" and text.removesuffix(" turn") in grammar()["codes"]["left"]
    assert FIELDS["turn side"][fields["turn side"] - 1] == "left" and FIELDS["degrees"][fields["degrees"] - 1] == "?"


def test_what_is_done_with_things_is_composed_beside_actions_that_may_go_with_it(config: ReaderTrainConfig) -> None:
    assert config.dealings is not None
    composer = Composer(phrases_of(config.phrases), [], 1, dealings_of(config.dealings))
    made = [sentence for sentence in (composer.sentence() for _ in range(200)) if "actions" in sentence.open]
    fields = next(fields for name, _, fields in made[0].said if name == "deed pat")
    assert FIELDS["height"][fields["height"] - 1] == "0.6" and fields["count"] == UNKNOWN and not fields["direction"]


def test_batches_have_what_the_encoder_reads() -> None:
    none = dict.fromkeys(FIELDS, 0)
    sentences = [
        Composed(
            [("he walks", 0), ("then", -1), ("waves twice", 1)], [("walk", 0, none), ("wave", 1, none | {"count": 2})]
        ),
        Composed([("blinks", 0)]),
    ]
    encoder = MiniLMEncoder()
    long, short = training.batches(sentences, ["walk", "wave"], encoder, 4)
    np.testing.assert_array_equal(long.x[0], encoder.embedded(encoder.numbers(sentences[0].text)))
    assert len(short.said) == 0
    count = 4 + list(FIELDS).index("count")
    assert [(int(row[1]), int(row[2]), int(row[3]), int(row[count])) for row in long.said] == [
        (0, 1, 3, 0), (1, 4, 6, 2),
    ]  # fmt: skip


def test_steps_are_as_near_as_they_can_be() -> None:
    matrix = np.random.default_rng(0).normal(size=(40, 7)).astype(np.float32)
    steps, scale = training.quantised(matrix)
    again = dequantised({"a": steps, "a.scale": scale})["a"]
    assert np.all(np.abs(again - matrix) <= 0.5001 * scale)


def test_a_run_learns_and_goes_on(config: ReaderTrainConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "POOL", 32)
    rows: list[dict[str, float]] = []
    path = training.train_reader(config, rows.append)
    assert [row["step"] for row in rows] == [16, 32, 48] and rows[-1]["validation"] < rows[0]["validation"]
    reader = load_reader(path)
    assert {"walk", "jump"} <= set(reader.actions) and "none" not in reader.actions
    assert reader.dealings == ("deed pat",)
    training.train_reader(ReaderTrainConfig(**{**vars(config), "steps": 49}), rows.append)
    assert rows[-1]["step"] == 49
    begun = ReaderTrainConfig(**{**vars(config), "out": config.out / "more", "steps": 1, "begin": path, "rate": 1e-7})
    training.train_reader(begun, rows.append)
    assert rows[-1]["validation"] == pytest.approx(rows[2]["validation"], rel=0.03)  # but for the steps of int8


def test_what_is_missing_is_said(config: ReaderTrainConfig, tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="absent.tsv"):
        phrases_of([tmp_path / "absent.tsv"])
    (tmp_path / "bare.tsv").write_text("blinks\n", encoding="utf-8")
    with pytest.raises(OptionError, match="phrase"):
        training.train_reader(ReaderTrainConfig(**{**vars(config), "phrases": (tmp_path / "bare.tsv",)}))
