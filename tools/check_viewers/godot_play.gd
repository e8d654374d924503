extends SceneTree
# Opens GLBs with Godot's own reader, as a game does, and writes where their vertices are at some times.
#
# godot --headless --script godot_play.gd -- JOBS.json
#
# JOBS is [{"glb": ..., "times": [s, ...], "fps": N, "out": ..., "clip": N}]. OUT gets little-endian 32-bit floats: for each time, for
# each surface, x, y and z of each vertex in the world; OUT.json lists the surfaces.


func _initialize() -> void:
	_run.call_deferred()


func _run() -> void:
	# Games have it from the start, the editor's program has not.
	GLTFDocument.register_gltf_document_extension(GLTFDocumentExtensionConvertImporterMesh.new())
	var jobs: Array = JSON.parse_string(FileAccess.get_file_as_string(OS.get_cmdline_user_args()[0]))
	for job: Dictionary in jobs:
		_play(job)
	quit()


func _play(job: Dictionary) -> void:
	var document := GLTFDocument.new()
	var state := GLTFState.new()
	var failed := document.append_from_file(job["glb"], state)
	if failed:
		printerr("%s: %s" % [job["glb"], error_string(failed)])
		quit(1)
		return
	var scene := document.generate_scene(state, job["fps"])
	root.add_child(scene)
	var player: AnimationPlayer = scene.find_children("*", "AnimationPlayer")[0]
	var names := PackedStringArray()
	for index in state.animations.size():
		names.append(state.animations[index].get_name())
	player.play(names[int(job["clip"])])
	player.pause()
	var meshes := scene.find_children("*", "MeshInstance3D", true, false)
	var out := FileAccess.open(job["out"], FileAccess.WRITE)
	var listed := []
	for time: float in job["times"]:
		player.seek(time, true)
		for number in meshes.size():
			for surface in _posed(meshes[number]):
				if time == job["times"][0]:
					listed.append({"mesh": number, "count": surface.size()})
				out.store_buffer(surface.to_byte_array())
	out.close()
	FileAccess.open(job["out"] + ".json", FileAccess.WRITE).store_string(JSON.stringify(listed))
	scene.free()


## The vertices of each surface in the world: morphed by Godot, and skinned here by its skeleton, binds and weights, for
## without a window Godot has no skeleton to bake.
func _posed(instance: MeshInstance3D) -> Array[PackedVector3Array]:
	var mesh: ArrayMesh = instance.mesh
	if mesh.get_blend_shape_count():
		mesh = instance.bake_mesh_from_current_blend_shape_mix()
	var bones := _bones(instance)
	var out: Array[PackedVector3Array] = []
	for surface in mesh.get_surface_count():
		var points: PackedVector3Array = mesh.surface_get_arrays(surface)[Mesh.ARRAY_VERTEX]
		var bound := instance.mesh.surface_get_arrays(surface)
		if bones.is_empty() or bound[Mesh.ARRAY_BONES] == null:
			out.append(instance.global_transform * points)
			continue
		var which: PackedInt32Array = bound[Mesh.ARRAY_BONES]
		var weights: PackedFloat32Array = bound[Mesh.ARRAY_WEIGHTS]
		var most := weights.size() / points.size()
		for vertex in points.size():
			var place := Vector3.ZERO
			for one in range(vertex * most, (vertex + 1) * most):
				place += weights[one] * (bones[which[one]] * points[vertex])
			points[vertex] = place
		out.append(points)
	return out


## What each bind of a mesh's skin does to a vertex at the moment; none where it has no skin.
func _bones(instance: MeshInstance3D) -> Array[Transform3D]:
	var out: Array[Transform3D] = []
	var skeleton := instance.get_node_or_null(instance.skeleton) as Skeleton3D
	if skeleton and instance.skin:
		for bind in instance.skin.get_bind_count():
			var bone := instance.skin.get_bind_bone(bind)
			if bone < 0:
				bone = skeleton.find_bone(instance.skin.get_bind_name(bind))
			var pose := skeleton.get_bone_global_pose(bone)
			out.append(skeleton.global_transform * pose * instance.skin.get_bind_pose(bind))
	return out
