#!/usr/bin/env bash
# Creates docs/picture.png: a generated town from above, one view cell as a box, and the triangles of the
# cell's set in colour.
#
#   scripts/picture.sh
#
# After the build of the program, the script takes about one minute.
set -euo pipefail
cd "$(dirname "$0")/.."

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
sightline() { cargo run --quiet --release --locked --bin sightline -- "$@"; }
sightline generate town --triangles 120000 -o "$work/town.glb"
sightline bake "$work/town.glb" -o "$work/town.pvs" --cells 16x4x16 --data-dir "$work/data"
# Cell 780 is in the street between the two tall houses. The eye looks at the cell obliquely from above.
cargo run --quiet --release --locked -p sightline-measure --example picture -- \
  "$work/town.glb" "$work/town.pvs" 780 70,42,66 35,0,20 docs/picture.png
