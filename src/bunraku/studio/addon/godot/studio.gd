@tool
extends Node
# What the add-on asks of the studio. A node of its own, so that it works in the editor and in a
# running game alike.

# SPDX-License-Identifier: Apache-2.0

signal told(text: String)

const SECONDS := 900.0
const PAUSE := 0.25
const READS: Array[String] = ["glb", "gltf", "vrm", "fbx", "obj", "ply", "stl", "pmx"]

## What went wrong with the last request, "" for nothing.
var wrong := ""
var _base := ""
var _token := ""


## A file's bytes as an animated GLB, as the preset `godot` has it: the clip is named after the
## sentence. Empty where something went wrong.
func animate(
	address: String, file: String, data: PackedByteArray, sentences: Array, number: int
) -> PackedByteArray:
	wrong = ""
	if not _aim(address):
		return _stop("copy the whole address that `bunraku studio` printed, with its token")
	told.emit("sending %s" % file)
	var opened: Variant = await _json(
		HTTPClient.METHOD_POST, "/characters?name=%s" % file.uri_encode(), data
	)
	if opened == null:
		return PackedByteArray()
	var character: String = opened["character"]["id"]
	var made := await _made(opened["job"], character, sentences, number)
	await _ask(HTTPClient.METHOD_DELETE, "/characters/%s" % character)
	return made


func _made(job: String, character: String, sentences: Array, number: int) -> PackedByteArray:
	if not await _ended(job, "opening"):
		return PackedByteArray()
	var asked := {"script": sentences, "seeds": [number], "draft": false}
	var take: Variant = await _json(
		HTTPClient.METHOD_POST, "/characters/%s/takes" % character, _bytes(asked)
	)
	if take == null or not await _ended(take["job"], "making"):
		return PackedByteArray()
	var wanted := {"takes": take["takes"], "preset": "godot"}
	var written: Variant = await _json(
		HTTPClient.METHOD_POST, "/characters/%s/exports" % character, _bytes(wanted)
	)
	if written == null or not await _ended(written["job"], "writing"):
		return PackedByteArray()
	return await _ask(HTTPClient.METHOD_GET, "/exports/%s" % written["export"])


func _aim(address: String) -> bool:
	var parts := address.strip_edges().split("/#token=")
	if parts.size() != 2 or parts[1].is_empty():
		return false
	_base = parts[0]
	_token = parts[1]
	return _base.begins_with("http://localhost") or _base.begins_with("http://127.0.0.1")


## Wait for a job; whether it was done.
func _ended(job: String, what: String) -> bool:
	var end := Time.get_ticks_msec() + SECONDS * 1000.0
	while Time.get_ticks_msec() < end:
		var found: Variant = await _json(HTTPClient.METHOD_GET, "/jobs/%s" % job)
		if found == null:
			return false
		var state: String = found["state"]
		if state == "done":
			return true
		if state != "waiting" and state != "running":
			_stop(found["error"] if found["error"] else "the job was %s" % state)
			return false
		told.emit("%s: %d %%" % [what, roundi(found["done"] * 100.0)])
		await get_tree().create_timer(PAUSE).timeout
	_stop("the studio takes too long")
	return false


func _json(method: HTTPClient.Method, path: String, data := PackedByteArray()) -> Variant:
	var answer := await _ask(method, path, data)
	if wrong:
		return null
	var found: Variant = JSON.parse_string(answer.get_string_from_utf8())
	if found == null:
		_stop("the studio's answer is not understood; update Bunraku")
	return found


func _ask(method: HTTPClient.Method, path: String, data := PackedByteArray()) -> PackedByteArray:
	var request := HTTPRequest.new()
	request.timeout = 60.0
	add_child(request)
	var headers := PackedStringArray(["authorization: Bearer %s" % _token])
	var refused := request.request_raw(_base + "/api" + path, headers, method, data)
	if refused != OK:
		request.queue_free()
		return _stop("the studio cannot be asked: %s" % error_string(refused))
	var answer: Array = await request.request_completed
	request.queue_free()
	var body: PackedByteArray = answer[3]
	if answer[0] != HTTPRequest.RESULT_SUCCESS:
		return _stop("the studio does not answer; start it with: bunraku studio")
	if answer[1] >= 400:
		var said: Variant = JSON.parse_string(body.get_string_from_utf8())
		var sentence := "the studio answered %d" % answer[1]
		return _stop(said["error"] if said is Dictionary and said.has("error") else sentence)
	return body


func _bytes(value: Dictionary) -> PackedByteArray:
	return JSON.stringify(value).to_utf8_buffer()


func _stop(sentence: String) -> PackedByteArray:
	if not wrong:
		wrong = sentence
	return PackedByteArray()
