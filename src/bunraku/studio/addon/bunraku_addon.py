# Bunraku for Blender: a sentence becomes an action of the selected meshes.
#
# `bunraku blender-addon` writes this file; install it in Blender (Preferences, Add-ons, Install from Disk) and start
# `bunraku studio`. The add-on sends the selected meshes, as one character, to the studio of this machine and brings
# back what it made: an armature of handles with an action, and the weights of the meshes. Blender goes on meanwhile.
# What the add-on made before for the same meshes is replaced. It needs nothing but Blender.

# SPDX-License-Identifier: Apache-2.0

import importlib
import json
import os
import tempfile
import threading
import time
import urllib.error
import urllib.parse
import urllib.request

bpy = importlib.import_module("bpy")  # Blender's own; the package itself needs none

bl_info = {
    "name": "Bunraku",
    "description": "A sentence animates the selected meshes, by the studio on this machine",
    "author": "The Bunraku authors",
    "version": (0, 2, 0),
    "blender": (4, 0, 0),
    "location": "3D View > Sidebar > Bunraku",
    "category": "Animation",
}

SECONDS = 600.0
"""For which a job may go on."""
MARK = "bunraku"
"""The property of armatures that the add-on made."""


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


class Work(threading.Thread):
    """What is asked of the studio for one action. It runs beside Blender and touches nothing of it.

    `stage` and `done` say how far it is; in the end there is a `result`, the bytes of a GLB, or an `error`.
    """

    def __init__(self, address, mesh, name, prompt, seconds, seed, fps):
        super().__init__(daemon=True)
        self.address, self.mesh, self.name = address, mesh, name
        self.script = [{"text": prompt, "seconds": seconds}]
        self.seed, self.fps = seed, fps
        self.stage, self.done, self.result, self.error, self.stopped = "send", 0.0, None, "", False

    def run(self):
        try:
            self.result = self.made()
        except StudioError as error:
            self.error = str(error)
        except Exception as error:  # or Blender would wait for good
            self.error = f"the studio gave an answer that is not understood ({error}); update Bunraku"

    def made(self):
        """The GLB of the take."""
        name = urllib.parse.quote(f"{self.name}.glb")
        made = json.loads(ask(self.address, "POST", f"/characters?name={name}", self.mesh))
        character = made["character"]["id"]
        try:
            self.ended(made["job"])
            # Blender's own axes are known: nothing is to be guessed of a mesh that comes from it.
            how = {"up": "+y", "front": "+z", "unit": "m"}
            turned = call(self.address, "PATCH", f"/characters/{character}", how)
            if "job" in turned:
                self.ended(turned["job"])
            asked = {"script": self.script, "seeds": [self.seed], "draft": False}
            take = call(self.address, "POST", f"/characters/{character}/takes", asked)
            self.ended(take["job"])
            path = f"/takes/{take['takes'][0]}/exports"
            written = call(self.address, "POST", path, {"format": "glb", "fps": self.fps})
            self.ended(written["job"])
            return ask(self.address, "GET", f"/exports/{written['export']}")
        finally:
            call(self.address, "DELETE", f"/characters/{character}")

    def ended(self, job):
        """Wait for a job."""
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            found = call(self.address, "GET", f"/jobs/{job}")
            self.stage, self.done = found["stage"] or found["state"], found["done"]
            if found["state"] == "done":
                return
            if found["state"] not in ("waiting", "running"):
                raise StudioError(found["error"] or f"the job was {found['state']}")
            if self.stopped:
                call(self.address, "DELETE", f"/jobs/{job}")
                raise StudioError("cancelled")
            time.sleep(0.2)
        raise StudioError("the studio takes too long")


def of_bunraku(item):
    """Whether an object is an armature that this add-on made."""
    return item is not None and item.type == "ARMATURE" and MARK in item


def armatures_of(target):
    """The armatures of this add-on that move a mesh."""
    return [item.object for item in target.modifiers if item.type == "ARMATURE" and of_bunraku(item.object)]


def meshes_of(context):
    """The meshes that are selected, and those that selected armatures of this add-on move."""
    active = context.view_layer.objects.active
    chosen = [item for item in context.view_layer.objects if item.select_get()] or [active]
    moved = [
        item for item in context.view_layer.objects if item.type == "MESH" and set(armatures_of(item)) & set(chosen)
    ]
    return [item for item in chosen if item is not None and item.type == "MESH"] or moved


def export_meshes(context, targets):
    """The bytes of a GLB of some meshes, alone and without animation."""
    chosen = [item for item in context.view_layer.objects if item.select_get()]
    active = context.view_layer.objects.active
    bpy.ops.object.select_all(action="DESELECT")
    for target in targets:
        target.select_set(True)
    context.view_layer.objects.active = targets[0]
    try:
        how = {"export_format": "GLB", "export_animations": False, "export_skins": False, "export_yup": True}
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "mesh.glb")
            bpy.ops.export_scene.gltf(filepath=path, use_selection=True, **how)
            with open(path, "rb") as file:
                return file.read()
    finally:
        select(context, chosen, active)


def select(context, chosen, active):
    """Select these objects alone."""
    bpy.ops.object.select_all(action="DESELECT")
    for item in chosen:
        item.select_set(True)
    context.view_layer.objects.active = active


def import_take(data):
    """The armature and meshes of a GLB."""
    before = set(bpy.data.objects)
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "take.glb")
        with open(path, "wb") as file:
            file.write(data)
        bpy.ops.import_scene.gltf(filepath=path)
    made = [item for item in bpy.data.objects if item not in before]
    armature = next((item for item in made if item.type == "ARMATURE"), None)
    if armature is None:
        raise StudioError("the studio's file holds no armature; update Bunraku")
    skinned = [item for item in made if item.type == "MESH" and item.vertex_groups]
    return armature, skinned, made


def nearest_weights(sources, target):
    """Give a mesh the vertex groups of others at the same position, each vertex those of the nearest."""
    points = [(source, vertex) for source in sources for vertex in source.data.vertices]
    tree = importlib.import_module("mathutils.kdtree").KDTree(len(points))
    for number, (source, vertex) in enumerate(points):
        tree.insert(source.matrix_world @ vertex.co, number)
    tree.balance()
    names = list(dict.fromkeys(group.name for source in sources for group in source.vertex_groups))
    for name in names:
        old = target.vertex_groups.get(name)
        if old:
            target.vertex_groups.remove(old)
    groups = {name: target.vertex_groups.new(name=name) for name in names}
    for vertex in target.data.vertices:
        _, number, _ = tree.find(target.matrix_world @ vertex.co)
        source, nearest = points[number]
        for member in nearest.groups:
            name = source.vertex_groups[member.group].name
            groups[name].add([vertex.index], member.weight, "REPLACE")


def hang(context, targets, data, prompt):
    """Hang the meshes on the armature of a GLB, in place of those that this add-on made for them before."""
    chosen = [item for item in context.view_layer.objects if item.select_get()]
    active = context.view_layer.objects.active
    armature, skinned, made = import_take(data)
    if not skinned:
        raise StudioError("the studio's file holds no skinned mesh; update Bunraku")
    armature.name = f"{targets[0].name} handles"
    armature[MARK] = True
    armature.data.pose_position = "REST"
    bpy.context.view_layer.update()
    earlier = {item for target in targets for item in armatures_of(target)}
    for target in targets:
        nearest_weights(skinned, target)
        for modifier in [item for item in target.modifiers if item.type == "ARMATURE"]:
            target.modifiers.remove(modifier)
        matrix = target.matrix_world.copy()
        target.parent = armature
        target.matrix_world = matrix
        target.modifiers.new("Bunraku", "ARMATURE").object = armature
    armature.data.pose_position = "POSE"
    gone = [item for item in made if item is not armature]
    gone += [item for item in earlier if not any(item in armatures_of(mesh) for mesh in bpy.data.objects)]
    kept = [item for item in (*chosen, *targets) if item not in gone]
    active = active if active is not None and active not in gone else targets[0]
    for item in gone:
        action = item.animation_data.action if item.animation_data else None
        bpy.data.objects.remove(item)
        if action is not None and not action.users:
            bpy.data.actions.remove(action)
    if armature.animation_data and armature.animation_data.action:
        armature.animation_data.action.name = prompt[:60]
        context.scene.frame_end = max(context.scene.frame_end, int(armature.animation_data.action.frame_range[1]))
    select(context, kept, active)
    return armature


class BunrakuSettings(bpy.types.PropertyGroup):
    """What the panel shows."""

    address: bpy.props.StringProperty(name="Studio", description="The address that `bunraku studio` printed")
    prompt: bpy.props.StringProperty(name="Sentence", default="walks forward, then waves with the left hand")
    seconds: bpy.props.FloatProperty(name="Seconds", description="0: what fits", default=0.0, min=0.0, max=120.0)
    seed: bpy.props.IntProperty(name="Seed", default=0, min=0)


class BUNRAKU_OT_animate(bpy.types.Operator):
    """Let the selected meshes do what the sentence says; Escape stops it"""

    bl_idname = "bunraku.animate"
    bl_label = "Animate"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 -- Blender wants a set here

    running = None
    """The work that goes on."""

    @classmethod
    def poll(cls, context):
        return context.mode == "OBJECT" and cls.running is None and bool(meshes_of(context))

    def begin(self, context):
        """Send the meshes."""
        settings = context.scene.bunraku
        self.targets, self.prompt = meshes_of(context), settings.prompt
        mesh, fps = export_meshes(context, self.targets), context.scene.render.fps
        named = self.targets[0].name
        self.work = Work(settings.address, mesh, named, settings.prompt, settings.seconds, settings.seed, fps)
        self.work.start()

    def finish(self, context):
        """Take in what came of it."""
        try:
            if self.work.error:
                raise StudioError(self.work.error)
            targets = [item for item in self.targets if item.name in context.view_layer.objects]
            if not targets:
                raise StudioError("the meshes are gone")
            hang(context, targets, self.work.result, self.prompt)
        except (StudioError, ReferenceError) as error:  # the second: a mesh was deleted meanwhile
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{targets[0].name}: {self.prompt}")
        return {"FINISHED"}

    def execute(self, context):
        """Wait for the studio; scripts call this, and so does Blender without a window."""
        self.begin(context)
        self.work.join()
        return self.finish(context)

    def invoke(self, context, event):
        if bpy.app.background:
            return self.execute(context)
        self.begin(context)
        type(self).running = self.work
        self.timer = context.window_manager.event_timer_add(0.2, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC":
            self.work.stopped = True
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if self.work.is_alive():
            context.workspace.status_text_set(f"Bunraku: {self.work.stage} {self.work.done:.0%}, Escape stops it")
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self.timer)
        context.workspace.status_text_set(None)
        type(self).running = None
        return self.finish(context)


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
        working = BUNRAKU_OT_animate.running is not None
        column.operator("bunraku.animate", text="Working ..." if working else "Animate")


CLASSES = (BunrakuSettings, BUNRAKU_OT_animate, BUNRAKU_PT_panel)


def register():
    for item in CLASSES:
        bpy.utils.register_class(item)
    bpy.types.Scene.bunraku = bpy.props.PointerProperty(type=BunrakuSettings)


def unregister():
    del bpy.types.Scene.bunraku
    for item in reversed(CLASSES):
        bpy.utils.unregister_class(item)


if __name__ == "__main__":
    register()
