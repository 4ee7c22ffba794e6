class_name SightlineCuller
extends Node
## Hides the nodes of a level that are not visible from the cell of the camera.
##
## The script reads a sidecar: `sightline export level.pvs --format sidecar -o level.json`.
## Godot 4's glTF importer keeps the names of nodes, so the names in the glTF file must be unique.
## If two nodes have the same name, Godot renames one of them, and the script prints a warning.
## The script does not change nodes that are in no set or not in the sidecar. It hides only the
## geometry of a node, and not the node's children.

const UNKNOWN := -1
const NONE := -2

## The path of the sidecar.
@export_file("*.json") var sidecar := "res://level.json"
## The root node of the level, from the glTF importer.
@export var level: Node3D
## The camera. Default: the camera of the viewport.
@export var viewer: Camera3D

## The cell of the last frame. If the cell is negative, the script shows all nodes.
var cell := NONE

## The minimum and maximum corner of each cell, and the maximum corner of the view box.
var _least: Array[Vector3] = []
var _greatest: Array[Vector3] = []
var _end := Vector3.ZERO
## The names of the nodes that are visible from each cell, as keys.
var _names: Array[Dictionary] = []
## The geometry nodes of each name, and the layers of each geometry node while it is shown.
var _nodes: Dictionary = {}
var _layers: Dictionary = {}


func _ready() -> void:
	var text := FileAccess.get_file_as_string(sidecar)
	var read: Variant = JSON.parse_string(text)
	if not read is Dictionary or read.get("format") != "sightline.sidecar":
		push_error("%s is not a sidecar of sightline export; culling is off" % sidecar)
		set_process(false)
		return
	_read_cells(read)
	_match_nodes()


func _process(_delta: float) -> void:
	var eye := viewer if viewer else get_viewport().get_camera_3d()
	if eye:
		look_from(level.to_local(eye.global_position))


## Shows the nodes that are visible from a point in the level's space, and hides the other nodes.
func look_from(point: Vector3) -> void:
	var now := cell_of(point)
	if now == cell:
		return
	cell = now
	for key: String in _nodes:
		var shown: bool = now < 0 or _names[now].has(key)
		for node: VisualInstance3D in _nodes[key]:
			node.layers = _layers[node] if shown else 0


## Returns the cell that contains a point, or -1.
func cell_of(point: Vector3) -> int:
	if cell >= 0 and _holds(cell, point):
		return cell
	for number in _least.size():
		if _holds(number, point):
			return number
	return UNKNOWN


## Returns true if a cell contains a point. A cell contains its minimum faces, and those of its
## maximum faces that are faces of the view box.
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
		# The name of an object is "node/mesh#primitive".
		var node: String = object["name"].get_slice("/", 0)
		if object.has("instance"):
			node = node.rsplit("[", true, 1)[0]
		names.append(node)
		if node_of.get(node, object.get("node")) != object.get("node"):
			push_warning(
				"two nodes of the glTF file have the name %s; rename one of them" % node
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
		push_warning("no node below %s has the name of a node in the sidecar" % level.name)
