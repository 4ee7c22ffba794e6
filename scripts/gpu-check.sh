#!/usr/bin/env bash
# Tests and measures the gpu backend on a machine that may lack a network and Rust.
#
#   scripts/gpu-check.sh pack OUT.tar.xz [SCENE.glb…]   on a machine with Rust
#   ./gpu-check.sh run [OUT_DIR]                        on the machine with the GPU, in the unpacked folder
#
# pack  Builds the programs and packs the folder gpu-check. The folder contains release builds of sightline,
#       of the examples rounds and gpu_lines, and of the tests that need an adapter. It also contains Embree,
#       TBB, the Vulkan loader, the given scenes and this script. The programs contain their shaders. The
#       other machine needs the same architecture, a C library of the same version or newer, libstdc++ and
#       the driver of the GPU.
# run   Writes the report OUT_DIR/ADAPTER.md. Default of OUT_DIR: the current folder. The report contains the
#       results of the tests, the times of rounds and whole bakes on the GPU and on the CPU, the papers'
#       forest, and the time of each kernel. The run takes less than ten minutes on a GPU. On a software
#       rasteriser it takes less than five minutes, and the times are not meaningful. If a command fails or
#       takes too long, the report names the command instead of its result, and the script ends with status 1.
set -euo pipefail

say() { printf 'gpu-check: %s\n' "$*" >&2; }
die() { say "$*"; exit 2; }
usage='usage: scripts/gpu-check.sh pack OUT.tar.xz [SCENE.glb…] in a checkout, or ./gpu-check.sh run'
usage+=' [OUT_DIR] in the unpacked folder'

tests=(gpu_cubes gpu_lines gpu_rounds sides tiles)
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d "${TMPDIR:-/tmp}/gpu-check.XXXXXX")
trap 'rm -rf "$work"' EXIT
trap 'exit 130' INT TERM

# library NAME: Prints the path of a shared library, or nothing if the loader does not find the library.
library() { ldconfig -p | awk -v name="$1" '$1 == name && !found { print $NF; found = 1 }'; }

pack() {
  [[ $# -ge 1 && -f $here/../Cargo.toml ]] || die "$usage"
  local out scene name path release folder=$work/gpu-check
  out=$(realpath -m "$1")
  mkdir -p "$folder"/{bin,lib,scenes,tests} "$(dirname "$out")"
  for scene in "${@:2}"; do
    [[ -f $scene && $scene == *.glb ]] || die "'$scene' is not a GLB file; name GLB files, or none"
    [[ ! ${scene##*/} =~ ^(small|town|forest.*)\.glb$ ]] ||
      die "rename '$scene': the command run generates scenes with such names"
    cp "$scene" "$folder/scenes/"
  done
  cd "$here/.."
  # On Debian, the PATH of users other than root lacks the folder of ldconfig.
  PATH=$PATH:/usr/sbin:/sbin
  command -v cargo >/dev/null || . "$HOME/.cargo/env"
  say 'building (the first build takes several minutes)'
  release=$(realpath -m "${CARGO_TARGET_DIR:-target}")/release
  cargo build --release --locked -p sightline-cli
  cargo build --release --locked -p sightline-trace -p sightline-sample --examples
  cp "$release"/sightline "$release"/examples/{rounds,gpu_lines} "$folder/bin/"
  cargo test --release --locked -p sightline-trace -p sightline-sample --no-run --message-format=json --lib \
    "${tests[@]/#/--test=}" |
    python3 -c 'import json, sys
for built in map(json.loads, sys.stdin):
    if built["reason"] == "compiler-artifact" and built["executable"] and built["profile"]["test"]:
        name = built["target"]["name"]
        # Both crates have unit tests. The unit tests that need a device are in sightline_trace.
        unit = {"sightline_trace": "unit", "sightline_sample": "unit_of_samplers"}
        print(unit[name] if "lib" in built["target"]["kind"] else name, built["executable"])' |
    while read -r name path; do cp "$path" "$folder/tests/$name"; done
  # If cargo built no program for a test, `strip` fails because the file is missing.
  strip "$folder"/bin/* "$folder/tests/unit" "${tests[@]/#/$folder/tests/}"
  name=libembree4.so.4
  [ -n "$(library $name)" ] || name=libembree3.so.3
  for name in "$name" libtbb.so.12 libtbbmalloc.so.2 libvulkan.so.1; do
    path=$(library "$name")
    [ -n "$path" ] || die "the library $name is missing; install it with scripts/setup.sh"
    cp -L "$path" "$folder/lib/$name"
  done
  cp "$here/gpu-check.sh" "$folder/"
  printf '%s%s\n' "$(git rev-parse --short HEAD)" "$(git diff --quiet HEAD || echo ', with changes')" \
    >"$folder/COMMIT"
  tar -C "$work" -cf - gpu-check | xz -T0 -2 >"$out"
  say "wrote $out, $(($(stat -c %s "$out") / 1048576)) MiB"
}

# write LINE…: Appends lines to the report.
write() { printf '%s\n' "$@" >>"$work/report"; }
# commands LINE…: Appends a block of commands to the report.
commands() { write '' '```sh' "$@" '```' ''; }

# The faults of the current step, the number of all faults, and the number of commands that the step skipped
# because its time had ended.
faults=() total=0 late=0
# fault TEXT…: Prints a fault and stores it. `step` writes the faults of a step to the report at its end.
fault() { say "failed: $*"; faults+=("$*"); total=$((total + 1)); }

# step SECOND TITLE…: Ends the previous step and begins a step, which must end at this second of the run. The
# step can use the time that earlier steps did not use.
step() {
  [ "$late" = 0 ] || fault "$late commands were skipped, because the time of the step had ended"
  [ ${#faults[@]} = 0 ] || write '' "${faults[@]/#/- **Failed:** }"
  faults=() late=0 until=$1
  say "${*:2}"
  write '' "## ${*:2}" ''
}

# try LIMIT COMMAND…: Runs the command for at most LIMIT seconds and at most until the end of the step, and
# writes its output to $work/out.
try() {
  local limit=$1 left=$((until - SECONDS)) status typed
  shift
  typed="\`${*#"$here"/}\`"
  : >"$work/out"
  [ "$left" -ge "$limit" ] || limit=$left
  [ "$limit" -ge 2 ] || { late=$((late + 1)); return 1; }
  timeout --foreground --kill-after=5 "$limit" "$@" >"$work/out" 2>"$work/err" </dev/null &&
    return 0 || status=$?
  case $status in
    124 | 137) fault "$typed exceeded the time limit of $limit s" ;;
    *)
      fault "$typed ended with status $status." \
        "$(grep -v '^$' "$work/err" | tail -n 1 | sed "s#$here/##g; s#$work/##g")"
      ;;
  esac
  return 1
}

# calculate EXPRESSION FORMAT: Prints a value with awk, because bash computes only integers.
calculate() { awk "BEGIN { printf \"$2\", $1 }"; }
# field NAME: Prints the last number with this name in the JSON output of the last command.
field() { sed -n "s/.*\"$1\":\([0-9.e+-]*\).*/\1/p" "$work/out"; }
# table: Appends the output of rounds to the report, without comments, which would end the Markdown table.
table() { grep -v '^<!--' "$work/out" | tee -a "$work/rows" >>"$work/report" || true; }
# rounds_of LIMIT ARGUMENTS…: Runs rounds, and appends the command and the complete or partial table to the
# report.
rounds_of() {
  try "$1" rounds "${@:2}" || [ -s "$work/out" ] || return 0
  commands "rounds ${*:2}"
  table
}
# least A B: Prints the smaller number. B can be empty or "max", which stand for no limit.
least() { if [[ ${2:-} =~ ^[0-9]+$ ]] && [ "$2" -lt "$1" ]; then echo "$2"; else echo "$1"; fi; }

# probe: Runs rounds on a small scene and sets `profile` to the numerics profile of the adapter,
# gpu/wgpu-VERSION/vulkan/NAME/DRIVER. Fails if the command fails or the adapter is a software rasteriser.
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
    say "the Vulkan loader found no GPU; trying VK_DRIVER_FILES=$icd"
    export VK_DRIVER_FILES=$icd
    probe || { unset VK_DRIVER_FILES && probe; } || true
  fi
  [ -n "$profile" ] || die 'no Vulkan adapter was found; install the Vulkan part of the GPU driver, and the' \
    'libraries that the driver loads (libegl1, libgl1, libglx0, libxext6)'
}

machine() {
  local cores memory quota period
  # The limits of a container can be lower than the cores and the memory of the machine.
  read -r quota period 2>/dev/null </sys/fs/cgroup/cpu.max || quota=max
  cores=$(nproc)
  [ "$quota" = max ] || cores=$(least "$cores" $(((quota + period - 1) / period)))
  memory=$(($(sed -n 's/^MemTotal: *\([0-9]*\).*/\1/p' /proc/meminfo) * 1024))
  memory=$(least "$memory" "$(cat /sys/fs/cgroup/memory.max 2>/dev/null || true)")
  write "# $adapter" '' 'Written by `scripts/gpu-check.sh`; [README.md](README.md) describes the columns.' \
    '' "- adapter: $adapter" \
    "- driver: $driver${VK_DRIVER_FILES:+, found with VK_DRIVER_FILES}" \
    "- processor: $(sed -n '/^model name/{s/.*: //p;q}' /proc/cpuinfo), $cores cores" \
    "- memory: $(calculate "$memory / 2^30" '%.1f') GiB" \
    "- program: $(sightline --version), commit $(cat "$here/COMMIT" 2>/dev/null || echo unknown)"
  [ -z "$software" ] ||
    write '' "**$software.** The run uses smaller scenes and fewer cells and targets than on a GPU."
}

run_tests() {
  local name begun failed counts
  write 'With `CI` set, a test that finds no adapter fails.' '' '| command | passed | failed | seconds |' \
    '|---|--:|--:|--:|'
  for name in 'unit gpu' "${tests[@]}"; do
    begun=$EPOCHREALTIME
    try 45 "$here/tests/"$name || true # Unquoted, because the first name is a program and an argument.
    failed=$(sed -n 's/^test \(.*\) \.\.\. FAILED$/ \1/p' "$work/out" | tr -d '\n')
    [ -z "$failed" ] || faults[-1]+=" (failed tests:$failed)"
    counts=$(sed -n 's/^test result: .*\. \([0-9]*\) passed; \([0-9]*\) failed.*/\1 | \2/p' "$work/out" |
      grep . || echo '- | -')
    write "| \`tests/$name\` | $counts | $(calculate "$EPOCHREALTIME - $begun" '%.1f') |"
  done
}

compare_rounds() {
  local scene
  write '' 'Seconds are the time of the rounds, without loading the scene and building the kernels. *a' \
    'second*: million rays per second. *error*: the share of held-out lines whose triangle is missing from' \
    'the set of the cell, by the same backend.'
  for scene in "${scenes[@]}"; do
    [ $((until - SECONDS)) -ge 2 ] || { late=$((late + 1)); continue; }
    write '' "### $scene"
    : >"$work/rows"
    # The first limit leaves time for a second command with only the GPU, if the CPU exceeds its limit.
    rounds_of $((until - SECONDS < 130 ? until - SECONDS - 20 : 110)) "$scene" "$cells" "${targets[@]}"
    grep -q '^| gpu | ' "$work/out" || rounds_of 40 --no-cpu "$scene" "$cells" "${targets[@]}"
    awk -F ' *[|] *' '$2 == "cpu" { cpu[$3] = $4 }
      $2 == "gpu" && $4 > 0 && cpu[$3] {
        ratios = ratios sprintf("%s%.2f at %s", ratios ? ", " : "", cpu[$3] / $4, $3)
      }
      END { if (ratios) printf "\nCPU time divided by GPU time: %s.\n", ratios }' "$work/rows" \
      >>"$work/report"
  done
}

# bake BACKEND SCENE OPTIONS…: Bakes with an empty store, and sets `took` to the time in seconds.
bake() {
  local begun=$EPOCHREALTIME
  rm -rf store x.pvs
  try 60 sightline bake "$2" -o x.pvs "${@:3}" --backend "$1" --data-dir store --json || return 1
  took=$(calculate "$EPOCHREALTIME - $begun" '%.2f')
}

compare_bakes() {
  local scene target backend took ratio
  local -A seconds samples error
  write 'Seconds of the whole command `bake`, from start to exit, with an empty store. Earlier steps have' \
    'filled the shader cache of the driver. The error is the mean share of wrong pixels, rendered by the' \
    'same backend.'
  local options="--target-error E --backend cpu|gpu --data-dir store --json"
  commands "sightline bake SCENE -o x.pvs --cells $cells $options" \
    "sightline measure SCENE x.pvs --backend cpu|gpu --viewpoints $viewpoints --json"
  write '| scene | E | cpu s | gpu s | cpu / gpu | cpu error | gpu error | cpu samples | gpu samples |' \
    '|---|--:|--:|--:|--:|--:|--:|--:|--:|'
  for scene in "${scenes[@]}"; do
    for target in "${bakes[@]}"; do
      for backend in cpu gpu; do
        seconds[$backend]=- samples[$backend]=- error[$backend]=- ratio=-
        bake "$backend" "$scene" --cells "$cells" --target-error "$target" || continue
        seconds[$backend]=$took samples[$backend]=$(field samples)
        try 30 sightline measure "$scene" x.pvs --backend "$backend" --viewpoints "$viewpoints" --json ||
          continue
        error[$backend]="$(calculate "100 * $(field mean_error)" '%.4f') %"
      done
      [ "${seconds[*]}" != '- -' ] || continue
      [[ "${seconds[*]}" == *-* ]] || ratio=$(calculate "${seconds[cpu]} / ${seconds[gpu]}" '%.2f')
      write "|$(printf ' %s |' "$scene" "$target" "${seconds[cpu]}" "${seconds[gpu]}" "$ratio" \
        "${error[cpu]}" "${error[gpu]}" "${samples[cpu]}" "${samples[gpu]}")"
    done
  done
  XDG_CACHE_HOME=$work/empty bake gpu "${scenes[0]}" --cells "$cells" --target-error "${bakes[0]}" || return 0
  write '' "With an empty shader cache, the first of these bakes takes $took s on the GPU."
}

compare_cubes() {
  local scene backend
  local -A seconds samples
  write 'Seconds of whole bakes with visibility cubes instead of lines, and the number of rendered cubes.'
  local options="--backend cpu|gpu --data-dir store --json"
  commands "sightline bake SCENE -o x.pvs --sampler cubes --cells $cube_cells $options"
  write '| scene | cpu s | gpu s | cpu / gpu | cpu cubes | gpu cubes |' '|---|--:|--:|--:|--:|--:|'
  for scene in "${scenes[@]::3}"; do
    for backend in cpu gpu; do
      bake "$backend" "$scene" --sampler cubes --cells "$cube_cells" || continue 2
      seconds[$backend]=$took samples[$backend]=$(field samples)
    done
    write "|$(printf ' %s |' "$scene" "${seconds[cpu]}" "${seconds[gpu]}" \
      "$(calculate "${seconds[cpu]} / ${seconds[gpu]}" '%.2f')" "${samples[cpu]}" "${samples[gpu]}")"
  done
}

papers_forest() {
  commands "sightline generate forest ${papers[*]} -o $large"
  try 30 sightline generate forest "${papers[@]}" -o "$large" || return 0
  rounds_of 150 --no-cpu "$large" "$cells" "${papers_targets[@]}"
  write '' "Seconds per cell are seconds / $((${cells//x/*})). The papers' error is the mean share of wrong" \
    'pixels; our error is the column *error* of the table above. The papers used another forest, a Pentium' \
    '4 and a GeForce4 Ti 4600.' '' '| method | seconds per cell | error |' '|---|--:|--:|' \
    '| Nirenstein and Blake 2004, Tables 1 and 2: forest, 5m triangles, 512 cells | 9.23 | 0.338 % |'
  awk -F ' *[|] *' -v cells=$((${cells//x/*})) \
    '$2 == "gpu" { printf "| rounds, target %s | %.5f | %s |\n", $3, $4 / cells, $8 }' "$work/out" \
    >>"$work/report"
}

profile_kernels() {
  write 'Time of each kernel on the device. This measurement lengthens the rounds.'
  rounds_of 60 --no-cpu --profile "${scenes[0]}" "$cells" "$finest"
  write '' '| kernel | ms | share | runs |' '|---|--:|--:|--:|'
  # rounds prints the kernels of a row before the row.
  awk '/^<!-- .* ms in [0-9]+ runs -->$/ {
      if (!n) sum = 0
      name[++n] = $2; ms[n] = $3; runs[n] = $6; sum += $3
    }
    /^[|] / { if ($2 == "gpu") last = n; n = 0 }
    END { for (i = 1; i <= last && sum; i++)
        printf "| %s | %.1f | %.1f %% | %d |\n", name[i], ms[i], 100 * ms[i] / sum, runs[i]
      if (last) printf "| all | %.1f | | |\n", sum }' "$work/out" >>"$work/report"
}

run() {
  [[ $# -le 1 && -d $here/bin ]] || die "$usage"
  local out scene until=60 profile adapter driver software='' scenes=() report
  out=$(realpath -m "${1:-.}")
  mkdir -p "$out" "$work"/{scenes,cache,runtime}
  # Links to the scenes in one folder, so that commands in the report contain no paths.
  for scene in "$here"/scenes/*.glb; do
    [ ! -e "$scene" ] || { ln -s "$scene" "$work/scenes/" && scenes+=("${scene##*/}"); }
  done
  cd "$work/scenes"
  export PATH=$here/bin:$PATH LD_LIBRARY_PATH=$here/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH} LC_ALL=C CI=true
  # The shader cache is empty at first.
  export XDG_CACHE_HOME=$work/cache XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-$work/runtime}
  SECONDS=0
  find_adapter
  IFS=/ read -r _ _ _ adapter driver <<<"$profile"
  # The seconds at which the steps end, and the sizes and target errors of the measurements.
  local ends=(100 280 390 420 545 575) cells=8x8x8 cube_cells=4x4x2
  local targets=(0.01 0.003 0.001 0.0003 0.0001) bakes=(0.01 0.001 0.0003) finest=0.0003
  local town=() forest=(--trees 100 --triangles-per-tree 1000) viewpoints=100
  local papers=(--trees 5000 --triangles-per-tree 1000) large=forest5m.glb papers_targets=(0.01 0.003)
  if [[ ${profile,,} =~ llvmpipe|lavapipe|swiftshader ]]; then
    software='The times of this report are not meaningful: the adapter is a software rasteriser'
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
  step "${ends[1]}" Rounds compared with Embree
  write 'Generated scenes:'
  commands "sightline generate town${town[*]:+ ${town[*]}} -o town.glb" \
    "sightline generate forest ${forest[*]} -o forest.glb"
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
  write "$([ "$total" = 0 ] && echo 'All commands succeeded.' ||
    echo "Failures: $total. The sections above describe the failures.")"
  report=$out/$(printf '%s' "${adapter,,}" | tr -cs 'a-z0-9' - | sed 's/^-//; s/-$//').md
  cat -s "$work/report" >"$report" # -s reduces several empty lines to one.
  say "wrote $report after $SECONDS s"
  [ "$total" = 0 ] || exit 1
}

case ${1:-} in
  pack) pack "${@:2}" ;;
  run) run "${@:2}" ;;
  -h | --help) sed -n '2,/^set/{/^#/s/^# \{0,1\}//p}' "$0" ;;
  *) die "$usage" ;;
esac
