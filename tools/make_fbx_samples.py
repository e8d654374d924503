"""Make the FBX files that the tests read, with Blender as a Python module, and write down where Blender has their
vertices.

Run it with any Python that has `bpy` (tried with 5.0.1; it is no dependency of Bunraku, and needs an environment of its
own):

    python tools/make_fbx_samples.py tests/files/data

It writes a man of boxes with Mixamo's names for his bones and a short clip: once +Z up in centimetres, once +Y up in
metres, and once without the mesh, all packed by gzip. `boxman.npz` holds the rest pose and the posed vertices as
Blender evaluates them, in Blender's frame.
"""

from __future__ import annotations

import gzip
import struct
import sys
import tempfile
import zlib
from math import pi
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

BONES: dict[str, tuple[str, tuple[float, float, float], tuple[float, float, float], float]] = {
    "Hips": ("", (0, 0, 0.95), (0, 0, 1.1), 0.14),
    "Spine": ("Hips", (0, 0, 1.1), (0, 0, 1.45), 0.13),
    "Head": ("Spine", (0, 0.01, 1.5), (0, 0.01, 1.75), 0.1),
    "LeftArm": ("Spine", (0.18, 0, 1.4), (0.45, 0, 1.4), 0.05),
    "LeftForeArm": ("LeftArm", (0.45, 0, 1.4), (0.7, -0.02, 1.4), 0.04),
    "LeftHand": ("LeftForeArm", (0.7, -0.02, 1.4), (0.85, -0.03, 1.4), 0.03),
    "LeftUpLeg": ("Hips", (0.1, 0, 0.95), (0.1, -0.02, 0.5), 0.07),
    "LeftLeg": ("LeftUpLeg", (0.1, -0.02, 0.5), (0.1, 0.02, 0.1), 0.05),
    "LeftFoot": ("LeftLeg", (0.1, 0.02, 0.1), (0.1, -0.15, 0.03), 0.04),
}
POSES: dict[str, tuple[float, float, float]] = {
    "Spine": (0.1, 0.4, -0.05), "Head": (-0.2, -0.3, 0.1), "LeftArm": (0.9, 0.2, -0.4), "RightArm": (-0.3, 0.5, 0.9),
    "LeftForeArm": (0.3, -0.6, 1.1), "RightForeArm": (0.1, 0.2, -0.8), "LeftUpLeg": (0.8, 0.1, 0.05),
    "RightUpLeg": (-0.5, 0, -0.1),
    "LeftLeg": (-0.9, 0, 0), "RightLeg": (-0.3, 0.05, 0), "LeftFoot": (0.4, 0.1, 0), "LeftHand": (0.2, 0.7, 0.3),
}  # fmt: skip
FRAMES, FPS = 13, 24


def bones() -> dict[str, tuple[str, Vector, Vector, float]]:
    """All bones, the right ones as mirror images."""
    out = {}
    for name, (parent, head, tail, width) in BONES.items():
        out[name] = (parent, Vector(head), Vector(tail), width)
        if name.startswith("Left"):
            flip = Vector((-1, 1, 1))
            out[name.replace("Left", "Right")] = (
                parent.replace("Left", "Right"),
                Vector(head) * flip,
                Vector(tail) * flip,
                width,
            )
    return out


def build(folder: Path) -> tuple[bpy.types.Object, bpy.types.Object]:
    """The armature and its mesh: one box a bone, whose first end is shared with the parent."""
    armature = bpy.data.objects.new("Armature", bpy.data.armatures.new("Armature"))
    bpy.context.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    vertices, faces, weights = [], [], []
    for name, (parent, head, tail, width) in bones().items():
        bone = armature.data.edit_bones.new(f"mixamorig:{name}")
        bone.head, bone.tail = head, tail
        if parent:
            bone.parent = armature.data.edit_bones[f"mixamorig:{parent}"]
        along = (tail - head).normalized()
        side = along.cross(Vector((0, 1, 0))).normalized()
        front = side.cross(along)
        first = len(vertices)
        for end in (head, tail):
            for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
                vertices.append(end + width * (a * side + b * front))
                weights.append([(name, 0.6), (parent, 0.4)] if parent and end is head else [(name, 1.0)])
        quads = [(0, 1, 2, 3), (7, 6, 5, 4), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)]
        faces += [[first + corner for corner in quad] for quad in quads]
    bpy.ops.object.mode_set(mode="OBJECT")
    mesh = bpy.data.meshes.new("Body")
    mesh.from_pydata(vertices, [], faces)
    layer = mesh.uv_layers.new(name="UVMap")
    for number, loop in enumerate(layer.data):
        loop.uv = ((number % 4 in (1, 2)) * 0.5, (number % 4 > 1) * 1.0)
    for number, name in enumerate(("Skin", "Cloth")):
        material = bpy.data.materials.new(name)
        material.use_nodes = True
        shader = material.node_tree.nodes["Principled BSDF"]
        shader.inputs["Base Color"].default_value = (0.8, 0.5, 0.3, 1) if number == 0 else (1, 1, 1, 1)
        if number:
            texture = material.node_tree.nodes.new("ShaderNodeTexImage")
            texture.image = bpy.data.images.load(str(checker(folder / "boxman_cloth.png")))
            material.node_tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
        mesh.materials.append(material)
    for number, polygon in enumerate(mesh.polygons):
        polygon.material_index = number % 6 > 1
    body = bpy.data.objects.new("Body", mesh)
    bpy.context.collection.objects.link(body)
    for vertex, shares in enumerate(weights):
        for bone, share in shares:
            group = body.vertex_groups.get(f"mixamorig:{bone}") or body.vertex_groups.new(name=f"mixamorig:{bone}")
            group.add([vertex], share, "REPLACE")
    body.parent = armature
    body.modifiers.new("Armature", "ARMATURE").object = armature
    return armature, body


def checker(path: Path) -> Path:
    """A PNG of 8 x 8 squares, red on the left half and blue on the right."""
    rows = b"".join(b"\0" + bytes([200, 40, 30] * 4 + [30, 60, 200] * 4) for _ in range(8))

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 8, 8, 8, 2, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    )
    return path


def animate(armature: bpy.types.Object) -> None:
    """A clip of half a second, named "Wave"."""
    scene = bpy.context.scene
    scene.name = "Wave"  # which is what the exporter calls the only clip
    scene.render.fps, scene.frame_start, scene.frame_end = FPS, 0, FRAMES - 1
    for frame in (0, 6, 12):
        amount = (0.2, 1.0, -0.6)[frame // 6]
        for name, angles in POSES.items():
            bone = armature.pose.bones[f"mixamorig:{name}"]
            bone.rotation_mode = "XYZ"
            bone.rotation_euler = [amount * angle for angle in angles]
            bone.keyframe_insert("rotation_euler", frame=frame)
        hips = armature.pose.bones["mixamorig:Hips"]
        hips.rotation_mode = "QUATERNION"
        hips.location = (0.05 * amount, 0.1 * amount, 0.02 * frame)
        hips.rotation_quaternion = (
            Vector((0.1, 1, 0.2))
            .to_track_quat("Y", "Z")
            .slerp(hips.rotation_quaternion.__class__(), 1 - 0.3 * abs(amount))
        )
        hips.keyframe_insert("location", frame=frame)
        hips.keyframe_insert("rotation_quaternion", frame=frame)


def posed(body: bpy.types.Object, frame: int) -> np.ndarray:
    """World positions of the vertices at a frame, as Blender evaluates them [m], shape (V, 3)."""
    bpy.context.scene.frame_set(frame)
    evaluated = body.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return np.array([evaluated.matrix_world @ vertex.co for vertex in evaluated.data.vertices])


def main(folder: Path) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        armature, body = build(Path(scratch))
        armature.rotation_euler = (0, 0, pi / 6)  # the whole character stands turned and away from the middle
        armature.location = (0.3, -0.2, 0.1)
        bpy.context.view_layer.update()
        rest = np.array([body.matrix_world @ vertex.co for vertex in body.data.vertices])
        animate(armature)
        frames = np.arange(0, FRAMES, 3)
        expected = np.stack([posed(body, int(frame)) for frame in frames])
        np.savez_compressed(
            folder / "boxman.npz",
            rest=rest.astype(np.float32),
            posed=expected.astype(np.float32),
            times=(frames / FPS).astype(np.float32),
        )
        bpy.context.scene.frame_set(5)  # the objects of the files stand in the middle of the clip
        common = {
            "bake_anim_simplify_factor": 0.0,
            "add_leaf_bones": False,
            "bake_anim_use_all_actions": False,
            "bake_anim_use_nla_strips": False,
        }
        bpy.ops.export_scene.fbx(
            filepath=str(folder / "boxman_z_up_cm.fbx"),
            axis_forward="-Y",
            axis_up="Z",
            path_mode="COPY",
            embed_textures=True,
            **common,
        )
        bpy.ops.export_scene.fbx(
            filepath=str(folder / "boxman_y_up_m.fbx"),
            apply_scale_options="FBX_SCALE_UNITS",
            path_mode="STRIP",
            **common,
        )
        bpy.ops.export_scene.fbx(filepath=str(folder / "boxman_motion.fbx"), object_types={"ARMATURE"}, **common)
    for name in ("boxman_z_up_cm", "boxman_y_up_m", "boxman_motion"):
        file = folder / f"{name}.fbx"
        (folder / f"{name}.fbx.gz").write_bytes(gzip.compress(file.read_bytes(), mtime=0))
        file.unlink()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
