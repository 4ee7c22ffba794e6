#!/usr/bin/env bash
# The digests of a dozen small bakes by every method, sampler, backend and division, one line each.
#
#   scripts/digests.sh [PROGRAM] > before.txt
#
# A change that must not change results prints the same lines before and after. PROGRAM is the `sightline` to run
# (default: target/release/sightline). Bakes with --backend gpu need Vulkan; Mesa's software driver is enough.
set -euo pipefail
cd "$(dirname "$0")/.."
program=$(realpath "${1:-target/release/sightline}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-$work}

"$program" generate rooms -o "$work/rooms.glb" --triangles 3000 >/dev/null 2>&1
"$program" generate town -o "$work/town.glb" --triangles 20000 >/dev/null 2>&1
"$program" generate forest -o "$work/forest.glb" --triangles 8000 >/dev/null 2>&1

# bake NAME SCENE FLAGS…: bakes into a fresh data directory and prints the digest of the result.
bake() {
  local name=$1 scene=$2
  shift 2
  "$program" bake "$work/$scene.glb" -o "$work/$name.pvs" --data-dir "$work/$name.data" "$@" >/dev/null 2>"$work/log" ||
    { printf 'digests: %s failed:\n' "$name" >&2; cat "$work/log" >&2; exit 1; }
  printf '%s  %s\n' "$(sha256sum <"$work/$name.pvs" | cut -c1-32)" "$name"
}

bake lines rooms --cells 4x4x4 --target-error 0.003
bake lines-blocks rooms --cells 4x4x4 --target-error 0.003 --block-cells 8
bake lines-town town --cells 6x4x6 --target-error 0.003
bake lines-bound rooms --cells 3x3x3 --max-error 0.01
bake lines-tree rooms --triangle-budget 300 --max-depth 9
bake lines-gpu rooms --cells 3x3x3 --target-error 0.01 --backend gpu
bake cubes rooms --cells 3x2x3 --sampler cubes --target-error 0.03
bake cubes-tree rooms --triangle-budget 400 --max-depth 6 --sampler cubes --target-error 0.03
bake cubes-gpu rooms --cells 2x2x2 --sampler cubes --target-error 0.03 --backend gpu
bake guided rooms --cells 3x3x3 --sampler guided
bake exact rooms --cells 2x2x2 --method exact --certificates
bake exact-tree rooms --triangle-budget 300 --max-depth 5 --method exact --certificates
bake exact-forest forest --cells 2x2x2 --method exact --certificates
bake verified rooms --cells 2x2x2 --method verified --certificates
