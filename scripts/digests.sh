#!/usr/bin/env bash
# Prints digests of small bakes with every method, sampler, division, restriction of viewpoints and kind of
# item, and digests of ambient occlusion.
#
#   scripts/digests.sh [PROGRAM] > before.txt
#
# Each line contains a digest, the name of a bake and the kind of its items. The digest covers the cell lines
# of `dump`, without the header, so it does not depend on the file format. If a change of the code must not
# affect results, run the script before and after the change and compare the lines. PROGRAM is the program
# that the script runs. Default: target/release/sightline. Bakes with --backend gpu need Vulkan; Mesa's
# software driver is sufficient.
set -euo pipefail
cd "$(dirname "$0")/.."
program=$(realpath "${1:-target/release/sightline}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-$work}
# Commands without --data-dir store data in the cache. An empty cache excludes results of an earlier build.
export XDG_CACHE_HOME=$work/cache

# run NAME ARGUMENTS…: Runs the program, and prints its log only if it fails.
run() {
  local name=$1
  shift
  "$program" "$@" >"$work/out" 2>"$work/log" ||
    { printf 'digests: %s failed:\n' "$name" >&2; cat "$work/log" >&2; exit 1; }
}

# digest NAME ITEM: Prints the line with the digest of the standard input.
digest() { printf '%s  %s %s\n' "$(sha256sum | cut -c1-32)" "$1" "$2"; }

# bake ITEMS NAME SCENE FLAGS…: Bakes with an empty data directory and prints a line for each item. ITEMS is a
# list, separated by commas, of kinds of `dump --items` and of contributions.
bake() {
  local items=$1 name=$2 scene=$3 item
  shift 3
  run "$name" bake "$work/$scene.glb" -o "$work/$name.pvs" --data-dir "$work/data" "$@"
  rm -rf "$work/data"
  for item in ${items//,/ }; do
    case $item in
      contributions) run "$name" dump "$work/$name.pvs" --contributions ;;
      contributions-objects) run "$name" dump "$work/$name.pvs" --items objects --contributions ;;
      *) run "$name" dump "$work/$name.pvs" --items "$item" ;;
    esac
    tail -n +2 "$work/out" | digest "$name" "$item"
  done
}

run rooms generate rooms -o "$work/rooms.glb" --triangles 3000
run town generate town -o "$work/town.glb" --triangles 20000
run forest generate forest -o "$work/forest.glb" --triangles 8000
printf '%s\n' '0.5 1.2 0.5' '2.5 1.2 2.5 3' '4.5 1 4.5' >"$work/path.txt"
cpu=(--backend cpu)
sets=triangles,objects,cells

# Sight lines: grids, boxes along walls and trees; target errors, bounds and shares; kinds of items.
bake $sets lines rooms "${cpu[@]}" --cells 4x4x4 --target-error 0.003
bake triangles lines-seed rooms "${cpu[@]}" --cells 4x4x4 --target-error 0.003 --seed 7
bake triangles lines-blocks rooms "${cpu[@]}" --cells 4x4x4 --target-error 0.003 --block-cells 8
bake triangles lines-town town "${cpu[@]}" --cells 6x4x6 --target-error 0.003
bake triangles lines-bound rooms "${cpu[@]}" --cells 3x3x3 --max-error 0.01
bake triangles,objects lines-walls rooms "${cpu[@]}" --cells walls:20 --target-error 0.01
bake triangles lines-tree rooms "${cpu[@]}" --triangle-budget 300 --max-depth 9
bake triangles lines-far rooms "${cpu[@]}" --cells 3x3x3 --target-error 0.01 --far 2
bake contributions lines-contributions rooms "${cpu[@]}" --cells 3x2x3 --target-error 0.01 --contributions
bake clusters,triangles lines-clusters town "${cpu[@]}" --cells 3x2x3 --target-error 0.003 \
  --granularity clusters
bake objects,contributions-objects lines-objects town "${cpu[@]}" --cells 3x2x3 --target-error 0.003 \
  --granularity objects --contributions
bake objects lines-share town "${cpu[@]}" --cells 3x2x3 --granularity objects --min-share 0.01
bake triangles lines-see-through rooms "${cpu[@]}" --cells 3x2x3 --target-error 0.01 --see-through '*1*'
bake triangles lines-sides rooms "${cpu[@]}" --cells 3x2x3 --target-error 0.01 --cull-back-faces
bake triangles lines-gpu rooms --backend gpu --cells 3x3x3 --target-error 0.01
bake objects lines-objects-gpu town --backend gpu --cells 2x1x2 --target-error 0.01 --granularity objects

# Viewpoints: parts of the cells, and a region between walls.
bake triangles lines-parts rooms "${cpu[@]}" --cells 4x2x4 --target-error 0.01 \
  --view-box=0.2,0,0.2,2,2,2 --view-box=3,0,3,4.8,2,4.8
bake triangles lines-path rooms "${cpu[@]}" --cells 4x2x4 --target-error 0.01 --viewpoints "$work/path.txt" \
  --reach 0.5
bake triangles lines-region rooms "${cpu[@]}" --cells 4x2x4 --target-error 0.01 --reachable-from 0.5,1.2,0.5

# Cubes and guided rays.
bake triangles cubes rooms "${cpu[@]}" --cells 3x2x3 --sampler cubes --error-threshold 0.2 --resolution 64
bake triangles cubes-pixels rooms "${cpu[@]}" --cells 2x2x2 --sampler cubes --error-measure pixels \
  --resolution 32 --error-threshold 0.3
bake triangles cubes-sets rooms "${cpu[@]}" --cells 2x2x2 --sampler cubes --error-measure sets \
  --resolution 32 --no-solids
bake triangles cubes-uniform rooms "${cpu[@]}" --cells 2x1x2 --sampler cubes --error-measure uniform \
  --resolution 32
bake triangles cubes-parts rooms "${cpu[@]}" --cells 3x2x3 --sampler cubes --resolution 32 \
  --view-box=0.2,0,0.2,2,2,2 --view-box=3,0,3,4.8,2,4.8
bake triangles cubes-tree rooms "${cpu[@]}" --triangle-budget 400 --max-depth 6 --sampler cubes \
  --resolution 64
bake triangles cubes-superset rooms "${cpu[@]}" --triangle-budget 400 --max-depth 5 --sampler cubes \
  --resolution 32 --superset on
bake triangles cubes-gpu rooms --backend gpu --cells 2x2x2 --sampler cubes --resolution 32
bake triangles guided rooms "${cpu[@]}" --cells 3x3x3 --sampler guided --rays 20000
bake triangles guided-walls rooms "${cpu[@]}" --cells walls:20 --sampler guided --rays 20000

# Exact queries and portals.
bake $sets exact rooms "${cpu[@]}" --cells 2x2x2 --method exact --certificates
bake triangles exact-tree rooms "${cpu[@]}" --triangle-budget 300 --max-depth 5 --method exact --certificates
bake triangles exact-forest forest "${cpu[@]}" --cells 2x2x2 --method exact --certificates
bake triangles exact-walls rooms "${cpu[@]}" --cells walls:8 --method exact
bake triangles exact-far rooms "${cpu[@]}" --cells 2x1x2 --method exact --far 2
bake triangles exact-region rooms "${cpu[@]}" --cells 2x1x2 --method exact --reachable-from 0.5,1.2,0.5
bake triangles verified rooms "${cpu[@]}" --cells 2x2x2 --method verified --certificates
bake triangles,objects portals rooms --cells 4x2x4 --method portals
bake triangles portals-walls rooms --cells walls:20 --method portals
bake triangles portals-region rooms --cells 4x2x4 --method portals --reachable-from 0.5,1.2,0.5

# Ambient occlusion of points, with lights and fragments, and of vertices.
for point in '0.5,1.2,0.5' '2.5,1.2,2.5' '4.5,1,4.5'; do
  printf '{"point":[%s],"normal":[0,1,0]}\n' "$point"
done >"$work/points.jsonl"
printf '%s\n' '{"id":"lamp","polygon":[[1,2,1],[2,2,1],[2,2,2]]}' >"$work/lights.jsonl"
run ambient ambient "$work/rooms.glb" --points "$work/points.jsonl" --distance inf --fragments \
  --lights "$work/lights.jsonl"
digest ambient points <"$work/out"
run ambient-near ambient "$work/rooms.glb" --points "$work/points.jsonl" --distance 1
digest ambient-near points <"$work/out"
run ambient-vertices ambient "$work/rooms.glb" -o "$work/rooms-ao.glb" --to vertices
digest ambient-vertices file <"$work/rooms-ao.glb"
