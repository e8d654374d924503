extends Node3D
# A character that walks by the keyboard: the studio draws its next poses, and this script shows
# them. Start `bunraku studio --no-browser`, copy the address that it prints into `address`, and
# run the scene.

# SPDX-License-Identifier: Apache-2.0

const SENTENCES: Array[String] = ["waves", "jumps", "dances", "bows"]
## Seconds that are asked for at once, and that are left when more is asked for.
const WINDOW := 1.5
const LEFT := 1.0

## What `bunraku studio` printed, with its token.
@export var address := "http://localhost:8734/#token="
## One of `bunraku samples --list`.
@export var sample := "person"

var _base := ""
var _headers: PackedStringArray
var _session := ""
var _route := ""
var _skeleton: Skeleton3D
var _bones: PackedInt32Array
var _poses: Array[PackedFloat32Array] = []
## The number of the first pose in `_poses`, and the one that is shown, with its fraction.
var _first := 0
var _shown := 0.0
var _fps := 20.0
## Seconds that the last answer took.
var _took := 0.3
var _sentence := "stands still"
var _gait := ""
var _direction := Vector2.ZERO
var _changed := true


func _ready() -> void:
	var parts := address.strip_edges().split("/#token=")
	_base = parts[0] + "/api"
	_headers = ["authorization: Bearer %s" % parts[parts.size() - 1]]
	var opened: Variant = await _json(HTTPClient.METHOD_POST, "/characters?sample=" + sample)
	if opened == null:
		return
	_route = "/characters/%s" % opened["character"]["id"]
	while true:
		var job: Variant = await _json(HTTPClient.METHOD_GET, "/jobs/%s" % opened["job"])
		if job == null or job["state"] in ["failed", "cancelled"]:
			return _say("the character cannot be opened")
		if job["state"] == "done":
			break
		await get_tree().create_timer(0.2).timeout
	if not await _show_mesh():
		return
	_say("arrows: walk   shift: run   1 to 4: %s" % ", ".join(SENTENCES))
	while await _draw_next():
		pass


func _show_mesh() -> bool:
	var mesh: Array = await _ask(HTTPClient.METHOD_GET, _route + "/mesh.glb")
	var reader := GLTFDocument.new()
	var state := GLTFState.new()
	if mesh.is_empty() or reader.append_from_buffer(mesh[1], "", state) != OK:
		return false
	var scene := reader.generate_scene(state)
	add_child(scene)
	_skeleton = scene.find_children("*", "Skeleton3D")[0]
	for joint in state.json["skins"][0]["joints"]:
		var node: GLTFNode = state.get_nodes()[joint]
		_bones.append(_skeleton.find_bone(node.resource_name))
	return true


## Ask for the next poses where few are left or something changed; false where that failed.
func _draw_next() -> bool:
	var left := (_first + _poses.size() - _shown) / _fps
	if not _changed and left > LEFT:
		await get_tree().process_frame
		return true
	var asked := {"session": _session, "seconds": WINDOW}
	if _changed:
		asked["sentence"] = _sentence
		if _session:  # what is shown until the answer is there stays as it is
			var stay := ceili(_shown + (1.5 * _took + 0.05) * _fps)
			asked["start"] = mini(stay, _first + _poses.size())
	if _direction:
		asked["direction"] = [_direction.x, _direction.y]
	_changed = false
	var began := Time.get_ticks_msec()
	var data := JSON.stringify(asked).to_utf8_buffer()
	var answer: Array = await _ask(HTTPClient.METHOD_POST, _route + "/live", data)
	if answer.is_empty():
		return false
	_took = (Time.get_ticks_msec() - began) / 1000.0
	_take(answer[0], answer[1])
	return true


## Put the poses of an answer behind those that stay.
func _take(headers: PackedStringArray, data: PackedByteArray) -> void:
	var number := 0
	for header in headers:
		var pair := header.split(": ")
		if pair[0].to_lower() == "x-bunraku-session":
			_session = pair[1]
		elif pair[0].to_lower() == "x-bunraku-first":
			number = pair[1].to_int()
	var about := data.decode_u32(4)
	var said: Dictionary = JSON.parse_string(data.slice(8, 8 + about).get_string_from_utf8())
	var frames: int = said["frames"]
	var joints: int = said["joints"]
	_fps = said["fps"]
	var values := data.slice(8 + about).to_float32_array()
	_poses.resize(maxi(0, number - _first))
	for frame in frames:
		var pose := values.slice(frame * joints * 3, (frame + 1) * joints * 3)
		var turned := frames * joints * 3 + frame * joints * 4
		pose.append_array(values.slice(turned, turned + joints * 4))
		_poses.append(pose)
	var over := clampi(floori(_shown) - _first, 0, _poses.size())
	_poses = _poses.slice(over)
	_first += over


func _process(delta: float) -> void:
	_read_keys()
	if _poses.is_empty():
		return
	_shown = minf(_shown + delta * _fps, _first + _poses.size() - 1.0)
	var at := maxf(_shown - _first, 0.0)
	var before := _poses[floori(at)]
	var after := _poses[mini(ceili(at), _poses.size() - 1)]
	for joint in _bones.size():
		var from := _place(before, joint)
		var pose := from.interpolate_with(_place(after, joint), at - floorf(at))
		_skeleton.set_bone_pose_position(_bones[joint], pose.origin)
		_skeleton.set_bone_pose_rotation(_bones[joint], pose.basis.get_rotation_quaternion())
	var root := _skeleton.get_bone_global_pose(_bones[0]).origin
	$Camera.position = $Camera.position.lerp(
		Vector3(root.x, 2.6, root.z + 5.0), minf(4.0 * delta, 1)
	)


func _place(pose: PackedFloat32Array, joint: int) -> Transform3D:
	var t := joint * 3
	var q := _bones.size() * 3 + joint * 4
	var rotation_of := Quaternion(pose[q], pose[q + 1], pose[q + 2], pose[q + 3]).normalized()
	return Transform3D(Basis(rotation_of), Vector3(pose[t], pose[t + 1], pose[t + 2]))


func _read_keys() -> void:
	var way := Input.get_vector("ui_left", "ui_right", "ui_up", "ui_down")
	var gait := ""
	if way:
		gait = "runs forward" if Input.is_key_pressed(KEY_SHIFT) else "walks forward"
	if gait != _gait or way.distance_to(_direction) > 0.2:
		_gait = gait
		_direction = way
		_order(gait if gait else "stands still")


func _unhandled_key_input(event: InputEvent) -> void:
	var number: int = event.keycode - KEY_1
	if event.is_pressed() and not event.is_echo() and number >= 0 and number < SENTENCES.size():
		_order(SENTENCES[number])


func _order(sentence: String) -> void:
	_sentence = sentence
	_changed = true


func _json(method: HTTPClient.Method, path: String) -> Variant:
	var answer: Array = await _ask(method, path)
	return null if answer.is_empty() else JSON.parse_string(answer[1].get_string_from_utf8())


## The headers and the body of an answer; empty where it was refused, which is shown.
func _ask(method: HTTPClient.Method, path: String, data := PackedByteArray()) -> Array:
	var request := HTTPRequest.new()
	add_child(request)
	request.request_raw(_base + path, _headers, method, data)
	var answer: Array = await request.request_completed
	request.queue_free()
	if answer[0] != HTTPRequest.RESULT_SUCCESS:
		_say("the studio does not answer; start it with: bunraku studio --no-browser")
		return []
	if answer[1] >= 400:
		var said: Variant = JSON.parse_string(answer[3].get_string_from_utf8())
		_say(said["error"] if said is Dictionary else "the studio answered %d" % answer[1])
		return []
	return [answer[2], answer[3]]


func _say(text: String) -> void:
	$Says.text = text
