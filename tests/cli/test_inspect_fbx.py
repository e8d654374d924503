"""`bunraku inspect` on FBX files."""

import gzip
import json
from pathlib import Path

from bunraku.cli import main

DATA = Path(__file__).parents[1] / "formats" / "data"


def inspected(name: str, folder: Path, capsys) -> dict:
    path = folder / f"{name}.fbx"
    path.write_bytes(gzip.decompress((DATA / f"{name}.fbx.gz").read_bytes()))
    assert main(["inspect", str(path), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_character(tmp_path, capsys):
    facts = inspected("boxman_z_up_cm", tmp_path, capsys)
    assert facts["rig"]["joints"] == 15 and facts["vertices"] == 120 and facts["meshes"] == 1
    assert facts["animations"] == [{"name": "Wave", "seconds": 0.5, "channels": 48}]
    assert facts["file_unit"] == "0.01 m" and facts["file_axes"].startswith("up +Z") and facts["fbx_version"] == "7.4"
    assert "Blender" in facts["generator"]


def test_clips_without_a_character(tmp_path, capsys):
    facts = inspected("boxman_motion", tmp_path, capsys)
    assert (
        facts["kind"] == "skeletal motion" and facts["joints"] == 15 and facts["frames"] == 11 and facts["meshes"] == 0
    )
