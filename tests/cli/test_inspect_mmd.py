"""`bunraku inspect` on PMX, PMD and VMD files."""

import json
from pathlib import Path

import numpy as np
from mmd_bytes import Joint, plank, pmd, pmx

from bunraku.cli import main
from bunraku.formats.mmd.vmd_write import MmdClip, write_vmd


def inspected(path: Path, capsys) -> dict:
    assert main(["inspect", str(path), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_model(tmp_path, capsys):
    (tmp_path / "doll.pmx").write_bytes(pmx(plank(textures=[], joints=[*plank().joints, Joint("外", (0, 5))])))
    facts = inspected(tmp_path / "doll.pmx", capsys)
    assert (facts["model"], facts["version"], facts["bones"], facts["morphs"]) == ("人形 / doll", "PMX 2.0", 3, 2)
    assert (facts["rigid_bodies"], facts["rigid_bodies_dynamic"], facts["rigid_joints"]) == (2, 1, 1)
    assert facts["apparel_vertices"] == 0 and facts["deforms"] == {"BDEF1": 1, "BDEF2": 1, "BDEF4": 1, "SDEF": 1}
    assert (
        facts["warnings"] == ["joints are between rigid bodies that do not exist and are left out: 外"]
        and "generator" not in facts
    )
    (tmp_path / "doll.pmd").write_bytes(pmd(plank(textures=[], materials=[])))
    assert inspected(tmp_path / "doll.pmd", capsys)["version"] == "PMD"
    assert main(["inspect", str(tmp_path / "doll.pmx")]) == 0 and "BDEF1 1, BDEF2 1" in capsys.readouterr().out


def test_a_motion(tmp_path, capsys):
    still = (np.zeros((31, 3)), np.tile(np.eye(3), (31, 1, 1)))
    moving = (np.linspace(0, 1, 31)[:, None] * [1.0, 0, 0], still[1])
    write_vmd(MmdClip({"頭": still, "センター": moving}, "人形", ("左足ＩＫ",)), tmp_path / "take.vmd")
    facts = inspected(tmp_path / "take.vmd", capsys)
    assert (facts["kind"], facts["model"], facts["frames"], facts["seconds"], facts["keys"]) == (
        "MMD motion",
        "人形",
        31,
        1.0,
        32,
    )
    assert facts["bones"] == ["センター", "頭"] and facts["inverse_kinematics_off"] == ["左足ＩＫ"]


def test_broken_ones(tmp_path, fails):
    (tmp_path / "doll.pmx").write_bytes(pmx(plank(triangles=[0, 1, 99])))
    assert "uses vertex 99 but there are 4" in fails("inspect", tmp_path / "doll.pmx")
    (tmp_path / "take.vmd").write_bytes(b"Vocaloid Motion Data 0002".ljust(50, b"\0") + b"\xff\xff\xff\xff")
    assert "announces 4294967295 bone keys" in fails("inspect", tmp_path / "take.vmd")
