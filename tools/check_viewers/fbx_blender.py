"""Runs inside Blender: opens FBX files with its importer and writes joints, weights and where everything is at some
times.

blender --background --factory-startup --python fbx_blender.py -- JOBS

JOBS is a JSON file: [{"fbx": ..., "times": [s, ...], "out": ...}]. OUT becomes an NPZ in metres, glTF's axes: `names`
and `parents` of the joints, `heads` (J, 3), `rest` (V, 3), `weights` (V, J), `clips`, and for clip number N `heads_N`
(T, J, 3), `turns_N` (T, J, 3, 3) and `posed_N` (T, V, 3). Vertices are those of all meshes, sorted by their names.
"""

import json
import sys

import bpy
import numpy as np

AXES = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def world(thing, local):
    matrix = np.array(thing.matrix_world)
    return (local @ matrix[:3, :3].T + matrix[:3, 3]) @ AXES.T


def vertices(thing, mesh):
    local = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("co", local)
    return world(thing, local.reshape(-1, 3).astype(float))


def play(job):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.fbx(filepath=job["fbx"], anim_offset=0.0)
    scene = bpy.context.scene
    fps = scene.render.fps / scene.render.fps_base
    meshes = sorted((thing for thing in bpy.data.objects if thing.type == "MESH"), key=lambda thing: thing.name)
    armature = next((thing for thing in bpy.data.objects if thing.type == "ARMATURE"), None)
    out = {"rest": np.concatenate([vertices(thing, thing.data) for thing in meshes])}
    bones = list(armature.data.bones) if armature else []
    names = [bone.name for bone in bones]
    out["names"] = np.array(names)
    out["parents"] = np.array([bone.parent.name if bone.parent else "" for bone in bones])
    out["heads"] = (
        world(armature, np.array([bone.matrix_local.translation for bone in bones])) if bones else np.zeros((0, 3))
    )
    weights = np.zeros((len(out["rest"]), len(names)))
    start = 0
    for thing in meshes:
        groups = {group.index: names.index(group.name) for group in thing.vertex_groups if group.name in names}
        for number, vertex in enumerate(thing.data.vertices):
            for entry in vertex.groups:
                weights[start + number, groups[entry.group]] += entry.weight
        start += len(thing.data.vertices)
    out["weights"] = weights
    out["images"] = np.array(sum(image.size[0] > 0 for image in bpy.data.images))
    out["materials"] = np.array(sorted(material.name for material in bpy.data.materials))
    actions = list(bpy.data.actions)
    out["clips"] = np.array([action.name for action in actions])
    for number, action in enumerate(actions):
        for thing in [armature, *(mesh.data.shape_keys for mesh in meshes)]:
            if thing is None:
                continue
            data = thing.animation_data_create()
            slot = next((one for one in action.slots if one.target_id_type == thing.id_type), None)
            if slot is not None:
                data.action, data.action_slot = action, slot
        heads, turns, posed = [], [], []
        for time in job["times"]:
            frame = time * fps
            scene.frame_set(int(np.floor(frame)), subframe=float(frame - np.floor(frame)))
            graph = bpy.context.evaluated_depsgraph_get()
            if armature:
                rig = armature.evaluated_get(graph)
                poses = np.array([pose.matrix for pose in rig.pose.bones])
                heads.append(world(rig, poses[:, :3, 3]))
                linear = AXES @ np.array(rig.matrix_world)[:3, :3] @ poses[:, :3, :3]
                turns.append(linear / np.linalg.norm(linear, axis=1, keepdims=True))
            here = []
            for thing in meshes:
                evaluated = thing.evaluated_get(graph)
                here.append(vertices(evaluated, evaluated.to_mesh()))
                evaluated.to_mesh_clear()
            posed.append(np.concatenate(here))
        out[f"heads_{number}"], out[f"turns_{number}"] = np.array(heads), np.array(turns)
        out[f"posed_{number}"] = np.array(posed)
    np.savez(job["out"], **out)


with open(sys.argv[-1]) as file:
    for one in json.load(file):
        play(one)
