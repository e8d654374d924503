"""`bunraku inspect` prints every guess about hair and clothes, and writes a file to change them by."""

import json
from pathlib import Path

import numpy as np
import pytest

from bunraku import load_character
from bunraku.cli.app import main
from bunraku.core.character import Character
from bunraku.io import save_character
from bunraku.pipelines.apparel import learned
from bunraku.pipelines.transfer import transfer
from bunraku_lab.evaluation.transfer.stock_motions import stock_motion
from bunraku_lab.synthetic.wardrobe import wardrobe_character


@pytest.fixture(scope="module")
def tails(tmp_path_factory) -> Path:
    """Twin tails on a mesh that says nothing of them."""
    model = wardrobe_character(810_003)
    return save_character(
        Character("tails", model.vertices, model.faces), tmp_path_factory.mktemp("bare") / "tails.glb"
    )


def test_guesses_are_printed_and_changed_by_a_file(tails: Path, capsys) -> None:
    path = tails.with_name("tails.apparel.toml")
    assert main(["inspect", str(tails), "--json", "--apparel", str(path)]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert {"kind", "hangs_on", "stiffness", "limit", "damping", "vertices"} <= facts["apparel"][0].keys()
    assert {"limit", "stiffness", "damping", "gravity", "mass"} <= facts["chains"][0].keys()
    text = path.read_text("utf-8")
    assert text.count("# limit = ") == len(facts["chains"])

    character = load_character(tails)
    moved = transfer(Character("t", character.vertices, character.faces), stock_motion("walk", 0.5, 20.0))
    assert (moved.character.vertices == character.vertices).all()

    def shown() -> np.ndarray:
        return learned(type(moved)(character, moved.handles, moved.motion)).offsets

    plain = shown()
    path.write_text(text.replace("# limit = ", "limit = 0.1 # "), "utf-8")
    still = shown()
    assert np.abs(still).max() < 0.8 * np.abs(plain).max()
    assert main(["inspect", str(tails), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert max(part["stiffness"] for part in told["apparel"]) > max(part["stiffness"] for part in facts["apparel"])
    path.unlink()
    np.testing.assert_array_equal(shown(), plain)


def test_a_file_that_says_how_it_moves_needs_none(tmp_path: Path, capsys) -> None:
    from bunraku.formats.mmd.export import save_pmx

    model = save_pmx(wardrobe_character(810_003), tmp_path / "one.pmx")
    assert main(["inspect", str(model), "--apparel", str(tmp_path / "one.apparel.toml")]) == 2
    assert "leave out --apparel" in capsys.readouterr().err
    assert not (tmp_path / "one.apparel.toml").exists()
