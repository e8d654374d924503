import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from swings import PARTS, WordEncoder, swing

from bunraku.cli import main
from bunraku.core.nn.checkpoints import load_checkpoint, save_checkpoint
from bunraku.errors import OptionError
from bunraku.generation import networks
from bunraku.generation.denoiser import DenoiserConfig, fingerprint
from bunraku.generation.extractor import ExtractorConfig
from bunraku_lab.datasets.motions.clips import write_clip, write_index
from bunraku_lab.evaluation.motion import samples as motion_samples
from bunraku_lab.evaluation.motion.samples import Request, SamplerSettings, Window, make_motions
from bunraku_lab.evaluation.motion.table import MotionEvalConfig, Row, evaluate_motion, measure_rows
from bunraku_lab.evaluation.motion.viewer_prompts import VIEWER_BARS
from bunraku_lab.evaluation.report import KeptParts
from bunraku_lab.evaluation.tables.tapmo import DistortionConfig, measure_handles
from bunraku_lab.nn.denoiser import Denoiser, save_denoiser
from bunraku_lab.nn.text import Extractor, save_extractor


def network(**changes):
    sizes = {
        "width": 16, "layers": 1, "heads": 2, "feedforward": 32, "frames": 60, "mesh_features": 448, "text_size": 8,
        "pooled_size": 8,
    }  # fmt: skip
    return DenoiserConfig(**{**sizes, "text_encoder": "words", **changes})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Held-out clips, a denoiser and an extractor, with random weights."""
    home = tmp_path_factory.mktemp("evaluation")
    (home / "motions").mkdir()
    index = {}
    for part, verb in PARTS.items():
        for number, split in enumerate(("train", "test", "test")):
            write_clip(home / "motions" / f"{verb}{number}.npz", swing(part, 60, 0.8 + 0.1 * number))
            index[f"{verb}{number}"] = {"texts": [f"the figure {verb}"], "split": split, "frames": 60}
    write_index(home / "motions", index)
    torch.manual_seed(0)
    save_denoiser(home / "tapmo.safetensors", Denoiser(network()), {"steps": 1})
    sizes = {
        "width": 16, "layers": 1, "heads": 2, "feedforward": 32, "embedding": 4, "text_size": 8, "pooled_size": 8,
        "text_encoder": "words",
    }  # fmt: skip
    save_extractor(home / "extractor.safetensors", Extractor(ExtractorConfig(**sizes)))
    return home


@pytest.fixture(autouse=True)
def words(monkeypatch):
    networks._encoder.cache_clear()
    monkeypatch.setattr(networks, "text_encoder", lambda name, folder=None: WordEncoder())
    yield
    networks._encoder.cache_clear()


def settings(folder, work, **changes):
    small = {
        "pool": 24, "clips": 16, "references": 30, "runs": 3, "candidates": 4, "prompts": 3, "repeats": 2, "steps": 2,
    }  # fmt: skip
    return MotionEvalConfig(
        data=folder / "motions", checkpoint=folder / "tapmo.safetensors",
        extractor=folder / "extractor.safetensors", work=work, **{**small, **changes},
    )  # fmt: skip


def test_all_rows_and_keys(folder, tmp_path):
    result = evaluate_motion(settings(folder, tmp_path))
    assert set(result["rows"]) == {"real", "tapmo"}
    for name, row in result["rows"].items():
        assert {"r_precision_1", "r_precision_2", "r_precision_3", "fid", "mm_dist", "diversity"} <= set(row)
        assert ("multimodality" in row) == (name != "real")
        assert row["r_precision_1"]["mean"] <= row["r_precision_2"]["mean"] <= row["r_precision_3"]["mean"] <= 1
    assert result["fid_real"] < result["fid"]  # random weights are worse than the real data
    assert 10 <= result["counts"]["clips"] <= 12 and result["counts"]["drawn"] == 16
    json.dumps(result)


def test_what_is_chosen_has_a_row_of_its_own(folder, tmp_path):
    result = evaluate_motion(replace(settings(folder, tmp_path), best_of=2))
    rows = result["rows"]
    assert set(rows) == {"real", "tapmo", "tapmo_guided", "tapmo_led", "tapmo_chosen"}
    assert len({rows[name]["fid"]["mean"] for name in rows}) == 5
    assert result["r_precision_1_over_real_chosen"] == pytest.approx(
        rows["tapmo_chosen"]["r_precision_1"]["mean"] / rows["real"]["r_precision_1"]["mean"]
    )
    other = evaluate_motion(replace(settings(folder, tmp_path), best_of=2, classifier_guidance=False, examples=False))[
        "rows"
    ]
    assert set(other) == {"real", "tapmo", "tapmo_chosen"}
    assert other["tapmo_chosen"]["fid"]["mean"] != rows["tapmo_chosen"]["fid"]["mean"]


def test_the_distilled_steps_have_a_row_where_they_are_of_these_weights(folder, tmp_path):
    default = replace(settings(folder, tmp_path / "work"), best_of=2, steps=None, repeats=0, examples=False)
    without = evaluate_motion(replace(default, checkpoint=folder / "tapmo.safetensors"))
    assert set(without["rows"]) == {"real", "tapmo", "tapmo_guided", "tapmo_chosen"}
    assert without["fid_distilled"] is None and without["r_precision_1_over_real_distilled"] is None
    own = tmp_path / "tapmo.safetensors"
    shutil.copy(folder / "tapmo.safetensors", own)
    state = load_checkpoint(own, "diffusion", half=True)[0]
    change = {"motion_out.weight.up": np.zeros((len(state["motion_out.weight"]), 1), np.float32)}
    change["motion_out.weight.down"] = np.zeros((1, state["motion_out.weight"].shape[1]), np.float32)
    config = {"of": fingerprint(state), "visited": [900, 300], "guidance": 2.5, "critic": False, "notes": {}}
    save_checkpoint(tmp_path / "few-steps.safetensors", change, config, "few-steps", half=True)
    found = evaluate_motion(replace(default, checkpoint=own))
    assert set(found["rows"]) == {*without["rows"], "tapmo_distilled"}
    assert found["rows"]["tapmo"] == without["rows"]["tapmo"]
    assert found["fid_distilled"] == found["rows"]["tapmo_distilled"]["fid"]["mean"] != found["fid"]
    config["visited"] = [950, 500, 100]  # distilled again: what is kept of the steps before is not taken for these
    save_checkpoint(tmp_path / "few-steps.safetensors", change, config, "few-steps", half=True)
    assert evaluate_motion(replace(default, checkpoint=own))["fid_distilled"] != found["fid_distilled"]


def test_the_same_seed_gives_the_same_table_and_a_cache_is_used(folder, tmp_path, monkeypatch):
    first = evaluate_motion(settings(folder, tmp_path))

    def refuse(*words, **options):
        raise AssertionError("the motions were made before")

    monkeypatch.setattr("bunraku_lab.evaluation.motion.samples.sample", refuse)
    again = evaluate_motion(settings(folder, tmp_path))
    assert again["rows"] == first["rows"]


def test_a_broken_batch_is_made_again(tmp_path):
    torch.manual_seed(0)
    model = Denoiser(network()).running()
    requests = [Request("walk", 40), Request("jump", 30), Request("run", 40)]
    how = {"folder": tmp_path, "digest": "a"}
    first = make_motions(model, WordEncoder(), requests, SamplerSettings(2, 2.5), **how)
    assert [len(motion) for motion in first] == [40, 30, 40]
    files = sorted(tmp_path.rglob("*.npz"))
    assert len(files) == 2
    files[0].write_bytes(b"not an archive")
    again = make_motions(model, WordEncoder(), requests, SamplerSettings(2, 2.5), **how)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    make_motions(model, WordEncoder(), requests, SamplerSettings(3, 2.5), **how)
    assert len(list(tmp_path.iterdir())) == 2  # other settings, another folder
    assert motion_samples.BATCH > 1
    with pytest.raises(OptionError, match="longer than the 60"):
        make_motions(model, WordEncoder(), [Request("walk", 61)], SamplerSettings(2, 2.5))


def test_a_perfect_and_a_blind_generator(tmp_path):
    """Vectors made by hand: a copy of the real data scores as it, one motion for all sentences scores as chance."""
    random = np.random.default_rng(0)
    meanings = [f"meaning {index}" for index in range(8)]
    centres = random.normal(size=(8, 5)) * 5
    clips = {name: {"features": np.zeros((60, 271)), "texts": [name]} for name in meanings}
    which = np.arange(400) % 8
    windows = [Window(meanings[i], 0, 60, False, meanings[i], meanings[i], meanings[i]) for i in which]
    sentences = dict(zip(meanings, centres, strict=True))
    real = centres[which] + 0.1 * random.normal(size=(400, 5))
    rows = {
        "real": Row(real),
        "same": Row(real.copy()),
        "blind": Row(np.tile(centres.mean(0), (400, 1)) + 0.1 * random.normal(size=(400, 5))),
    }
    references = centres[random.integers(8, size=400)] + 0.1 * random.normal(size=(400, 5))
    config = MotionEvalConfig(pool=400, clips=300, runs=4, candidates=8, work=tmp_path)
    measure_rows(rows, references, windows, clips, sentences, config, lambda stage, done: None)
    assert rows["same"].values == rows["real"].values
    assert np.mean(rows["real"].values["r_precision_1"]) == 1
    assert np.mean(rows["blind"].values["r_precision_1"]) == pytest.approx(1 / 8, abs=0.05)
    assert min(rows["blind"].values["fid"]) > 20 * max(rows["real"].values["fid"])


def test_every_row_of_the_papers_table_has_handles_on_both_bodies(folder, tmp_path):
    """What was measured of a row on a body is not measured again."""
    config = DistortionConfig(folder, folder / "tapmo.safetensors", work=tmp_path)
    kept = KeptParts(tmp_path / "parts")
    found = measure_handles(config, folder / "motions", 2, parts=kept)
    rows = {"ours", "ours, without adaptation", "MDM-SR", "MDM-SR, limbs aligned first"}
    assert set(found) == rows | {"MDM-SFR, floor without training"}
    assert all(np.isfinite(value) and value > 0 for value in found.values())
    parts = {path.name for path in (tmp_path / "parts").iterdir()}
    assert len(parts) == 2 * len(found)
    assert measure_handles(config, folder / "motions", 2, parts=lambda name, run: kept(name, None)) == found


def test_the_command_prints_what_a_viewer_sees(folder, tmp_path, capsys):
    words = ["evaluate", "motion", "--data", str(folder / "motions"), "--work", str(tmp_path), "--only", "viewer"]
    words += ["--checkpoint", str(folder / "tapmo.safetensors"), "--steps", "1", "--quick"]
    assert main([*words, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert set(VIEWER_BARS) <= set(result) and "rows" not in result
    assert set(result["jitter_by_action"]) > set(result["speed_by_action"])
    waves = result["jitter_by_action"]["wave"]
    assert waves["clips"] == 3 and waves["ratio"] == pytest.approx(waves["generated"] / waves["captured"])
    assert result["jitter_over_real"] >= waves["ratio"] and result["speed_over_captured"] is None
    assert main(words) == 0
    text = capsys.readouterr().out
    assert all(bar.title in text for bar in VIEWER_BARS.values()) and "R-Prec" not in text


def test_bad_options_are_one_sentence(tmp_path, capsys):
    assert main(["evaluate", "motion", "--data", str(tmp_path / "none")]) == 2
    assert "no such folder" in capsys.readouterr().err
    assert main(["evaluate", "motion", "--data", str(tmp_path), "--runs", "0"]) == 2
    assert "--runs" in capsys.readouterr().err
