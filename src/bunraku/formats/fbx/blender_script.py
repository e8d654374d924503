"""Runs inside Blender, not in Bunraku: a GLB in, an FBX out. It imports nothing of the package.

blender --background --factory-startup --python blender_script.py -- IN.glb OUT.fbx OPTIONS

OPTIONS is JSON: {"fps": 30, "frames": 90, "name": "walk", "up": "+y", "scale": "FBX_SCALE_NONE"}
"""

from __future__ import annotations

import importlib
import json
import sys
from typing import Any

__all__ = ["convert"]


def convert(source: str, target: str, fps: float, frames: int, name: str, up: str, scale: str) -> None:
    """Convert a file.

    Args:
        source: The GLB.
        target: The FBX.
        fps: Frames a second [1/s].
        frames: Frames of the clip.
        name: The clip's name.
        up: The axis that is up in the FBX, "+y" or "+z".
        scale: Where the unit goes: FBX_SCALE_NONE gives centimetres, FBX_SCALE_ALL metres.
    """
    bpy: Any = importlib.import_module("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.name = name  # the exporter names its one clip after the scene
    scene.render.fps = max(round(fps), 1)
    scene.render.fps_base = scene.render.fps / fps
    bpy.ops.import_scene.gltf(filepath=source, bone_heuristic="TEMPERANCE", guess_original_bind_pose=False)
    for thing in list(bpy.data.objects):  # the shapes that the importer draws bones with
        if thing.name.startswith("Icosphere") and thing.parent is None and not thing.modifiers:
            bpy.data.objects.remove(thing)
    scene.frame_start, scene.frame_end = 0, max(frames - 1, 1)
    bpy.ops.export_scene.fbx(
        filepath=target,
        object_types={"ARMATURE", "MESH", "EMPTY"},
        add_leaf_bones=False,
        bake_anim=True,
        bake_anim_use_all_bones=True,
        bake_anim_use_nla_strips=False,
        bake_anim_use_all_actions=False,
        bake_anim_force_startend_keying=True,
        bake_anim_simplify_factor=0.0,
        apply_scale_options=scale,
        axis_up="Y" if up == "+y" else "Z",
        axis_forward="-Z" if up == "+y" else "-Y",
        path_mode="COPY",
        embed_textures=True,
        mesh_smooth_type="OFF",
    )


if __name__ == "__main__":
    source, target, options = sys.argv[sys.argv.index("--") + 1 :][:3]
    convert(source, target, **json.loads(options))
