"""Add-ons for Blender, ComfyUI and Godot."""

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from bunraku import save_character
from bunraku.cli import main
from bunraku.files import READERS
from bunraku.files.clips import load_animation
from bunraku.files.presets import preset_named
from bunraku.files.samples import sample_character
from bunraku.language.parse import parse

SCRIPT = """
import sys, json
import bpy
sys.path.insert(0, sys.argv[-3])
import bunraku_addon as addon

bpy.ops.wm.read_factory_settings(use_empty=True)
addon.register()
bpy.ops.import_scene.gltf(filepath=sys.argv[-1])
mesh = next(one for one in bpy.data.objects if one.type == "MESH")
bpy.context.view_layer.objects.active = mesh
settings = bpy.context.scene.bunraku
settings.prompt, settings.seconds, settings.seed = "waves", 2.0, 1

settings.address = "http://localhost:1/#token=none"
try:
    bpy.ops.bunraku.animate()
    said = ""
except RuntimeError as error:
    said = str(error)

settings.address = sys.argv[-2]
before = [one.name for one in bpy.data.objects]
hat = mesh.copy()
hat.data = mesh.data.copy()
bpy.context.collection.objects.link(hat)
before.append(hat.name)
mesh.select_set(True)
hat.select_set(True)
assert bpy.ops.bunraku.animate() == {"FINISHED"}
assert bpy.context.view_layer.objects.active == mesh and hat.select_get()
bpy.ops.object.select_all(action="DESELECT")
bpy.context.view_layer.objects.active = mesh.parent
mesh.parent.select_set(True)  # what was made is there to be made anew
assert bpy.ops.bunraku.animate() == {"FINISHED"}
assert hat.parent == mesh.parent and len(bpy.data.actions) == 1
armature = next(one.object for one in mesh.modifiers if one.type == "ARMATURE")
places = []
for frame in (1, 20, 40):
    bpy.context.scene.frame_set(frame)
    posed = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    places.append([tuple(mesh.matrix_world @ one.co) for one in posed.vertices][::50])
print("FOUND " + json.dumps({
    "said": said, "groups": len(mesh.vertex_groups), "bones": len(armature.data.bones),
    "action": armature.animation_data.action.name, "places": places,
    "rest": [tuple(mesh.matrix_world @ one.co) for one in mesh.data.vertices][::50],
    "new": sorted(set(one.name for one in bpy.data.objects) - set(before)),
}))
addon.unregister()
"""


def test_the_command_writes_it(tmp_path, capsys):
    path = tmp_path / "addon.py"
    assert main(["blender-addon", "-o", str(path)]) == 0
    assert "bl_info" in path.read_text() and compile(path.read_text(), str(path), "exec")
    assert main(["blender-addon", "-o", str(path)]) == 0  # the same file is no reason to stop
    path.write_text("mine")
    assert main(["blender-addon", "-o", str(path)]) == 2 and path.read_text() == "mine"


def test_what_it_asks_of_the_studio_goes_on_beside_blender(studio, tmp_path, monkeypatch):
    """The part of the add-on that talks, with a stand-in for the classes that Blender brings."""
    names = ("Operator", "Panel", "PropertyGroup")
    properties = SimpleNamespace(**dict.fromkeys(("StringProperty", "FloatProperty", "IntProperty"), dict))
    stand_in = SimpleNamespace(types=SimpleNamespace(**dict.fromkeys(names, object)), props=properties)
    monkeypatch.setitem(sys.modules, "bpy", stand_in)
    assert main(["blender-addon", "-o", str(tmp_path / "addon.py")]) == 0
    addon = loaded(tmp_path / "addon.py")
    mesh = save_character(sample_character("mushroom"), tmp_path / "mushroom.glb").read_bytes()
    before = {one["id"] for one in studio.get("/api/characters")["characters"]}
    works = [addon.Work(studio.address, mesh, "mushroom", text, 0.5, 1, 24) for text in ("waves", "blorg zint")]
    for work in works:
        work.start()
        assert work.is_alive()  # and Blender goes on
    for work in works:
        work.join(120)
    assert works[0].result[:4] == b"glTF" and works[0].error == ""
    assert "no movement is understood" in works[1].error and "force" not in works[1].error
    assert {one["id"] for one in studio.get("/api/characters")["characters"]} == before


def test_it_makes_an_action_in_blender(studio, tmp_path):
    import json

    import numpy as np

    python = os.environ.get("BUNRAKU_BLENDER_PYTHON")
    if not python or shutil.which(python) is None:
        pytest.skip("BUNRAKU_BLENDER_PYTHON names no Python with Blender's module bpy")
    from bunraku import save_character
    from bunraku.files.samples import sample_character

    assert main(["blender-addon", "-o", str(tmp_path / "bunraku_addon.py")]) == 0
    mesh = save_character(sample_character("person"), tmp_path / "person.glb")
    (tmp_path / "script.py").write_text(SCRIPT)
    found = subprocess.run(
        [python, str(tmp_path / "script.py"), str(tmp_path), studio.address, str(mesh)],
        capture_output=True, text=True, check=False, timeout=500,
    )  # fmt: skip
    lines = [line for line in found.stdout.splitlines() if line.startswith("FOUND ")]
    assert lines, found.stdout[-2000:] + found.stderr[-2000:]
    said = json.loads(lines[0][6:])
    assert "start it with: bunraku studio" in said["said"]
    assert said["action"] == "waves" and said["bones"] == 30 and 20 <= said["groups"] <= 30
    assert len(said["new"]) == 1  # the armature alone
    positions, rest = np.array(said["places"]), np.array(said["rest"])
    assert 0.05 < np.abs(positions[1] - rest).max() < 1.5  # it moves, and nothing is torn away
    assert np.abs(np.ptp(positions[1], axis=0)[2] - np.ptp(rest, axis=0)[2]) < 0.5


def loaded(path):
    spec = importlib.util.spec_from_file_location("addon", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_sentence_from_the_node_to_a_moving_character(studio, tmp_path, monkeypatch):
    folder = tmp_path / "bunraku"
    assert main(["comfyui-nodes", "-o", str(folder)]) == 0
    assert main(["comfyui-nodes", "-o", str(folder)]) == 0  # the same pack is no reason to stop
    before = set(sys.modules)
    pack = loaded(folder / "__init__.py")
    assert not {"torch", "bpy", "bunraku"} & (set(sys.modules) - before)
    node = pack.NODE_CLASS_MAPPINGS["BunrakuAnimate"]
    asked = node.INPUT_TYPES()["required"]
    given = {name: what[1]["default"] if len(what) > 1 else what[0][0] for name, what in asked.items()}
    mesh = save_character(sample_character("mushroom"), tmp_path / "mushroom.glb")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="with its token"):
        node().animate(**{**given, "model_file": str(mesh)})
    given |= {"model_file": str(mesh), "sentence": "waves", "seconds": 1.0, "format": "fbx", "address": studio.address}
    (path,) = getattr(node(), node.FUNCTION)(**given)
    assert len(node.RETURN_TYPES) == 1 and load_animation(path, 0, 30).vertices().std(axis=0).max() > 0
    with pytest.raises(ValueError, match="type what the character does"):
        node().animate(**{**given, "sentence": " "})
    (folder / "__init__.py").write_text("mine")
    assert main(["comfyui-nodes", "-o", str(folder)]) == 2


ADDON = Path(__file__).resolve().parents[2] / "src/bunraku/studio/addon/godot"
SCENE = Path(__file__).resolve().parents[2] / "examples/godot"

# Waits for the add-on's node as a running game would, and says what Godot's own reader makes of the file.
GODOT_SCRIPT = """
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

# Does in the editor what a user does: chooses a mesh, types into the panel, presses its button, and looks at what Godot
# imported.
DRIVER = """
@tool
extends EditorPlugin


func _enter_tree() -> void:
	_run.call_deferred()


func _run() -> void:
	var given := OS.get_cmdline_user_args()
	var files := EditorInterface.get_resource_filesystem()
	while files.is_scanning() or not ResourceLoader.exists("res://person.glb"):
		await get_tree().create_timer(0.2).timeout
	EditorInterface.select_file("res://person.glb")
	var panel: Node = EditorInterface.get_base_control().find_child("Bunraku", true, false)
	var fields := panel.find_children("*", "LineEdit", false, false)
	fields[0].text = given[0]
	fields[1].text = "waves"
	panel.find_children("*", "SpinBox", false, false)[0].value = 1.0
	var button: Button = panel.find_children("*", "Button", false, false)[0]
	button.pressed.emit()
	while button.disabled:
		await get_tree().create_timer(0.2).timeout
	var found := {"said": panel.find_children("*", "Label", false, false)[0].text}
	var path := "res://person-waves.glb"
	for turn in 100:
		if ResourceLoader.exists(path) and not files.is_scanning():
			break
		await get_tree().create_timer(0.2).timeout
	var scene: Node = load(path).instantiate()
	var skeleton: Skeleton3D = scene.find_children("*", "Skeleton3D")[0]
	var player: AnimationPlayer = scene.find_children("*", "AnimationPlayer")[0]
	found["clips"] = Array(player.get_animation_list())
	found["bones"] = range(skeleton.get_bone_count()).map(skeleton.get_bone_name)
	var profile := SkeletonProfileHumanoid.new()
	found["strange"] = found["bones"].filter(
		func(bone: String) -> bool: return profile.find_bone(bone[0].to_upper() + bone.substr(1)) < 0
	)
	found["meshes"] = scene.find_children("*", "MeshInstance3D").size()
	scene.free()
	print("FOUND " + JSON.stringify(found))
	get_tree().quit()
"""


WALKER = """extends SceneTree
func _initialize() -> void:
	var scene: Node3D = load("res://walk.tscn").instantiate()
	scene.address = OS.get_cmdline_user_args()[0]
	root.add_child(scene)
	while scene._poses.is_empty():
		await create_timer(0.2).timeout
	Input.action_press("ui_up")
	await create_timer(6.0).timeout
	var place: Vector3 = scene._skeleton.get_bone_global_pose(scene._bones[0]).origin
	print("FOUND " + JSON.stringify({"z": place.z, "says": scene.get_node("Says").text}))
	quit()
"""


def godot():
    """Godot's program, or a reason to skip."""
    named = os.environ.get("BUNRAKU_GODOT")
    if not named or shutil.which(named) is None:
        pytest.skip("BUNRAKU_GODOT names no Godot 4")
    return named


def found_by(folder, *words, given):
    """What a script in a project says that it found, and all that Godot said."""
    asked = [godot(), "--headless", "--path", str(folder), *words, "--", *given]
    done = subprocess.run(asked, capture_output=True, text=True, check=False, timeout=300)
    lines = [line for line in done.stdout.splitlines() if line.startswith("FOUND ")]
    assert lines, done.stdout[-2000:] + done.stderr[-2000:]
    return json.loads(lines[0][6:]), done.stdout + done.stderr


def test_the_command_writes_the_godot_addon(tmp_path):
    folder = tmp_path / "addons" / "bunraku"
    assert main(["godot-addon", "-o", str(folder)]) == 0  # a new project has no folder of add-ons
    assert sorted(path.name for path in folder.iterdir()) == ["dock.gd", "plugin.cfg", "plugin.gd", "studio.gd"]
    assert main(["godot-addon", "-o", str(folder)]) == 0  # the same add-on is no reason to stop
    (folder / "dock.gd").write_text("mine")
    assert main(["godot-addon", "-o", str(folder)]) == 2 and (folder / "dock.gd").read_text() == "mine"


def test_its_scripts_are_godots_language():
    parser = pytest.importorskip("gdtoolkit.parser", reason="gdtoolkit is not installed: pip install gdtoolkit").parser
    for path in (*ADDON.glob("*.gd"), *SCENE.glob("*.gd"), None):
        text = GODOT_SCRIPT if path is None else path.read_text(encoding="utf-8")
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
    assert reads <= {suffix[1:] for suffix in READERS["character"]}


def test_the_scene_that_walks_asks_what_the_studio_answers(client):
    text = (SCENE / "walk.gd").read_text(encoding="utf-8")
    paths = client.get("/api/openapi.json").json()["paths"]
    assert {"/characters", "/characters/{name}/mesh.glb", "/characters/{name}/live", "/jobs/{name}"} <= paths.keys()
    assert set(re.findall(r'_route \+ "(.+?)"', text)) == {"/mesh.glb", "/live"} and '_route = "/characters/%s"' in text
    schema = paths["/characters/{name}/live"]["post"]["requestBody"]["content"]["application/json"]["schema"]
    asked = set(re.findall(r'asked\["(\w+)"\]', text)) | set(re.findall(r'"(\w+)": _', text))
    assert asked <= set(schema["properties"]) and len(asked) == 4
    for sentence in re.search(r"SENTENCES: .+ = \[(.+)\]", text)[1].split(", "):
        assert parse(sentence.strip('"'), 2.0)


def test_the_scene_that_walks_walks(studio, tmp_path):
    godot()
    shutil.copytree(SCENE, tmp_path / "game")
    (tmp_path / "game" / "driver.gd").write_text(WALKER)
    said, all_said = found_by(tmp_path / "game", "--script", "driver.gd", given=[studio.address])
    assert "SCRIPT ERROR" not in all_said and said["z"] < -0.5 and said["says"].startswith("arrows")


def test_a_sentence_from_godot_to_a_moving_character(studio, tmp_path):
    godot()
    assert main(["godot-addon", "-o", str(tmp_path / "addons" / "bunraku")]) == 0
    (tmp_path / "project.godot").write_text('config_version=5\n\n[application]\n\nconfig/name="test"\n')
    (tmp_path / "script.gd").write_text(GODOT_SCRIPT)
    mesh = save_character(sample_character("person"), tmp_path / "person.glb")
    said, _ = found_by(tmp_path, "--script", "script.gd", given=[studio.address, str(mesh)])
    assert "start it with: bunraku studio" in said["refused"] and said["wrong"] == ""
    assert said["clips"] == ["waves"] and said["bones"] > 15 and 0.05 < said["moved"] < 2


def test_its_panel_makes_a_scene_in_the_editor(studio, tmp_path):
    godot()
    assert main(["godot-addon", "-o", str(tmp_path / "addons" / "bunraku")]) == 0
    driver = tmp_path / "addons" / "driver"
    driver.mkdir()
    (driver / "driver.gd").write_text(DRIVER)
    (driver / "plugin.cfg").write_text(
        '[plugin]\n\nname="Driver"\ndescription=""\nauthor=""\nversion="1"\nscript="driver.gd"\n'
    )
    plugins = ", ".join(f'"res://addons/{name}/plugin.cfg"' for name in ("bunraku", "driver"))
    (tmp_path / "project.godot").write_text(
        f'config_version=5\n\n[application]\n\nconfig/name="test"\n\n[editor_plugins]\n\n'
        f"enabled=PackedStringArray({plugins})\n"
    )
    save_character(sample_character("person"), tmp_path / "person.glb")
    said, all_said = found_by(tmp_path, "--editor", given=[studio.address])
    assert "SCRIPT ERROR" not in all_said and "Parse Error" not in all_said
    assert said["said"].startswith("res://person-waves.glb") and (tmp_path / "person-waves.glb").stat().st_size > 1e4
    assert said["clips"] == ["waves"] and said["meshes"] == 1
    assert {"hips", "leftUpperArm", "rightLowerLeg", "head"} <= set(said["bones"])
    assert said["strange"] == []  # Godot's profile of a humanoid knows each, with a capital
