"""`bunraku inspect` of apparel, FBX files and MMD files."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from mmd_bytes import Joint, plank, pmd, pmx

from bunraku import load_character
from bunraku.cli.app import main
from bunraku.core.character import Character
from bunraku.files import save_character
from bunraku.files.mmd.vmd import MmdClip, write_vmd
from bunraku.pipelines.apparel import learned
from bunraku.pipelines.transfer import transfer
from bunraku_lab.synthetic.stock_motions import stock_motion
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
    from bunraku.files.mmd.write import save_pmx

    model = save_pmx(wardrobe_character(810_003), tmp_path / "one.pmx")
    assert main(["inspect", str(model), "--apparel", str(tmp_path / "one.apparel.toml")]) == 2
    assert "leave out --apparel" in capsys.readouterr().err
    assert not (tmp_path / "one.apparel.toml").exists()


DATA = Path(__file__).parents[1] / "files" / "data"


def inspected(path: Path, capsys) -> dict:
    packed = DATA / f"{path.name}.gz"
    if packed.is_file():
        path.write_bytes(gzip.decompress(packed.read_bytes()))
    assert main(["inspect", str(path), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_character_and_clips_without_one(tmp_path, capsys):
    facts = inspected(tmp_path / "boxman_z_up_cm.fbx", capsys)
    assert facts["rig"]["joints"] == 15 and facts["vertices"] == 120 and facts["meshes"] == 1
    assert facts["animations"] == [{"name": "Wave", "seconds": 0.5, "channels": 48}]
    assert facts["file_unit"] == "0.01 m" and facts["file_axes"].startswith("up +Z") and facts["fbx_version"] == "7.4"
    assert "Blender" in facts["generator"]
    facts = inspected(tmp_path / "boxman_motion.fbx", capsys)
    assert [facts[name] for name in ("kind", "joints", "frames", "meshes")] == ["skeletal motion", 15, 11, 0]


def test_a_model(tmp_path, capsys):
    (tmp_path / "doll.pmx").write_bytes(pmx(plank(textures=[], joints=[*plank().joints, Joint("外", (0, 5))])))
    facts = inspected(tmp_path / "doll.pmx", capsys)
    assert (facts["model"], facts["version"], facts["bones"], facts["morphs"]) == ("人形 / doll", "PMX 2.0", 3, 2)
    assert (facts["rigid_bodies"], facts["rigid_bodies_dynamic"], facts["rigid_joints"]) == (2, 1, 1)
    assert facts["apparel_vertices"] == 0 and facts["deforms"] == {"BDEF1": 1, "BDEF2": 1, "BDEF4": 1, "SDEF": 1}
    assert facts["warnings"] == ["joints are between rigid bodies that do not exist and are left out: 外"]
    assert "generator" not in facts
    (tmp_path / "doll.pmd").write_bytes(pmd(plank(textures=[], materials=[])))
    assert inspected(tmp_path / "doll.pmd", capsys)["version"] == "PMD"
    assert main(["inspect", str(tmp_path / "doll.pmx")]) == 0 and "BDEF1 1, BDEF2 1" in capsys.readouterr().out


def test_a_motion(tmp_path, capsys):
    still = (np.zeros((31, 3)), np.tile(np.eye(3), (31, 1, 1)))
    moving = (np.linspace(0, 1, 31)[:, None] * [1.0, 0, 0], still[1])
    write_vmd(MmdClip({"頭": still, "センター": moving}, "人形", ("左足ＩＫ",)), tmp_path / "take.vmd")
    facts = inspected(tmp_path / "take.vmd", capsys)
    said = [facts[name] for name in ("kind", "model", "frames", "seconds", "keys")]
    assert said == ["MMD motion", "人形", 31, 1.0, 32]
    assert facts["bones"] == ["センター", "頭"] and facts["inverse_kinematics_off"] == ["左足ＩＫ"]


def test_broken_ones(tmp_path, fails):
    (tmp_path / "doll.pmx").write_bytes(pmx(plank(triangles=[0, 1, 99])))
    assert "uses vertex 99 but there are 4" in fails("inspect", tmp_path / "doll.pmx")
    (tmp_path / "take.vmd").write_bytes(b"Vocaloid Motion Data 0002".ljust(50, b"\0") + b"\xff\xff\xff\xff")
    assert "announces 4294967295 bone keys" in fails("inspect", tmp_path / "take.vmd")
