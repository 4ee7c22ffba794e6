#!/usr/bin/env python3
"""Rotates the scene of a GLB file about an axis through the origin, and prints the rotated points.

    turn_glb.py IN.glb OUT.glb DEGREES x|y|z [X,Y,Z ...]

All roots become children of one rotated node. A loader therefore rounds the coordinates of each corner a
second time.
"""

import json
import math
import struct
import sys


def main() -> None:
    if len(sys.argv) < 5 or sys.argv[4] not in ("x", "y", "z"):
        sys.exit(__doc__)
    source, target = sys.argv[1:3]
    angle, axis = math.radians(float(sys.argv[3])), "xyz".index(sys.argv[4])
    data = open(source, "rb").read()
    if data[:4] != b"glTF" or data[16:20] != b"JSON":
        sys.exit(f"{source} is not a GLB file")
    size = struct.unpack("<I", data[12:16])[0]
    document, rest = json.loads(data[20 : 20 + size]), data[20 + size :]
    turn = [0.0, 0.0, 0.0, math.cos(angle / 2)]
    turn[axis] = math.sin(angle / 2)
    for scene in document["scenes"]:
        document["nodes"].append({"children": scene["nodes"], "rotation": turn})
        scene["nodes"] = [len(document["nodes"]) - 1]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    with open(target, "wb") as out:
        out.write(b"glTF" + struct.pack("<II", 2, 20 + len(text) + len(rest)))
        out.write(struct.pack("<I", len(text)) + b"JSON" + text + rest)
    for point in sys.argv[5:]:
        p = [float(c) for c in point.split(",")]
        u, v = (axis + 1) % 3, (axis + 2) % 3
        c, s = math.cos(angle), math.sin(angle)
        p[u], p[v] = c * p[u] - s * p[v], s * p[u] + c * p[v]
        print(",".join(f"{c:.3f}" for c in p))


if __name__ == "__main__":
    main()
