"""Runs inside Blender: opens GLBs with its importer and writes where their vertices are at some times.

blender --background --factory-startup --python blender_play.py -- JOBS

JOBS is a JSON file: [{"glb": ..., "times": [s, ...], "fps": ..., "out": ..., "clip": N}]. OUT gets 32-bit floats: for
each time, for each mesh object, x, y and z of each vertex in the world, turned back to glTF's axes; OUT.json lists the
objects.
"""

import json
import sys

import bpy
import numpy as np
from io_scene_gltf2.blender.imp.animation_utils import restore_animation_on_object
from io_scene_gltf2.blender.imp.blender_gltf import BlenderGlTF

imported = []
create = BlenderGlTF.create


def remembered(*given):
    """The importer's own work; what it knows of nodes and objects is kept."""
    imported[:] = given[-1:]
    create(*given)


BlenderGlTF.create = staticmethod(remembered)


def places(thing, graph):
    """Vertices of an object as modifiers and shape keys have them, in the world, glTF's axes."""
    evaluated = thing.evaluated_get(graph)
    mesh = evaluated.to_mesh()
    local = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("co", local)
    evaluated.to_mesh_clear()
    matrix = np.array(evaluated.matrix_world)
    world = local.reshape(-1, 3).astype(float) @ matrix[:3, :3].T + matrix[:3, 3]
    return np.stack([world[:, 0], world[:, 2], -world[:, 1]], axis=-1)


def alone(number, clips):
    """Let one clip play: the importer lays each on a muted track of its own, named after it."""
    if len(clips) > 1:
        for thing in bpy.data.objects:
            restore_animation_on_object(thing, clips[number].track_name)


def play(job):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = max(round(job["fps"]), 1)
    scene.render.fps_base = scene.render.fps / job["fps"]
    bpy.ops.import_scene.gltf(filepath=job["glb"])
    alone(job.get("clip", 0), imported[0].data.animations or [])
    nodes = {}
    for node in imported[0].vnodes.values():
        thing = getattr(node, "blender_object", None)
        if thing is not None and thing.type == "MESH" and getattr(node, "mesh_node_idx", None) is not None:
            nodes[thing.name] = node.mesh_node_idx
    things = sorted((bpy.data.objects[name] for name in nodes), key=lambda thing: nodes[thing.name])
    out = []
    for time in job["times"]:
        frame = time * job["fps"]
        whole = round(frame) if abs(frame - round(frame)) < 1e-4 else int(frame)
        scene.frame_set(whole, subframe=max(frame - whole, 0.0))
        graph = bpy.context.evaluated_depsgraph_get()
        out.extend(places(thing, graph) for thing in things)
    np.concatenate(out).astype("<f4").tofile(job["out"])
    with open(f"{job['out']}.json", "w", encoding="utf-8") as file:
        json.dump([{"node": nodes[thing.name], "count": len(thing.data.vertices)} for thing in things], file)


with open(sys.argv[sys.argv.index("--") + 1], encoding="utf-8") as file:
    jobs = json.load(file)
for job in jobs:
    play(job)
