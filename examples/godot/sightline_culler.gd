class_name SightlineCuller
extends Node
## Hides the nodes of a level that are not visible from the cell of the camera.
##
## Reads what `sightline export level.pvs --format sidecar -o level.json` wrote. Godot 4's glTF
## importer keeps the names of nodes, so the names in the file must be unique; where they are not,
## Godot renames nodes, and a warning says so. Nodes that are in no set at all, or not in the file,
## are left as they are. A node keeps its children: only its own geometry is hidden.

const UNKNOWN := -1
const NONE := -2

## The sidecar.
@export_file("*.json") var sidecar := "res://level.json"
## The root of the level, as the importer made it.
@export var level: Node3D
## The eye; without one, the viewport's camera.
@export var viewer: Camera3D

## The cell of the last frame; negative where nothing is known and everything is drawn.
var cell := NONE

## The corners of each cell's box, and the greatest of the view box.
var _least: Array[Vector3] = []
var _greatest: Array[Vector3] = []
var _end := Vector3.ZERO
## For each cell the names of the nodes that are visible from it, as keys.
var _names: Array[Dictionary] = []
## The geometry of each name, and the layers it has when it is shown.
var _nodes: Dictionary = {}
var _layers: Dictionary = {}


func _ready() -> void:
	var text := FileAccess.get_file_as_string(sidecar)
	var read: Variant = JSON.parse_string(text)
	if not read is Dictionary or read.get("format") != "sightline.sidecar":
		push_error("%s is no sidecar of sightline export; nothing is culled" % sidecar)
		set_process(false)
		return
	_read_cells(read)
	_match_nodes()


func _process(_delta: float) -> void:
	var eye := viewer if viewer else get_viewport().get_camera_3d()
	if eye:
		look_from(level.to_local(eye.global_position))


## Shows what is visible from a point in the level's space, and hides the rest.
func look_from(point: Vector3) -> void:
	var now := cell_of(point)
	if now == cell:
		return
	cell = now
	for key: String in _nodes:
		var shown: bool = now < 0 or _names[now].has(key)
		for node: VisualInstance3D in _nodes[key]:
			node.layers = _layers[node] if shown else 0


## The cell that holds a point, or -1.
func cell_of(point: Vector3) -> int:
	if cell >= 0 and _holds(cell, point):
		return cell
	for number in _least.size():
		if _holds(number, point):
			return number
	return UNKNOWN


## A cell holds its least faces; its greatest ones too where they are those of the view box.
func _holds(number: int, point: Vector3) -> bool:
	for axis in 3:
		var end := _greatest[number][axis]
		if point[axis] < _least[number][axis] or point[axis] > end:
			return false
		if point[axis] == end and end < _end[axis]:
			return false
	return true


func _read_cells(read: Dictionary) -> void:
	_end = _vector(read["view_box"][1])
	var names: Array[String] = []
	var node_of: Dictionary = {}
	for object: Dictionary in read["objects"]:
		# Objects are named "node/mesh#primitive".
		var node: String = object["name"].get_slice("/", 0)
		if object.has("instance"):
			node = node.rsplit("[", true, 1)[0]
		names.append(node)
		if node_of.get(node, object.get("node")) != object.get("node"):
			push_warning(
				"two nodes of the glTF file are named %s; give them names of their own" % node
			)
		node_of[node] = object.get("node")
	for of: Dictionary in read["cells"]:
		_least.append(_vector(of["min"]))
		_greatest.append(_vector(of["max"]))
		var seen: Dictionary = {}
		for number: float in of["objects"]:
			seen[names[int(number)]] = true
			_nodes[names[int(number)]] = []
		_names.append(seen)


func _vector(of: Array) -> Vector3:
	return Vector3(of[0], of[1], of[2])


func _match_nodes() -> void:
	var matched := 0
	for node: Node in level.find_children("*", "VisualInstance3D", true, false):
		if _nodes.has(String(node.name)):
			_nodes[String(node.name)].append(node)
			_layers[node] = (node as VisualInstance3D).layers
			matched += 1
	if matched == 0:
		push_warning("no node below %s has the name of one that was baked" % level.name)
