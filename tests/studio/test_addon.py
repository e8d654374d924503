"""The add-on for Blender: written by the command line, and at work in Blender's own Python module."""

import os
import shutil
import subprocess

import pytest

from bunraku.cli import main

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
assert bpy.ops.bunraku.animate() == {"FINISHED"}
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


def test_it_makes_an_action_in_blender(studio, tmp_path):
    import json

    import numpy as np

    python = os.environ.get("BUNRAKU_BLENDER_PYTHON")
    if not python or shutil.which(python) is None:
        pytest.skip("BUNRAKU_BLENDER_PYTHON names no Python with Blender's module bpy")
    from bunraku import save_character
    from bunraku.samples import sample_character

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
