#!/usr/bin/env bash
# Makes docs/picture.png: a generated town from above, one view cell as a box, and the triangles of its set in
# colour.
#
#   scripts/picture.sh
#
# Takes about a minute once the program is built.
set -euo pipefail
cd "$(dirname "$0")/.."

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
sightline() { cargo run --quiet --release --locked --bin sightline -- "$@"; }
sightline generate town --triangles 120000 -o "$work/town.glb"
sightline bake "$work/town.glb" -o "$work/town.pvs" --cells 16x4x16 --data-dir "$work/data"
# The cell of a point in the street between the two tall houses, seen obliquely from above.
cargo run --quiet --release --locked -p sightline-measure --example picture -- \
  "$work/town.glb" "$work/town.pvs" 780 70,42,66 35,0,20 docs/picture.png
