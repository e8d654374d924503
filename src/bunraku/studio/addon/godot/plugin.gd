@tool
extends EditorPlugin
# Bunraku for Godot 4: a sentence makes an animated scene of a mesh.
#
# `bunraku godot-addon` writes this folder into the `addons` of a project; switch it on in Project
# Settings, Plugins, and start `bunraku studio`. The add-on sends the mesh to the studio of this
# machine and puts what it made beside it. It needs nothing but Godot.

# SPDX-License-Identifier: Apache-2.0

const Dock := preload("dock.gd")

var _dock: Control


func _enter_tree() -> void:
	_dock = Dock.new()
	_dock.name = "Bunraku"
	add_control_to_dock(DOCK_SLOT_RIGHT_UL, _dock)


func _exit_tree() -> void:
	remove_control_from_docks(_dock)
	_dock.queue_free()
