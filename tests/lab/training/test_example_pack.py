"""The pack of examples, and people who stand."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from bunraku.core.nn.checkpoints import load_checkpoint
from bunraku.generation.extractor import RADIUS, RANKER, ExtractorConfig, embed_motions
from bunraku.generation.features import body_handle_motion, encode, mirror
from bunraku.generation.pack import KIND, read_pack
from bunraku.gestures.catalogue import STANDING, gestures
from bunraku.gestures.play import gesture_motion
from bunraku.language.vocabulary import FILE
from bunraku_lab.datasets.motions.clips import write_pack
from bunraku_lab.nn.text import Extractor, embed_sentences, save_extractor
from bunraku_lab.training import example_pack
from bunraku_lab.training.example_pack import BUSY_BOUNDS, IDLE_BOUNDS, ExampleSettings, build_examples, idling

FEW = gestures()[:12]


@pytest.fixture(autouse=True)
def few_gestures(monkeypatch):
    """Of the hundreds of gestures made by code, those at the beginning of the table: each takes its time."""
    monkeypatch.setattr(example_pack, "gestures", lambda: FEW)


def a_ranker(path, seed):
    torch.manual_seed(seed)
    sizes = {"width": 16, "layers": 1, "heads": 2, "feedforward": 16, "embedding": 8, "text_size": 8, "pooled_size": 8}
    model = Extractor(ExtractorConfig(**sizes, text_encoder="words")).eval()
    return save_extractor(path, model, kind=RANKER)


@pytest.fixture
def ranker(tmp_path):
    return a_ranker(tmp_path / "ranker.safetensors", 3)


def watched(folder):
    """The folder's clips with a caption by time each; one stretch is faulty."""
    path = folder / "index.json"
    index = json.loads(path.read_text())
    for name, entry in index["clips"].items():
        verb = name.partition("_")[0]
        entry["stretches"] = [{"start": 0, "stop": 50, "texts": [f"a person {verb} with the left hand", verb]}]
        entry["licence"] = "CC0"
    index["clips"]["bows_0"]["stretches"][0]["fault"] = "says something else"
    path.write_text(json.dumps(index))


def test_training_clips_alone_are_packed_with_the_vectors_of_both_sides(swings, ranker, encoder, tmp_path):
    watched(swings)
    settings = ExampleSettings(swings, tmp_path / "examples.safetensors", ranker=ranker)
    pack = build_examples(settings, encoder)
    stretches = [one for one in pack.examples if "#" not in one.name and not one.made]
    assert [one.name for one in stretches] == ["kicks_0@0", "nods_0@0", "waves_0@0"]  # no fault, val or test
    assert {one.frames for one in stretches} == {50}
    assert stretches[2].texts == ("a person waves with the left hand", "waves")

    from bunraku.generation.extractor import load_extractor

    model = load_extractor(ranker, kind=RANKER)
    said = embed_sentences(model, encoder, ["a person waves with the left hand", "a person waves with the right hand"])
    index = pack.examples.index(stretches[2])
    row = int(np.flatnonzero(pack.owners == index)[0])
    np.testing.assert_allclose(pack.texts[0, row], said["a person waves with the left hand"] / RADIUS, atol=1e-6)
    np.testing.assert_allclose(pack.texts[1, row], said["a person waves with the right hand"] / RADIUS, atol=1e-6)
    wave = pack.features(index)
    both = embed_motions(model, [wave, mirror(wave)]) / RADIUS
    np.testing.assert_allclose(pack.motions[:, index], both, atol=0.05)  # but for what a skeleton cannot do
    np.testing.assert_allclose(read_pack(settings.out).motions, pack.motions, atol=5e-3)


def test_of_each_action_only_the_clearest_are_kept(swings, ranker, encoder, tmp_path):
    watched(swings)
    path = swings / "index.json"
    index = json.loads(path.read_text())
    for entry in index["clips"].values():
        entry["split"] = "train"
    path.write_text(json.dumps(index))
    pack = build_examples(ExampleSettings(swings, tmp_path / "some.safetensors", 2, 0, ranker=ranker), encoder)
    names = [one.name for one in pack.examples]
    assert len([name for name in names if name.startswith("waves")]) == 2
    own = {
        name: float(pack.texts[0, pack.owners == number].mean(axis=0) @ pack.motions[0, number])
        for number, name in enumerate(names)
    }
    every = build_examples(ExampleSettings(swings, tmp_path / "all.safetensors", 9, 0, ranker=ranker), encoder)
    left = [one.name for one in every.examples if one.name.startswith("waves") and one.name not in names]
    number = [one.name for one in every.examples].index(left[0])
    dropped = float(every.texts[0, every.owners == number].mean(axis=0) @ every.motions[0, number])
    assert dropped <= min(value for name, value in own.items() if name.startswith("waves")) + 1e-6


def test_gestures_made_by_code_are_packed_with_them(swings, ranker, encoder, tmp_path):
    watched(swings)
    path = tmp_path / "examples.safetensors"
    pack = build_examples(ExampleSettings(swings, path, ranker=ranker), encoder)
    made = [index for index, one in enumerate(pack.examples) if one.made]
    assert [pack.examples[index].texts for index in made] == [*(one.texts for one in FEW), ()]
    assert made[-1] in pack.standing
    clap = made[0]
    own = pack.texts[:, pack.owners == clap].mean(axis=1)
    own /= np.linalg.norm(own, axis=1, keepdims=True)
    np.testing.assert_allclose(pack.motions[:, clap], own, atol=1e-6)  # no ranker has seen it
    wanted = encode(body_handle_motion(gesture_motion(FEW[0])))
    np.testing.assert_allclose(pack.features(clap)[:, 3:], wanted[:, 3:], atol=0.006)
    _, config = load_checkpoint(path, KIND)
    assert config["notes"]["licences"]["Apache-2.0"] == len(FEW) + 1


def test_a_pack_gets_the_gestures_that_it_lacks(swings, ranker, encoder, tmp_path):
    watched(swings)
    whole = build_examples(ExampleSettings(swings, tmp_path / "whole.safetensors", ranker=ranker), encoder)
    lacks = [index for index, one in enumerate(whole.examples) if one.texts in {FEW[3].texts, FEW[9].texts}]
    kept = [index for index in range(len(whole.examples)) if index not in lacks]
    less = replace(
        whole, examples=tuple(whole.examples[index] for index in kept), data=tuple(whole.data[index] for index in kept),
        owners=np.array([kept.index(owner) for owner in whole.owners.tolist() if owner in kept], np.int32),
        texts=whole.texts[:, np.isin(whole.owners, kept)], motions=whole.motions[:, kept], readings=None,
    )  # fmt: skip
    notes = load_checkpoint(tmp_path / "whole.safetensors", KIND)[1]["notes"]
    licences = notes["licences"] | {"Apache-2.0": notes["licences"]["Apache-2.0"] - 2}
    write_pack(tmp_path / "less.safetensors", less, {"licences": licences, "frames": 0})
    more = ExampleSettings(out=tmp_path / "more.safetensors", ranker=ranker, add_to=tmp_path / "less.safetensors")
    build_examples(more, encoder)
    pack = read_pack(more.out)
    assert len(lacks) == 2 and [whole.examples[index] for index in kept + lacks] == list(pack.examples)
    assert [whole.data[index] for index in kept + lacks] == list(pack.data)
    np.testing.assert_allclose(pack.motions, whole.motions[:, kept + lacks], atol=5e-3)
    for other, index in enumerate(kept + lacks):
        mine, its = pack.texts[:, pack.owners == other], whole.texts[:, whole.owners == index]
        np.testing.assert_allclose(mine, its, atol=5e-3)
    assert load_checkpoint(more.out, KIND)[1]["notes"] == notes


def test_a_pack_gets_the_vectors_of_another_ranker(swings, ranker, encoder, tmp_path):
    """Those that a pack of the same clips has that was made with it."""
    watched(swings)
    other = a_ranker(tmp_path / "other.safetensors", 4)
    first = build_examples(ExampleSettings(swings, tmp_path / "first.safetensors", ranker=ranker), encoder)
    wanted = build_examples(ExampleSettings(swings, tmp_path / "wanted.safetensors", ranker=other), encoder)
    more = ExampleSettings(out=tmp_path / "more.safetensors", ranker=other, add_to=tmp_path / "first.safetensors")
    pack = build_examples(more, encoder)
    assert pack.examples == first.examples == wanted.examples and pack.ranker == wanted.ranker != first.ranker
    assert pack.data == first.data and pack.owners.tolist() == wanted.owners.tolist()
    np.testing.assert_allclose(pack.texts, wanted.texts, atol=5e-3)
    np.testing.assert_allclose(pack.motions, wanted.motions, atol=0.05)  # but for what a skeleton cannot do
    assert not np.allclose(pack.motions, first.motions, atol=0.05)


def test_words_that_only_ones_own_clips_say_are_written_beside_the_pack(swings, ranker, encoder, tmp_path):
    watched(swings)
    build_examples(ExampleSettings(swings, tmp_path / "base.safetensors", ranker=ranker), encoder)
    path = swings / "index.json"
    index = json.loads(path.read_text())
    shutil.copy(swings / "waves_0.npz", swings / "own_a.npz")
    entry = index["clips"]["waves_0"] | {"texts": ["a person florps slowly"]}
    entry["stretches"] = [{"start": 0, "stop": 50, "texts": entry["texts"]}]
    path.write_text(json.dumps(index | {"clips": {"own_a": entry}}))
    (tmp_path / "mine").mkdir()
    more = ExampleSettings(swings, tmp_path / "mine" / "examples.safetensors", ranker=ranker)
    pack = build_examples(replace(more, add_to=tmp_path / "base.safetensors"), encoder)
    assert pack.examples[-1].texts == ("a person florps slowly",)
    assert json.loads((tmp_path / "mine" / FILE).read_text()) == ["florps"]


def found(name, bounds):
    one = STANDING if name == "standing" else next(one for one in gestures() if one.name == name)
    clip = {"features": encode(body_handle_motion(gesture_motion(one)))}
    return [clip for clip, _ in idling({name: clip}, bounds)]


@pytest.mark.parametrize(
    ("name", "idle", "busy"),
    [("standing", True, False), ("clap", False, True), ("conduct", False, True), ("both knees", False, False)],
)
def test_each_is_what_it_is(name, idle, busy):
    assert found(name, IDLE_BOUNDS) == [name] * idle
    assert found(name, BUSY_BOUNDS) == [name] * busy
