# Bunraku for Blender: a sentence becomes an action of the selected mesh.
#
# `bunraku blender-addon` writes this file; install it in Blender (Preferences, Add-ons, Install from Disk) and start
# `bunraku studio`. The add-on sends the selected mesh to the studio of this machine and brings back what it made: an
# armature of handles with an action, and the weights of the mesh. It needs nothing but Blender.

# SPDX-License-Identifier: Apache-2.0

import importlib
import json
import os
import tempfile
import time
import urllib.error
import urllib.parse
import urllib.request

bpy = importlib.import_module("bpy")  # Blender's own; the package itself needs none

__all__ = ["register", "unregister"]

bl_info = {
    "name": "Bunraku",
    "description": "A sentence animates the selected mesh, by the studio on this machine",
    "author": "The Bunraku authors",
    "version": (0, 1, 0),
    "blender": (4, 0, 0),
    "location": "3D View > Sidebar > Bunraku",
    "category": "Animation",
}

SECONDS = 600.0


class StudioError(Exception):
    """What the studio, or the way to it, has to say."""


def ask(address, method, path, data=None):
    """The bytes that the studio answers with."""
    base, _, token = address.strip().partition("/#token=")
    if not token or not base.startswith(("http://localhost", "http://127.0.0.1")):
        raise StudioError("copy the whole address that `bunraku studio` printed, with its token")
    request = urllib.request.Request(f"{base}/api{path}", data=data, method=method)
    request.add_header("authorization", f"Bearer {token}")
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            return answer.read()
    except urllib.error.HTTPError as error:
        try:
            sentence = json.loads(error.read())["error"]
        except (ValueError, KeyError):
            sentence = f"the studio answered {error.code}"
        raise StudioError(sentence) from None
    except OSError:
        raise StudioError("the studio does not answer; start it with: bunraku studio") from None


def call(address, method, path, body=None):
    """The JSON that the studio answers with."""
    return json.loads(ask(address, method, path, None if body is None else json.dumps(body).encode()))


def ended(address, job):
    """Wait for a job."""
    end = time.monotonic() + SECONDS
    while time.monotonic() < end:
        job_state = call(address, "GET", f"/jobs/{job}")
        if job_state["state"] == "done":
            return
        if job_state["state"] not in ("waiting", "running"):
            raise StudioError(job_state["error"] or f"the job was {job_state['state']}")
        time.sleep(0.2)
    raise StudioError("the studio takes too long")


def export_mesh(context, target, path):
    """Write one object as GLB, alone, without its modifiers' armature and without animation."""
    chosen = [chosen_object for chosen_object in context.view_layer.objects if chosen_object.select_get()]
    active = context.view_layer.objects.active
    bpy.ops.object.select_all(action="DESELECT")
    target.select_set(True)
    context.view_layer.objects.active = target
    try:
        how = {"export_format": "GLB", "export_animations": False, "export_skins": False, "export_yup": True}
        bpy.ops.export_scene.gltf(filepath=path, use_selection=True, **how)
    finally:
        bpy.ops.object.select_all(action="DESELECT")
        for chosen_object in chosen:
            chosen_object.select_set(True)
        context.view_layer.objects.active = active


def import_take(context, path):
    """The armature and meshes of a GLB."""
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=path)
    imported = [candidate for candidate in bpy.data.objects if candidate not in before]
    armature = next((candidate for candidate in imported if candidate.type == "ARMATURE"), None)
    if armature is None:
        raise StudioError("the studio's file holds no armature; update Bunraku")
    skinned = [candidate for candidate in imported if candidate.type == "MESH" and candidate.vertex_groups]
    return armature, skinned, imported


def nearest_weights(source, target):
    """Give a mesh the vertex groups of another one at the same position, each vertex those of the nearest."""
    tree = importlib.import_module("mathutils.kdtree").KDTree(len(source.data.vertices))
    for vertex in source.data.vertices:
        tree.insert(source.matrix_world @ vertex.co, vertex.index)
    tree.balance()
    names = [group.name for group in source.vertex_groups]
    for name in names:
        old = target.vertex_groups.get(name)
        if old:
            target.vertex_groups.remove(old)
    groups = [target.vertex_groups.new(name=name) for name in names]
    for vertex in target.data.vertices:
        _, index, _ = tree.find(target.matrix_world @ vertex.co)
        for member in source.data.vertices[index].groups:
            groups[member.group].add([vertex.index], member.weight, "REPLACE")


def animate(context, target, address, prompt, seconds, seed):
    """Make the action and hang the mesh on its armature; the armature comes back."""
    with tempfile.TemporaryDirectory() as folder:
        mesh = os.path.join(folder, "mesh.glb")
        export_mesh(context, target, mesh)
        with open(mesh, "rb") as file:
            data = file.read()
        name = urllib.parse.quote(f"{target.name}.glb")
        upload = json.loads(ask(address, "POST", f"/characters?name={name}", data))
        character = upload["character"]["id"]
        try:
            ended(address, upload["job"])
            # Blender's own axes are known: nothing is to be guessed of a mesh that comes from it.
            turned = call(address, "PATCH", f"/characters/{character}", {"up": "+y", "front": "+z", "unit": "m"})
            if "job" in turned:
                ended(address, turned["job"])
            take = call(address, "POST", f"/characters/{character}/takes", {
                "script": [{"text": prompt, "seconds": seconds}], "seeds": [seed], "draft": False,
            })  # fmt: skip
            ended(address, take["job"])
            written = call(
                address, "POST", f"/takes/{take['takes'][0]}/exports",
                {"format": "glb", "fps": context.scene.render.fps},
            )  # fmt: skip
            ended(address, written["job"])
            result = os.path.join(folder, "take.glb")
            with open(result, "wb") as file:
                file.write(ask(address, "GET", f"/exports/{written['export']}"))
        finally:
            call(address, "DELETE", f"/characters/{character}")
        armature, skinned, made_objects = import_take(context, result)
    if not skinned:
        raise StudioError("the studio's file holds no skinned mesh; update Bunraku")
    armature.name = f"{target.name} handles"
    bpy.context.view_layer.update()
    source = max(skinned, key=lambda one: len(one.data.vertices))
    armature.data.pose_position = "REST"
    bpy.context.view_layer.update()
    nearest_weights(source, target)
    armature.data.pose_position = "POSE"
    for modifier in [one for one in target.modifiers if one.type == "ARMATURE"]:
        target.modifiers.remove(modifier)
    matrix = target.matrix_world.copy()
    target.parent = armature
    target.matrix_world = matrix
    target.modifiers.new("Bunraku", "ARMATURE").object = armature
    if armature.animation_data and armature.animation_data.action:
        armature.animation_data.action.name = prompt[:60]
        context.scene.frame_end = max(context.scene.frame_end, int(armature.animation_data.action.frame_range[1]))
    for one in made_objects:
        if one is not armature:
            bpy.data.objects.remove(one)
    return armature


class BunrakuSettings(bpy.types.PropertyGroup):
    """What the panel shows."""

    address: bpy.props.StringProperty(name="Studio", description="The address that `bunraku studio` printed")
    prompt: bpy.props.StringProperty(name="Sentence", default="walks forward, then waves with the left hand")
    seconds: bpy.props.FloatProperty(name="Seconds", default=4.0, min=0.5, max=120.0)
    seed: bpy.props.IntProperty(name="Seed", default=0, min=0)


class BUNRAKU_OT_animate(bpy.types.Operator):
    """Let the selected mesh do what the sentence says"""

    bl_idname = "bunraku.animate"
    bl_label = "Animate"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 -- Blender wants a set here

    @classmethod
    def poll(cls, context):
        active = context.view_layer.objects.active
        return active is not None and active.type == "MESH" and context.mode == "OBJECT"

    def execute(self, context):
        settings = context.scene.bunraku
        target = context.view_layer.objects.active
        try:
            animate(context, target, settings.address, settings.prompt, settings.seconds, settings.seed)
        except StudioError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{target.name}: {settings.prompt}")
        return {"FINISHED"}


class BUNRAKU_PT_panel(bpy.types.Panel):
    """The panel in the sidebar of the 3D view."""

    bl_label = "Bunraku"
    bl_idname = "BUNRAKU_PT_panel"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Bunraku"

    def draw(self, context):
        settings = context.scene.bunraku
        column = self.layout.column()
        column.prop(settings, "address")
        column.prop(settings, "prompt", text="")
        row = column.row()
        row.prop(settings, "seconds")
        row.prop(settings, "seed")
        column.operator("bunraku.animate")


CLASSES = (BunrakuSettings, BUNRAKU_OT_animate, BUNRAKU_PT_panel)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.bunraku = bpy.props.PointerProperty(type=BunrakuSettings)


def unregister():
    del bpy.types.Scene.bunraku
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)


if __name__ == "__main__":
    register()
