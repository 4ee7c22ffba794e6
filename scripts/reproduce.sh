#!/usr/bin/env bash
# Repeats the measurements of the papers' tables, and writes a page that compares the papers' numbers with
# ours.
#
#   scripts/reproduce.sh [--quick] [--out FOLDER] [--page FILE.md] [SCENE…]
#
# The scenes of the papers are not available, so the script measures generated scenes of the same kinds. Each
# SCENE (OBJ, PLY, glTF or GLB) adds rows to the tables. --quick uses smaller scenes and fewer cells. The
# script stores the output of each command in FOLDER. Default: out/reproduction. Then scripts/reproduction.py
# writes the page to FILE.md. Default: docs/experiments/reproduction.md. The page states the duration of the
# run.
set -euo pipefail

say() { printf '\n== %s\n' "$*" >&2; }
die() { printf 'reproduce: %s\n' "$*" >&2; exit 2; }

quick=
out=
page=
scenes=()
typed=scripts/reproduce.sh
while [ $# -gt 0 ]; do
  case $1 in
    --quick)
      quick=1
      typed+=' --quick'
      ;;
    --out | --page)
      [ $# -gt 1 ] || die "$1 needs a value"
      if [ "$1" = --out ]; then out=$2; else page=$(realpath -m "$2"); fi
      shift
      ;;
    -h | --help)
      sed -n '2,/^set/{/^#/s/^# \{0,1\}//p}' "$0"
      exit 0
      ;;
    -*) die "unknown flag '$1'" ;;
    *)
      if [ ! -f "$1" ]; then
        printf "reproduce: file '%s' does not exist; name OBJ, PLY, glTF or GLB files, or none\n" "$1" >&2
        exit 3
      fi
      scenes+=("$(realpath "$1")")
      typed+=" ${1##*/}"
      ;;
  esac
  shift
done
[ -z "$out" ] || out=$(realpath -m "$out")
cd "$(dirname "$0")/.."
out=${out:-$PWD/out/reproduction}
page=${page:-$PWD/docs/experiments/reproduction.md}
command -v python3 >/dev/null ||
  die 'python3 is not installed; the script needs it to write the page (Debian: apt-get install python3)'
command -v cargo >/dev/null || . "$HOME/.cargo/env"

# SIGHTLINE_BIN names an existing program, and SIGHTLINE_EXAMPLES a folder with the examples cells and pairs.
# Without these variables, the script builds the programs.
if [ -z "${SIGHTLINE_BIN:-}" ]; then
  say 'building (the first build takes about a quarter of an hour on two cores)'
  cargo build --release --locked
  SIGHTLINE_BIN=$(realpath "${CARGO_TARGET_DIR:-target}")/release/sightline
fi
if [ -z "${SIGHTLINE_EXAMPLES:-}" ]; then
  cargo build --release --locked -p sightline-exact --example cells --example pairs
  SIGHTLINE_EXAMPLES=$(realpath "${CARGO_TARGET_DIR:-target}")/release/examples
fi
for program in "$SIGHTLINE_BIN" "$SIGHTLINE_EXAMPLES/cells" "$SIGHTLINE_EXAMPLES/pairs"; do
  [ -x "$program" ] || die "the program $program does not exist"
done

# The script deletes the folder only if an earlier run created it.
if [ -e "$out" ] && [ -n "$(ls -A "$out")" ]; then
  [ -f "$out/commands.txt" ] ||
    die "$out contains files that no earlier run of this script wrote; select another folder with --out"
  rm -rf "$out"
fi
mkdir -p "$out/scenes"
export XDG_CACHE_HOME=$out/store
log=$out/commands.txt
: >"$log"
head -n 1 /proc/stat >"$out/stat.before" 2>/dev/null || true

# without_folders: Removes the folders from the paths of scenes and results in the standard input.
without_folders() {
  sed -E "s#$out/##g; s#(^| )[^ ]*/([^/ ]+\.(glb|gltf|obj|ply))#\1\2#g; s# \$##"
}

# run NAME PROGRAM ARGUMENTS…: Runs the program, writes its output to NAME, and appends the command without
# folders to the log.
run() {
  local name=$1
  shift
  say "$name: ${*##*/}"
  # The program would return a stored bake at once, so start with an empty store.
  rm -rf "$out/store"
  local words=("$@")
  words[0]=${words[0]##*/}
  printf '%s\t%s\n' "$name" "$(printf '%s ' "${words[@]}" | without_folders)" >>"$log"
  "$@" >"$out/$name" 2>>"$out/progress.txt" || die "failed: $*; see $out/progress.txt"
}

# generate NAME KIND FLAGS…: Generates a scene.
generate() {
  local name=$1
  shift
  run "$name.scene.json" "$SIGHTLINE_BIN" --json generate "$@" -o "$out/scenes/$name.glb"
}

# sample EXPERIMENT SCENE CELLS THRESHOLD TARGET: Bakes with both samplers, and measures the error of both
# results.
sample() {
  local name=$1 scene=$2 cells=$3 threshold=$4 target=$5
  run "$name.cubes.json" "$SIGHTLINE_BIN" --json bake "$scene" -o "$out/$name.cubes.pvs" --backend cpu \
    --cells "$cells" --sampler cubes --error-threshold "$threshold" --min-distance 1 --resolution 128
  run "$name.lines.json" "$SIGHTLINE_BIN" --json bake "$scene" -o "$out/$name.lines.pvs" --backend cpu \
    --cells "$cells" --target-error "$target"
  for sampler in cubes lines; do
    run "$name.$sampler.error.json" "$SIGHTLINE_BIN" --json measure "$scene" "$out/$name.$sampler.pvs" \
      --viewpoints "$viewpoints" --seed 7 --resolution 512 --backend cpu
  done
}

# decide NAME SCENE CELLS VIEW-BOX COUNT: Bakes with lines, and times exact queries for COUNT random cells of
# the result, one cell at a time.
decide() {
  local name=$1 scene=$2 cells=$3 box=$4 count=$5
  run "$name.sampled.json" "$SIGHTLINE_BIN" --json bake "$scene" -o "$out/$name.pvs" --backend cpu \
    --cells "$cells" ${box:+"--view-box=$box"} --target-error 0.01 --cell-to-cell off
  run "$name.cells.txt" "$SIGHTLINE_EXAMPLES/cells" "$scene" "$out/$name.pvs" "$count" 1
}

# low SCENE.JSON PART: Prints the box of a generated scene, reduced to the lowest PART of its height.
low() {
  python3 -c 'import json, sys
b = json.load(open(sys.argv[1]))["bounds"]
(x, y, z), (u, v, w) = b["min"], b["max"]
print(",".join(repr(n) for n in (x, y, z, u, y + (v - y) * float(sys.argv[2]), w)))' "$1" "$2"
}

if [ -n "$quick" ]; then
  viewpoints=20 leaves=0.01
  large=(--trees 200 --triangles-per-tree 500) small=(--trees 80 --triangles-per-tree 500)
  durand=(--trees 145 --triangles-per-tree 1000) town=(--triangles 100000)
  grid=16x2x16 exact_town=5 exact_forest=2 queries=1000
else
  # If leaves are smaller than pixels, the sampler needs hours for the last per cent of the sight lines.
  viewpoints=40 leaves=0.03
  large=(--trees 200 --triangles-per-tree 25000) small=(--trees 80 --triangles-per-tree 25000)
  durand=(--trees 1450 --triangles-per-tree 1000) town=()
  grid=32x2x32 exact_town=8 exact_forest=2 queries=2000
fi

generate forest-large forest "${large[@]}"
generate forest-small forest "${small[@]}"
generate forest-durand forest "${durand[@]}"
generate town town ${town[@]+"${town[@]}"}
scene() { printf '%s/scenes/%s.glb' "$out" "$1"; }

# Nirenstein and Blake 2004, Tables 1 and 2; Nirenstein 2003, Tables 3 and 4.
sample exp1 "$(scene forest-large)" 8x8x8 0.2 "$leaves"
sample exp2 "$(scene forest-small)" 8x8x8 0 "$leaves"
sample exp3 "$(scene forest-small)" 8x8x8 0.999 "$leaves"
sample exp4 "$(scene forest-durand)" 20x1x20 0.99 "$leaves"
sample exp5 "$(scene town)" 8x8x8 0 0.003
sample exp6 "$(scene town)" 8x8x8 0.999 0.003
# Nirenstein and Blake 2004, Figure 7; Nirenstein 2003, Figure 21.
run growth.json "$SIGHTLINE_BIN" --json bench "$(scene forest-small)" --grow cells --grow-error 0.01 \
  --out "$out/growth"

# Nirenstein 2003, Table 9 and section 6.3.
decide town "$(scene town)" "$grid" "$(low "$out/town.scene.json" 0.125)" "$exact_town"
decide forest "$(scene forest-durand)" 20x1x20 '' "$exact_forest"
run town.pairs.txt "$SIGHTLINE_EXAMPLES/pairs" "$(scene town)" "$queries" 1
run forest.pairs.txt "$SIGHTLINE_EXAMPLES/pairs" "$(scene forest-durand)" "$queries" 1

# The scenes from the command line.
for path in ${scenes[@]+"${scenes[@]}"}; do
  name=given-$(basename "${path%.*}" | tr -c 'A-Za-z0-9_\n-' _)
  sample "$name" "$path" 8x8x8 0 0.003
  decide "$name" "$path" 8x8x8 '' 3
  run "$name.pairs.txt" "$SIGHTLINE_EXAMPLES/pairs" "$path" "$queries" 1
done

head -n 1 /proc/stat >"$out/stat.after" 2>/dev/null || true
times >"$out/times.txt"
printf '%s\n' "$SECONDS" >"$out/seconds.txt"
"$SIGHTLINE_BIN" --version >"$out/version.txt"
date -u +%F >"$out/date.txt"
python3 scripts/reproduction.py "$out" "$page" "$typed" "${quick:+quick}"
say "wrote $page"
