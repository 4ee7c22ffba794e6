#!/usr/bin/env bash
# From a fresh checkout to a baked and measured scene: installs what is missing, builds, bakes, measures.
#
#   scripts/bake.sh [SCENE] [-- FLAGS for `sightline bake`]
#
# SCENE is an OBJ, PLY, glTF or GLB file; without one a small town is generated. Results go to out/ in the checkout.
# Ctrl-C and the same command again carry on where it stopped.
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
    -*) die "unknown flag '$1'; flags for the bake come after '--'" ;;
    *)
      [ -z "$scene" ] || die "one scene at a time: '$scene' or '$1'?"
      scene=$1
      ;;
  esac
  shift
done
# Named relative to where the caller stands, before this script goes to the checkout.
if [ -n "$scene" ]; then
  [ -f "$scene" ] || { printf "bake: no file '%s'; name an OBJ, PLY, glTF or GLB file, or none for a generated town\n" "$scene" >&2; exit 3; }
  scene=$(realpath "$scene")
fi
cd "$(dirname "$0")/.."

./scripts/setup.sh --for run
command -v cargo >/dev/null || . "$HOME/.cargo/env"

say 'building (six or seven minutes the first time, on two cores)'
cargo build --profile dist --locked
sightline=$(realpath "${CARGO_TARGET_DIR:-target}")/dist/sightline

mkdir -p out
if [ -z "$scene" ]; then
  scene=out/town.glb
  # The town is wide and low, and this is a first look: a minute, not five.
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

say 'measuring: frames drawn from the result against frames of the whole scene'
# With --json, progress is JSON, too.
"$sightline" measure "$scene" "$result" --viewpoints 200 --seed 1 --json >"out/${name%.*}.measure.json" \
  2> >(grep -v '"event":"progress"' >&2)

number() { sed -n "s/.*\"$1\" *: *\([0-9.eE+-]*\).*/\1/p" "out/${name%.*}.measure.json" | head -n 1; }
percent() { awk -v x="$(number "$1")" 'BEGIN { if (x == "") exit 1; printf "%.4f %%", 100 * x }'; }
mean=$(percent mean_error) p99=$(percent p99_error) max=$(percent max_error)
say "$result: baked in $took s; wrong pixels: mean $mean, 99th percentile $p99, worst frame $max"
printf -v result_name %q "$result"
cat >&2 <<END
next:
  $sightline info $result_name       what is in it
  $sightline query --help            what is visible from a point
  $PWD/scripts/bake.sh YOUR_SCENE.glb     a scene of your own
END
