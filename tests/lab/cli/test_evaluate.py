import json

import pytest

from bunraku.cli import main
from bunraku.core.body.reference import reference_body
from bunraku.core.character import Character
from bunraku.core.nn.checkpoints import shipped_checkpoint
from bunraku.files import save_character
from bunraku_lab.cli.evaluate_characters import EvaluateHandles, _handles_report


def test_bad_options_are_one_sentence(fails, tmp_path):
    assert "no such folder" in fails("evaluate", "handles", "--characters", tmp_path / "none")
    assert "no characters here" in fails("evaluate", "handles", "--characters", tmp_path)
    assert "--all needs --characters" in fails("evaluate", "handles", "--all")
    assert "--seed" in fails("evaluate", "handles", "--seed", -1)
    assert "weights.safetensors" in fails("evaluate", "handles", "--checkpoint", tmp_path / "weights.safetensors")


@pytest.mark.skipif(not shipped_checkpoint("handles").is_file(), reason="the shipped weights are not there")
def test_the_table_and_its_json(tmp_path, capsys):
    body = reference_body()
    save_character(Character("body", body.vertices, body.faces), tmp_path / "body.glb", body.handles)
    words = ["evaluate", "handles", "--characters", str(tmp_path), "--no-baselines"]
    assert main([*words, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (
        result["counts"]["characters"] == 1
        and result["characters"][0]["name"] == "body"
        and result["pose_error_clusters"] is None
    )
    assert result["orientation_upright"] == 1 and result["orientation_creatures"] is None
    assert result["reached"]["orientation_upright"] and result["reached"]["orientation_creatures"] is None
    EvaluateHandles().show(result, _handles_report)
    text = capsys.readouterr().out
    row = next(line for line in text.splitlines() if line.startswith("root"))
    assert result["counts"]["humanoids"] == 1 and "<= 3.00%" in row
    assert row.endswith("yes" if result["reached"]["root_error"] else "no")
    assert f"{result['part_purity']:.1%}" in text
