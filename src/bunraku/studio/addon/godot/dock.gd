@tool
extends VBoxContainer
# The panel: a file of the project or a node of the scene, a sentence, and what came of it.

# SPDX-License-Identifier: Apache-2.0

const Studio := preload("studio.gd")

var _studio: Node
var _address := LineEdit.new()
var _sentence := LineEdit.new()
var _seconds := SpinBox.new()
var _seed := SpinBox.new()
var _button := Button.new()
var _said := Label.new()


func _ready() -> void:
	_studio = Studio.new()
	add_child(_studio)
	_studio.told.connect(_say)
	_address.placeholder_text = "the address that `bunraku studio` prints"
	var settings := EditorInterface.get_editor_settings()
	_address.text = settings.get_project_metadata("bunraku", "address", "")
	_sentence.text = "walks forward"
	_seconds.min_value = 0.5
	_seconds.max_value = 120.0
	_seconds.step = 0.5
	_seconds.value = 4.0
	_seconds.suffix = "s"
	_seed.max_value = 2147483647.0
	_seed.prefix = "seed"
	_button.text = "Animate"
	_button.pressed.connect(_animate)
	_said.autowrap_mode = TextServer.AUTOWRAP_WORD_SMART
	_say("Choose a mesh in the file system, or a node of the scene.")
	for one: Control in [_address, _sentence, _seconds, _seed, _button, _said]:
		add_child(one)


func _say(text: String) -> void:
	_said.text = text


func _animate() -> void:
	_button.disabled = true
	var settings := EditorInterface.get_editor_settings()
	settings.set_project_metadata("bunraku", "address", _address.text)
	var source := _source()
	if source.is_empty():
		_say("choose a mesh in the file system (%s), or a node" % ", ".join(Studio.READS))
	else:
		await _make(source)
	_button.disabled = false


func _make(source: Dictionary) -> void:
	var sentences := [{"text": _sentence.text, "seconds": _seconds.value}]
	var made: PackedByteArray = await _studio.animate(
		_address.text, source["name"], source["data"], sentences, int(_seed.value)
	)
	if _studio.wrong:
		_say(_studio.wrong)
		return
	var words := _sentence.text.to_lower().replace(" ", "-").validate_filename()
	var folder: String = source["folder"]
	var path := folder.path_join("%s-%s.glb" % [source["name"].get_basename(), words.left(40)])
	var file := FileAccess.open(path, FileAccess.WRITE)
	if file == null:
		_say("%s: %s" % [path, error_string(FileAccess.get_open_error())])
		return
	file.store_buffer(made)
	file.close()
	EditorInterface.get_resource_filesystem().scan()
	_say("%s: drag it into the scene; its AnimationPlayer holds the clip" % path)


## The mesh that is chosen: its name, its bytes, and the folder where what is made of it goes.
func _source() -> Dictionary:
	for path in EditorInterface.get_selected_paths():
		if path.get_extension().to_lower() in Studio.READS:
			return {
				"name": path.get_file(),
				"data": FileAccess.get_file_as_bytes(path),
				"folder": path.get_base_dir(),
			}
	for node in EditorInterface.get_selection().get_selected_nodes():
		if node is Node3D:
			var data := _written(node)
			if not data.is_empty():
				return {"name": "%s.glb" % node.name, "data": data, "folder": "res://"}
	return {}


## A node as GLB, without what stands around it.
func _written(node: Node3D) -> PackedByteArray:
	var copy: Node3D = node.duplicate()
	copy.transform = Transform3D.IDENTITY
	var document := GLTFDocument.new()
	var state := GLTFState.new()
	var failed := document.append_from_scene(copy, state)
	copy.queue_free()
	return PackedByteArray() if failed else document.generate_buffer(state)
