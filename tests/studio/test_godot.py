"""The add-on for Godot 4: written by the command line, held against a parser of its language and against the studio's
own description of its routes, and at work in Godot where there is one.
"""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from bunraku import save_character
from bunraku.cli import main
from bunraku.io.presets import preset_named
from bunraku.io.table import FORMATS
from bunraku.samples import sample_character

ADDON = Path(__file__).resolve().parents[2] / "src/bunraku/studio/addon/godot"

# Waits for the add-on's node as a running game would, and says what Godot's own reader makes of the file.
SCRIPT = """
extends SceneTree


func _initialize() -> void:
	_run.call_deferred()


func _run() -> void:
	var given := OS.get_cmdline_user_args()
	var studio: Node = load("res://addons/bunraku/studio.gd").new()
	root.add_child(studio)
	var data := FileAccess.get_file_as_bytes(given[1])
	var sentences := [{"text": "waves", "seconds": 1.0}]
	await studio.animate("http://localhost:1/#token=none", "mesh.glb", data, sentences, 1)
	var found := {"refused": studio.wrong}
	var made: PackedByteArray = await studio.animate(given[0], "mesh.glb", data, sentences, 1)
	found["wrong"] = studio.wrong
	var document := GLTFDocument.new()
	var state := GLTFState.new()
	document.append_from_buffer(made, "", state)
	var scene := document.generate_scene(state)
	root.add_child(scene)
	var player: AnimationPlayer = scene.find_children("*", "AnimationPlayer")[0]
	var skeleton: Skeleton3D = scene.find_children("*", "Skeleton3D")[0]
	found["clips"] = Array(player.get_animation_list())
	found["bones"] = skeleton.get_bone_count()
	var moved := 0.0
	var before: Array[Transform3D] = []
	player.play(player.get_animation_list()[0])
	for moment: float in [0.0, 0.5]:
		player.seek(moment, true)
		for bone in skeleton.get_bone_count():
			var place := skeleton.get_bone_global_pose(bone)
			if moment == 0.0:
				before.append(place)
			else:
				moved = maxf(moved, place.origin.distance_to(before[bone].origin))
	found["moved"] = moved
	print("FOUND " + JSON.stringify(found))
	quit()
"""


def test_the_command_writes_it(tmp_path):
    folder = tmp_path / "addons" / "bunraku"
    assert main(["godot-addon", "-o", str(folder)]) == 0  # a new project has no folder of add-ons
    assert sorted(path.name for path in folder.iterdir()) == ["dock.gd", "plugin.cfg", "plugin.gd", "studio.gd"]
    assert main(["godot-addon", "-o", str(folder)]) == 0  # the same add-on is no reason to stop
    (folder / "dock.gd").write_text("mine")
    assert main(["godot-addon", "-o", str(folder)]) == 2 and (folder / "dock.gd").read_text() == "mine"


def test_its_scripts_are_godots_language():
    parser = pytest.importorskip("gdtoolkit.parser", reason="gdtoolkit is not installed: pip install gdtoolkit").parser
    for path in (*ADDON.glob("*.gd"), None):
        text = SCRIPT if path is None else path.read_text(encoding="utf-8")
        assert parser.parse(text).children
    used = re.findall(r'preload\("(.+?)"\)|script="(.+?)"', "".join(one.read_text() for one in ADDON.iterdir()))
    assert used and all((ADDON / (one or other)).is_file() for one, other in used)


def test_it_asks_what_the_studio_answers(client):
    """Each request of its script is a route of the document, by method and path, with a body that the route reads."""
    text = (ADDON / "studio.gd").read_text(encoding="utf-8")
    paths = client.get("/api/openapi.json").json()["paths"]
    asked = re.findall(r'HTTPClient\.METHOD_(\w+), "([^"?]+)', text)
    assert len(asked) == len(re.findall(r"HTTPClient\.METHOD_", text)) == 6
    for method, path in asked:
        known = [one for one in paths if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", one), path)]
        assert any(method.lower() in paths[one] for one in known), (method, path)
    bodies = {"/characters/{name}/takes": "asked", "/characters/{name}/exports": "wanted"}
    for path, name in bodies.items():
        (body,) = re.findall(rf"var {name} := \{{(.+)\}}", text)
        schema = paths[path]["post"]["requestBody"]["content"]["application/json"]["schema"]
        assert set(re.findall(r'"(\w+)":', body)) <= set(schema["properties"])
    assert preset_named("godot").suffix == ".glb" and '"preset": "godot"' in text
    reads = set(json.loads("[" + re.search(r"READS: Array\[String\] = \[(.+)\]", text)[1] + "]"))
    assert reads <= {suffix[1:] for one in FORMATS if one.character for suffix in one.suffixes}


def test_a_sentence_from_godot_to_a_moving_character(studio, tmp_path):
    godot = os.environ.get("BUNRAKU_GODOT")
    if not godot or shutil.which(godot) is None:
        pytest.skip("BUNRAKU_GODOT names no Godot 4")
    assert main(["godot-addon", "-o", str(tmp_path / "addons" / "bunraku")]) == 0
    (tmp_path / "project.godot").write_text('config_version=5\n\n[application]\n\nconfig/name="test"\n')
    (tmp_path / "script.gd").write_text(SCRIPT)
    mesh = save_character(sample_character("person"), tmp_path / "person.glb")
    found = subprocess.run(
        [godot, "--headless", "--path", str(tmp_path), "--script", "script.gd", "--", studio.address, str(mesh)],
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    lines = [line for line in found.stdout.splitlines() if line.startswith("FOUND ")]
    assert lines, found.stdout[-2000:] + found.stderr[-2000:]
    said = json.loads(lines[0][6:])
    assert "start it with: bunraku studio" in said["refused"] and said["wrong"] == ""
    assert said["clips"] == ["waves"] and said["bones"] > 15 and 0.05 < said["moved"] < 2
