#!/usr/bin/env bash
# Tests and measures the gpu backend on a machine that may have neither network nor Rust.
#
#   scripts/gpu-check.sh pack OUT.tar.xz [SCENE.glb…]   on a machine with Rust: builds, and packs the folder gpu-check
#   ./gpu-check.sh run [OUT_DIR]                        in that folder, unpacked on the machine with the GPU
#
# pack  takes release builds of sightline, of the examples rounds and gpu_lines and of the tests that need an adapter,
#       Embree with TBB, the Vulkan loader, the named scenes and this script. Shaders are compiled into the programs. The
#       other machine needs the same architecture, a C library not older than this one's, libstdc++ and its GPU's driver.
# run   writes OUT_DIR/ADAPTER.md (default: the folder where it is called): the tests, rounds and whole bakes beside those
#       on the CPU, the papers' forest, and the time of each kernel. It takes less than ten minutes on a GPU, and less than
#       five on a software rasteriser, whose numbers are no measurement. What fails or takes too long is left out, the
#       report says so, and the exit status is 1 at the end.
set -euo pipefail

say() { printf 'gpu-check: %s\n' "$*" >&2; }
die() { say "$*"; exit 2; }
usage='usage: scripts/gpu-check.sh pack OUT.tar.xz [SCENE.glb…] in a checkout; ./gpu-check.sh run [OUT_DIR] where unpacked'

tests=(gpu_cubes gpu_lines gpu_rounds sides tiles)
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d "${TMPDIR:-/tmp}/gpu-check.XXXXXX")
trap 'rm -rf "$work"' EXIT
trap 'exit 130' INT TERM

# Where programs find a library; nothing if they do not.
library() { ldconfig -p | awk -v name="$1" '$1 == name && !found { print $NF; found = 1 }'; }

pack() {
  [[ $# -ge 1 && -f $here/../Cargo.toml ]] || die "$usage"
  local out scene name path release folder=$work/gpu-check
  out=$(realpath -m "$1")
  mkdir -p "$folder"/{bin,lib,scenes,tests} "$(dirname "$out")"
  for scene in "${@:2}"; do
    [[ -f $scene && $scene == *.glb ]] || die "no file '$scene'; name GLB files, or none"
    [[ ! ${scene##*/} =~ ^(small|town|forest.*)\.glb$ ]] || die "rename '$scene': run generates scenes of such names"
    cp "$scene" "$folder/scenes/"
  done
  cd "$here/.."
  # A user's PATH on Debian leaves out where ldconfig lives.
  PATH=$PATH:/usr/sbin:/sbin
  command -v cargo >/dev/null || . "$HOME/.cargo/env"
  say 'building (some minutes the first time)'
  release=$(realpath -m "${CARGO_TARGET_DIR:-target}")/release
  cargo build --release --locked -p sightline-cli
  cargo build --release --locked -p sightline-trace -p sightline-sample --examples
  cp "$release"/sightline "$release"/examples/{rounds,gpu_lines} "$folder/bin/"
  cargo test --release --locked -p sightline-trace -p sightline-sample --no-run --message-format=json --lib "${tests[@]/#/--test=}" |
    python3 -c 'import json, sys
for built in map(json.loads, sys.stdin):
    if built["reason"] == "compiler-artifact" and built["executable"] and built["profile"]["test"]:
        name = built["target"]["name"]
        # Each of the two crates has unit tests; those on a device are in the first.
        unit = {"sightline_trace": "unit", "sightline_sample": "unit_of_samplers"}
        print(unit[name] if "lib" in built["target"]["kind"] else name, built["executable"])' |
    while read -r name path; do cp "$path" "$folder/tests/$name"; done
  # This fails where cargo has named no program for one of the tests.
  strip "$folder"/bin/* "$folder/tests/unit" "${tests[@]/#/$folder/tests/}"
  name=libembree4.so.4
  [ -n "$(library $name)" ] || name=libembree3.so.3
  for name in "$name" libtbb.so.12 libtbbmalloc.so.2 libvulkan.so.1; do
    path=$(library "$name")
    [ -n "$path" ] || die "the library $name is missing; scripts/setup.sh installs what the programs need"
    cp -L "$path" "$folder/lib/$name"
  done
  cp "$here/gpu-check.sh" "$folder/"
  printf '%s%s\n' "$(git rev-parse --short HEAD)" "$(git diff --quiet HEAD || echo ', with changes')" >"$folder/COMMIT"
  tar -C "$work" -cf - gpu-check | xz -T0 -2 >"$out"
  say "wrote $out, $(($(stat -c %s "$out") / 1048576)) MiB"
}

write() { printf '%s\n' "$@" >>"$work/report"; }
commands() { write '' '```sh' "$@" '```' ''; }

# A fault is said at once, and stands in the report at the end of its step. Commands without time are counted.
faults=() total=0 late=0
fault() { say "failed: $*"; faults+=("$*"); total=$((total + 1)); }

# step SECOND TITLE…: a step that ends by this second of the run. It may use the time that earlier steps left.
step() {
  [ "$late" = 0 ] || fault "no time was left for $late of the commands"
  [ ${#faults[@]} = 0 ] || write '' "${faults[@]/#/- **Failed:** }"
  faults=() late=0 until=$1
  say "${*:2}"
  write '' "## ${*:2}" ''
}

# try LIMIT COMMAND…: runs it for at most LIMIT seconds, and not beyond the step; its output goes to $work/out.
try() {
  local limit=$1 left=$((until - SECONDS)) status typed
  shift
  typed="\`${*#"$here"/}\`"
  : >"$work/out"
  [ "$left" -ge "$limit" ] || limit=$left
  [ "$limit" -ge 2 ] || { late=$((late + 1)); return 1; }
  timeout --foreground --kill-after=5 "$limit" "$@" >"$work/out" 2>"$work/err" </dev/null && return 0 || status=$?
  case $status in
    124 | 137) fault "$typed was ended after $limit s" ;;
    *) fault "$typed has status $status. $(grep -v '^$' "$work/err" | tail -n 1 | sed "s#$here/##g; s#$work/##g")" ;;
  esac
  return 1
}

# calculate EXPRESSION FORMAT: with awk, as bash has no fractions.
calculate() { awk "BEGIN { printf \"$2\", $1 }"; }
# field NAME: the last number of that name in the JSON of the last command.
field() { sed -n "s/.*\"$1\":\([0-9.e+-]*\).*/\1/p" "$work/out"; }
# What rounds has printed, without its comments, which would cut the table.
table() { grep -v '^<!--' "$work/out" | tee -a "$work/rows" >>"$work/report" || true; }
# rounds_of LIMIT ARGUMENTS…: the command and its table, as far as it came.
rounds_of() {
  try "$1" rounds "${@:2}" || [ -s "$work/out" ] || return 0
  commands "rounds ${*:2}"
  table
}
# least A B: the smaller number, where B may be missing or "max".
least() { if [[ ${2:-} =~ ^[0-9]+$ ]] && [ "$2" -lt "$1" ]; then echo "$2"; else echo "$1"; fi; }

# The profile of the adapter that rounds on a small scene take: gpu/wgpu-VERSION/vulkan/NAME/DRIVER.
probe() {
  profile='' faults=() total=0
  try 50 rounds --no-cpu small.glb 2x2x2 0.1 || return 1
  profile=$(sed -n 's#^| \(gpu/[^|]*\) |.*#\1#p' "$work/out")
  [[ ! ${profile,,} =~ llvmpipe|lavapipe|swiftshader ]]
}

find_adapter() {
  local icd=/usr/local/nvidia/share/vulkan/icd.d/nvidia_icd.json
  sightline generate town --triangles 20000 -o small.glb >/dev/null
  if ! probe && [[ -z ${VK_DRIVER_FILES:-} && -e $icd ]]; then
    say "the Vulkan loader finds no GPU by itself; trying VK_DRIVER_FILES=$icd"
    export VK_DRIVER_FILES=$icd
    probe || { unset VK_DRIVER_FILES && probe; } || true
  fi
  [ -n "$profile" ] || die 'there is no adapter to measure; see that the driver of the GPU has its Vulkan part and the libraries it loads (libegl1, libgl1, libglx0, libxext6)'
}

machine() {
  local cores memory quota period
  # A container may have fewer cores and less memory than its machine.
  read -r quota period 2>/dev/null </sys/fs/cgroup/cpu.max || quota=max
  cores=$(nproc)
  [ "$quota" = max ] || cores=$(least "$cores" $(((quota + period - 1) / period)))
  memory=$(($(sed -n 's/^MemTotal: *\([0-9]*\).*/\1/p' /proc/meminfo) * 1024))
  memory=$(least "$memory" "$(cat /sys/fs/cgroup/memory.max 2>/dev/null || true)")
  write "# $adapter" '' 'Written by `scripts/gpu-check.sh`; [README.md](README.md) says how to read it.' '' \
    "- adapter: $adapter" \
    "- driver: $driver${VK_DRIVER_FILES:+, found with VK_DRIVER_FILES}" \
    "- processor: $(sed -n '/^model name/{s/.*: //p;q}' /proc/cpuinfo), $cores cores" \
    "- memory: $(calculate "$memory / 2^30" '%.1f') GiB" \
    "- program: $(sightline --version), commit $(cat "$here/COMMIT" 2>/dev/null || echo 'not known')"
  [ -z "$software" ] || write '' "**$software.** Scenes, cells and targets are far smaller than on a GPU."
}

run_tests() {
  local name begun failed
  write 'With `CI` set, a test that finds no adapter fails.' '' '| command | passed | failed | seconds |' '|---|--:|--:|--:|'
  for name in 'unit gpu' "${tests[@]}"; do
    begun=$EPOCHREALTIME
    try 45 "$here/tests/"$name || true # of the unit tests the name has two words
    failed=$(sed -n 's/^test \(.*\) \.\.\. FAILED$/ \1/p' "$work/out" | tr -d '\n')
    [ -z "$failed" ] || faults[-1]+=" (failed tests:$failed)"
    write "| \`tests/$name\` | $(sed -n 's/^test result: .*\. \([0-9]*\) passed; \([0-9]*\) failed.*/\1 | \2/p' "$work/out" |
      grep . || echo '- | -') | $(calculate "$EPOCHREALTIME - $begun" '%.1f') |"
  done
}

compare_rounds() {
  local scene
  write '' 'Seconds are those of the rounds alone: the scene is read and kernels are ready before. *a second*: million rays.' \
    '*error*: the share of held-out lines that meet what their cell lacks, traced by the same backend.'
  for scene in "${scenes[@]}"; do
    [ $((until - SECONDS)) -ge 2 ] || { late=$((late + 1)); continue; }
    write '' "### $scene"
    : >"$work/rows"
    # Where the CPU takes too long, enough is left for the GPU alone.
    rounds_of $((until - SECONDS < 130 ? until - SECONDS - 20 : 110)) "$scene" "$cells" "${targets[@]}"
    grep -q '^| gpu | ' "$work/out" || rounds_of 40 --no-cpu "$scene" "$cells" "${targets[@]}"
    awk -F ' *[|] *' '$2 == "cpu" { cpu[$3] = $4 }
      $2 == "gpu" && $4 > 0 && cpu[$3] { ratios = ratios sprintf("%s%.2f at %s", ratios ? ", " : "", cpu[$3] / $4, $3) }
      END { if (ratios) printf "\nTime on the CPU over time on the GPU: %s.\n", ratios }' "$work/rows" >>"$work/report"
  done
}

# bake BACKEND SCENE OPTIONS…: bakes from an empty store, and sets $took, in seconds.
bake() {
  local begun=$EPOCHREALTIME
  rm -rf store x.pvs
  try 60 sightline bake "$2" -o x.pvs "${@:3}" --backend "$1" --data-dir store --json || return 1
  took=$(calculate "$EPOCHREALTIME - $begun" '%.2f')
}

compare_bakes() {
  local scene target backend took ratio
  local -A seconds samples error
  write 'Seconds of the whole command `bake`, from start to exit, with an empty store. Earlier steps have filled the shader' \
    'cache of the driver. The error is the mean share of wrong pixels, rendered by the same backend.'
  commands "sightline bake SCENE -o x.pvs --cells $cells --target-error E --backend cpu|gpu --data-dir store --json" \
    "sightline measure SCENE x.pvs --backend cpu|gpu --viewpoints $viewpoints --json"
  write '| scene | E | cpu s | gpu s | cpu / gpu | cpu error | gpu error | cpu samples | gpu samples |' \
    '|---|--:|--:|--:|--:|--:|--:|--:|--:|'
  for scene in "${scenes[@]}"; do
    for target in "${bakes[@]}"; do
      for backend in cpu gpu; do
        seconds[$backend]=- samples[$backend]=- error[$backend]=- ratio=-
        bake "$backend" "$scene" --cells "$cells" --target-error "$target" || continue
        seconds[$backend]=$took samples[$backend]=$(field samples)
        try 30 sightline measure "$scene" x.pvs --backend "$backend" --viewpoints "$viewpoints" --json || continue
        error[$backend]="$(calculate "100 * $(field mean_error)" '%.4f') %"
      done
      [ "${seconds[*]}" != '- -' ] || continue
      [[ "${seconds[*]}" == *-* ]] || ratio=$(calculate "${seconds[cpu]} / ${seconds[gpu]}" '%.2f')
      write "|$(printf ' %s |' "$scene" "$target" "${seconds[cpu]}" "${seconds[gpu]}" "$ratio" \
        "${error[cpu]}" "${error[gpu]}" "${samples[cpu]}" "${samples[gpu]}")"
    done
  done
  XDG_CACHE_HOME=$work/empty bake gpu "${scenes[0]}" --cells "$cells" --target-error "${bakes[0]}" || return 0
  write '' "With an empty shader cache the first of these bakes takes $took s on the gpu."
}

compare_cubes() {
  local scene backend
  local -A seconds samples
  write 'Whole bakes with visibility cubes instead of lines, and the cubes that were rendered.'
  commands "sightline bake SCENE -o x.pvs --sampler cubes --cells $cube_cells --backend cpu|gpu --data-dir store --json"
  write '| scene | cpu s | gpu s | cpu / gpu | cpu cubes | gpu cubes |' '|---|--:|--:|--:|--:|--:|'
  for scene in "${scenes[@]::3}"; do
    for backend in cpu gpu; do
      bake "$backend" "$scene" --sampler cubes --cells "$cube_cells" || continue 2
      seconds[$backend]=$took samples[$backend]=$(field samples)
    done
    write "|$(printf ' %s |' "$scene" "${seconds[cpu]}" "${seconds[gpu]}" "$(calculate "${seconds[cpu]} / ${seconds[gpu]}" '%.2f')" \
      "${samples[cpu]}" "${samples[gpu]}")"
  done
}

papers_forest() {
  commands "sightline generate forest ${papers[*]} -o $large"
  try 30 sightline generate forest "${papers[@]}" -o "$large" || return 0
  rounds_of 150 --no-cpu "$large" "$cells" "${papers_targets[@]}"
  write '' "Seconds a cell are seconds / $((${cells//x/*})). The papers' error is a mean share of wrong pixels; ours is that of" \
    'the table above. They used a forest of their own, a Pentium 4 and a GeForce4 Ti 4600.' '' \
    '| method | seconds a cell | error |' '|---|--:|--:|' \
    '| Nirenstein and Blake 2004, Tables 1 and 2: forest, 5m triangles, 512 cells | 9.23 | 0.338 % |'
  awk -F ' *[|] *' -v cells=$((${cells//x/*})) \
    '$2 == "gpu" { printf "| rounds, target %s | %.5f | %s |\n", $3, $4 / cells, $8 }' "$work/out" >>"$work/report"
}

profile_kernels() {
  write 'Time of each kernel on the device. To measure it lengthens the rounds.'
  rounds_of 60 --no-cpu --profile "${scenes[0]}" "$cells" "$finest"
  write '' '| kernel | ms | share | runs |' '|---|--:|--:|--:|'
  # Each line of the table comes after the kernels of its rounds.
  awk '/^<!-- .* ms in [0-9]+ runs -->$/ { if (!n) sum = 0; name[++n] = $2; ms[n] = $3; runs[n] = $6; sum += $3 }
    /^[|] / { if ($2 == "gpu") last = n; n = 0 }
    END { for (i = 1; i <= last && sum; i++) printf "| %s | %.1f | %.1f %% | %d |\n", name[i], ms[i], 100 * ms[i] / sum, runs[i]
      if (last) printf "| all | %.1f | | |\n", sum }' "$work/out" >>"$work/report"
}

run() {
  [[ $# -le 1 && -d $here/bin ]] || die "$usage"
  local out scene until=60 profile adapter driver software='' scenes=() report
  out=$(realpath -m "${1:-.}")
  mkdir -p "$out" "$work"/{scenes,cache,runtime}
  # Scenes by their names alone, and a shader cache that is empty at first.
  for scene in "$here"/scenes/*.glb; do
    [ ! -e "$scene" ] || { ln -s "$scene" "$work/scenes/" && scenes+=("${scene##*/}"); }
  done
  cd "$work/scenes"
  export PATH=$here/bin:$PATH LD_LIBRARY_PATH=$here/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH} LC_ALL=C CI=true
  export XDG_CACHE_HOME=$work/cache XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-$work/runtime}
  SECONDS=0
  find_adapter
  IFS=/ read -r _ _ _ adapter driver <<<"$profile"
  # The seconds at which the steps end, and what they measure.
  local ends=(100 280 390 420 545 575) cells=8x8x8 cube_cells=4x4x2 targets=(0.01 0.003 0.001 0.0003 0.0001) bakes=(0.01 0.001 0.0003) finest=0.0003
  local town=() forest=(--trees 100 --triangles-per-tree 1000) viewpoints=100
  local papers=(--trees 5000 --triangles-per-tree 1000) large=forest5m.glb papers_targets=(0.01 0.003)
  if [[ ${profile,,} =~ llvmpipe|lavapipe|swiftshader ]]; then
    software='This is no measurement: the adapter is a software rasteriser'
    say "$software"
    ends=(120 170 210 240 270 300) cells=4x4x4 cube_cells=1x1x1 targets=(0.03 0.01) bakes=(0.03) finest=0.01
    town=(--triangles 50000) forest=(--trees 20 --triangles-per-tree 1000) viewpoints=50
    papers=(--trees 50 --triangles-per-tree 1000) large=forest50k.glb papers_targets=(0.01)
    scenes=(${scenes[0]+"${scenes[0]}"})
  fi
  machine
  write '' '## Adapter' '' 'Rounds on a small scene, with an empty shader cache:'
  commands 'sightline generate town --triangles 20000 -o small.glb' 'rounds --no-cpu small.glb 2x2x2 0.1'
  table
  write '' "$(sed -n 's/^<!-- the \(adapter is open after .*\) -->$/The \1./p' "$work/out")"
  step "${ends[0]}" Tests
  run_tests
  step "${ends[1]}" Rounds beside Embree
  write 'Scenes that are generated:'
  commands "sightline generate town${town[*]:+ ${town[*]}} -o town.glb" "sightline generate forest ${forest[*]} -o forest.glb"
  if try 20 sightline generate town ${town[@]+"${town[@]}"} -o town.glb; then scenes+=(town.glb); fi
  if try 20 sightline generate forest "${forest[@]}" -o forest.glb; then scenes+=(forest.glb); fi
  compare_rounds
  step "${ends[2]}" Whole bakes
  compare_bakes
  step "${ends[3]}" Cubes
  compare_cubes
  step "${ends[4]}" "The papers' forest"
  papers_forest
  step "${ends[5]}" Time by kernel
  profile_kernels
  step "${ends[5]}" Outcome
  write "$([ "$total" = 0 ] && echo 'Nothing failed.' || echo "Failures, as marked above: $total.")"
  report=$out/$(printf '%s' "${adapter,,}" | tr -cs 'a-z0-9' - | sed 's/^-//; s/-$//').md
  cat -s "$work/report" >"$report" # one empty line where steps leave several
  say "wrote $report after $SECONDS s"
  [ "$total" = 0 ] || exit 1
}

case ${1:-} in
  pack) pack "${@:2}" ;;
  run) run "${@:2}" ;;
  -h | --help) sed -n '2,/^set/{/^#/s/^# \{0,1\}//p}' "$0" ;;
  *) die "$usage" ;;
esac
