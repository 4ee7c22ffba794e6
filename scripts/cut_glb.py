#!/usr/bin/env python3
"""Divides the only mesh of a GLB file into objects of about equal size: cut_glb.py IN.glb OUT.glb OBJECTS

Each object consists of consecutive triangles, so triangles keep their ids. The script does not change
buffers: each object is a range of the existing list of indices.
"""

import json
import struct
import sys


def main() -> None:
    if len(sys.argv) != 4 or not sys.argv[3].isdigit() or sys.argv[3] == "0":
        sys.exit(__doc__)
    source, target, wanted = sys.argv[1], sys.argv[2], int(sys.argv[3])
    data = open(source, "rb").read()
    if data[:4] != b"glTF" or data[16:20] != b"JSON":
        sys.exit(f"{source} is not a GLB file")
    size = struct.unpack("<I", data[12:16])[0]
    document, rest = json.loads(data[20 : 20 + size]), data[20 + size :]
    primitives = [p for mesh in document["meshes"] for p in mesh["primitives"]]
    drawn = [n for n, node in enumerate(document["nodes"]) if "mesh" in node]
    if (len(primitives) != 1 or len(drawn) != 1 or primitives[0].get("mode", 4) != 4
            or "indices" not in primitives[0]):
        sys.exit(f"{source} must contain one primitive, of indexed triangles, and one node with a mesh")
    primitive = primitives[0]
    indices = document["accessors"][primitive["indices"]]
    triangles, width = indices["count"] // 3, {5121: 1, 5123: 2, 5125: 4}[indices["componentType"]]
    edges = [triangles * k // wanted for k in range(wanted + 1)]
    document["meshes"] = []
    for first, end in zip(edges, edges[1:]):
        if first < end:
            part = {key: value for key, value in indices.items() if key not in ("min", "max", "name")}
            part |= {"byteOffset": indices.get("byteOffset", 0) + 3 * first * width,
                     "count": 3 * (end - first)}
            document["accessors"].append(part)
            cut = primitive | {"indices": len(document["accessors"]) - 1}
            document["meshes"].append({"primitives": [cut], "name": f"part {len(document['meshes'])}"})
    node = document["nodes"][drawn[0]]
    # The node of the mesh stays and keeps its transform. The objects become its first children.
    del node["mesh"]
    first = len(document["nodes"])
    document["nodes"] += [{"mesh": m, "name": mesh["name"]} for m, mesh in enumerate(document["meshes"])]
    node["children"] = list(range(first, len(document["nodes"]))) + node.get("children", [])
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    with open(target, "wb") as out:
        out.write(b"glTF" + struct.pack("<II", 2, 20 + len(text) + len(rest)))
        out.write(struct.pack("<I", len(text)) + b"JSON" + text + rest)


if __name__ == "__main__":
    main()
