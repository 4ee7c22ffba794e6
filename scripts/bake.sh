#!/usr/bin/env bash
# Installs missing packages, builds Sightline, bakes a scene and measures the error of the result.
#
#   scripts/bake.sh [SCENE] [-- FLAGS for `sightline bake`]
#
# SCENE is an OBJ, PLY, glTF or GLB file. Default: a small generated town. The script writes results to out/
# in the checkout. After Ctrl-C, the same command continues the bake.
set -euo pipefail

say() { printf '\n== %s\n' "$*" >&2; }
die() { printf 'bake: %s\n' "$*" >&2; exit 2; }

scene=
flags=()
while [ $# -gt 0 ]; do
  case $1 in
    --)
      shift
      flags=("$@")
      break
      ;;
    -h | --help)
      sed -n '2,/^set/{/^#/s/^# \{0,1\}//p}' "$0"
      exit 0
      ;;
    -*) die "unknown flag '$1'; put the flags of the bake after '--'" ;;
    *)
      [ -z "$scene" ] || die "two scenes, '$scene' and '$1'; give one scene"
      scene=$1
      ;;
  esac
  shift
done
# The path of the scene is relative to the caller's folder, so resolve the path before the script changes the
# folder.
if [ -n "$scene" ]; then
  if [ ! -f "$scene" ]; then
    printf "bake: file '%s' does not exist; name an OBJ, PLY, glTF or GLB file, or none\n" "$scene" >&2
    exit 3
  fi
  scene=$(realpath "$scene")
fi
cd "$(dirname "$0")/.."

./scripts/setup.sh --for run
command -v cargo >/dev/null || . "$HOME/.cargo/env"

say 'building (the first build needs 8 to 16 minutes on two cores)'
cargo build --profile dist --locked
sightline=$(realpath "${CARGO_TARGET_DIR:-target}")/dist/sightline

mkdir -p out
if [ -z "$scene" ]; then
  scene=out/town.glb
  # With these cells the bake of the town takes about one minute, with the default about five. The town is
  # wide and low, so the grid has few layers.
  [ ${#flags[@]} -gt 0 ] || flags=(--cells 8x4x2)
  if [ ! -f "$scene" ]; then
    say 'generating a town'
    "$sightline" generate town --triangles 20000 --seed 1 -o "$scene"
  fi
fi
name=$(basename "$scene")
result=$PWD/out/${name%.*}.pvs

say "baking $scene"
started=$(date +%s%N)
"$sightline" bake "$scene" -o "$result" ${flags[@]+"${flags[@]}"}
took=$(awk -v ns=$(($(date +%s%N) - started)) 'BEGIN { printf "%.1f", ns / 1e9 }')

say 'measuring: comparing frames of the result with frames of the whole scene'
# With --json, `measure` prints its progress as JSON. Do not show these lines.
"$sightline" measure "$scene" "$result" --viewpoints 200 --seed 1 --json >"out/${name%.*}.measure.json" \
  2> >(grep -v '"event":"progress"' >&2)

number() { sed -n "s/.*\"$1\" *: *\([0-9.eE+-]*\).*/\1/p" "out/${name%.*}.measure.json" | head -n 1; }
percent() { awk -v x="$(number "$1")" 'BEGIN { if (x == "") exit 1; printf "%.4f %%", 100 * x }'; }
mean=$(percent mean_error) p99=$(percent p99_error) max=$(percent max_error)
say "$result: baked in $took s; wrong pixels: mean $mean, 99th percentile $p99, worst frame $max"
printf -v result_name %q "$result"
cat >&2 <<END
next:
  $sightline info $result_name       describe the result
  $sightline view $result_name $(printf %q "$scene")       inspect the result in a browser
  $sightline query --help            query the triangles that are visible from a point
  $PWD/scripts/bake.sh YOUR_SCENE.glb     bake another scene
END
