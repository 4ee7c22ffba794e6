#!/usr/bin/env bash
# Runs mutation tests: finds small changes of the code ("mutants") that no unit test detects ("survivors").
#
#   scripts/mutants.sh [--seed N] [--sample N] [--list] AREA…
#
# AREA is `filters` (all mutants of the exact filters), `store`, `access`, `results` or `scheduler` (a sample
# of the mutants of this part of the coordinator), or `all`. --sample is the number of mutants in a sample.
# Default: 40. --seed selects the sample. Default: 1. --list prints the mutants and runs no tests. Each mutant
# requires a build and the tests of its crate, so `all` takes hours on two cores.
#
# cargo-mutants changes the committed files in a worktree in target/mutants, one mutant at a time, and runs
# unit tests without optimisation: first the tests of the area, then all tests of the crate for the survivors.
# The reports are in target/mutants/AREA. The script prints the survivors, and fails if the tests killed fewer
# than 90 % of the mutants of an area. scripts/mutants.toml lists mutants that are equivalent to the code,
# with reasons. The script does not run these mutants.
set -euo pipefail
cd "$(dirname "$0")/.."

# The version of cargo-mutants. Another version generates other mutants, and therefore other samples.
mutants_version=27.1.0
# The share of mutants that the tests must kill, in per cent.
least_percent=90

die() { printf 'mutants: %s\n' "$*" >&2; exit 1; }

seed=1 sample=40 list=
while [ $# -gt 0 ]; do
  case $1 in
    --seed) seed=${2:?--seed needs a number}; shift 2 ;;
    --sample) sample=${2:?--sample needs a number}; shift 2 ;;
    --list) list=yes; shift ;;
    -*) die "unknown option $1; the first lines of scripts/mutants.sh list the options" ;;
    *) break ;;
  esac
done
[ $# -gt 0 ] || die 'name an area: filters, store, access, results, scheduler or all'
[ "$*" != all ] || set -- filters store access results scheduler

# Prints the exact filters: crate, file, and the prefix of the tests to run. All tests of a crate would search
# line space for most of the time.
filters() {
  cat <<'END'
sightline-geometry crates/geometry/src/predicates.rs predicates::
sightline-exact crates/exact/src/surfaces/crossing_order.rs surfaces::crossing_order::
sightline-exact crates/exact/src/geometry/predicates.rs geometry::predicates::
sightline-exact crates/exact/src/arithmetic/double_double.rs arithmetic::
sightline-exact crates/exact/src/line_space/space/rounded.rs line_space::space::
sightline-tetra crates/tetra/src/delaunay/predicates.rs delaunay::predicates::
sightline-tetra crates/tetra/src/point_query/rounded.rs point_query::rounded::
END
}

tools=$PWD/target/tools
if ! command -v cargo-mutants >/dev/null; then
  PATH=$tools/bin:$PATH
fi
if [ "$(cargo mutants --version 2>/dev/null)" != "cargo-mutants $mutants_version" ]; then
  # Without optimisation, cargo builds this tool several times faster. The builds of mutants take most of the
  # time in any case.
  CARGO_PROFILE_RELEASE_OPT_LEVEL=0 CARGO_PROFILE_RELEASE_LTO=off CARGO_PROFILE_RELEASE_CODEGEN_UNITS=16 \
    cargo install --quiet --locked --root "$tools" --target-dir target/tools/build \
    --version "$mutants_version" cargo-mutants
  PATH=$tools/bin:$PATH
fi

out=$PWD/target/mutants
tree=$out/tree
mkdir -p "$out"
git worktree remove --force "$tree" 2>/dev/null || rm -rf "$tree"
git worktree prune
git worktree add --quiet --detach "$tree" HEAD
trap 'git worktree remove --force "$tree"' EXIT
config=$PWD/scripts/mutants.toml
export CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$out/build}
# A mutant changes one function and no dependency, so incremental builds without debug information are
# fastest.
export CARGO_PROFILE_DEV_OPT_LEVEL=0 CARGO_PROFILE_DEV_DEBUG=false CARGO_INCREMENTAL=1
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-${TMPDIR:-/tmp}}

# names CRATE FILE: Prints the names of the mutants, one per line.
names() { (cd "$tree" && cargo mutants --config "$config" --package "$1" --list --file "$2"); }

# drawn CRATE FILE: Prints the names of a sample, which depends only on the seed, the size and the mutants.
drawn() {
  names "$@" | python3 -c '
import collections, hashlib, re, sys
seed, size = sys.argv[1], int(sys.argv[2])
# The keys do not contain line numbers, so that an edit of other code does not change the sample.
seen, keyed = collections.Counter(), []
for line in sys.stdin.read().splitlines():
    bare = re.sub(r":[0-9]+:[0-9]+: ", ": ", line)
    seen[bare] += 1
    keyed.append((hashlib.sha256(f"{seed}|{bare}|{seen[bare]}".encode()).digest(), line))
print("\n".join(line for _, line in sorted(keyed)[:size]))' "$seed" "$sample"
}

# matching: Reads names of mutants, one per line, and sets `arguments` to the options that select these
# mutants.
matching() {
  arguments=()
  local mutant
  while read -r mutant; do
    arguments+=(--re "^$(printf '%s' "$mutant" | sed 's/[][\.*^$+?(){}|/]/\\&/g')\$")
  done
}

# missed AREA: Prints the survivors of the first pass.
missed() {
  python3 - "$out/$1/1/mutants.out/outcomes.json" <<'END'
import json, sys
for outcome in json.load(open(sys.argv[1]))["outcomes"]:
    if outcome["summary"] == "MissedMutant":
        print(outcome["scenario"]["Mutant"]["name"])
END
}

# test_mutants OUT CRATE TESTS ARGUMENTS…: Runs the unit tests whose names contain one of TESTS on the
# selected mutants. With an empty TESTS, runs all unit tests of the crate.
test_mutants() {
  local to=$1 crate=$2 tests=$3 status=0
  shift 3
  mkdir -p "$to"
  # Status 2 means survivors, and status 3 means timeouts. `summary` reports both.
  (cd "$tree" && cargo mutants --config "$config" --package "$crate" --in-place --no-times --colors never \
    --minimum-test-timeout 60 --output "$to" "$@" -- --lib -- $tests) || status=$?
  case $status in 0 | 2 | 3) ;; *) die "cargo mutants ended with status $status for $crate" ;; esac
}

# summary AREA: Prints the survivors, and fails if too many mutants survived.
summary() {
  python3 - "$1" "$least_percent" "$out/$1"/*/mutants.out/outcomes.json <<'END'
import json, sys
area, least, files = sys.argv[1], float(sys.argv[2]), sys.argv[3:]
# The second pass ran the survivors of the first pass again with other tests, and also mutants that delete a
# field. A mutant survives if no pass killed it.
kinds = {}
for file in files:
    for outcome in json.load(open(file))["outcomes"]:
        if outcome["scenario"] != "Baseline":
            name = outcome["scenario"]["Mutant"]["name"]
            if kinds.get(name) not in ("CaughtMutant", "Timeout"):
                kinds[name] = outcome["summary"]
count = {kind: list(kinds.values()).count(kind) for kind in set(kinds.values())}
survivors = [name for name, kind in kinds.items() if kind == "MissedMutant"]
killed = count.get("CaughtMutant", 0) + count.get("Timeout", 0)
total = killed + len(survivors)
for name in survivors:
    print(f"survivor: {name}")
percent = 100 * killed / total if total else 100
print(f"{area}: {killed} of {total} mutants killed ({percent:.1f} %), "
      f"{count.get('Unviable', 0)} more do not compile")
sys.exit(percent < least)
END
}

failed=0
for area; do
  rm -rf "${out:?}/$area"
  case $area in
    filters)
      if [ -n "$list" ]; then
        filters | while read -r crate file _; do names "$crate" "$file"; done
        continue
      fi
      part=0
      while read -r crate file tests; do
        part=$((part + 1))
        test_mutants "$out/$area/$part" "$crate" "$tests" --file "$file"
      done < <(filters)
      ;;
    store | access | results | scheduler)
      case $area in
        results) crate=assemble files='crates/assemble/src/check.rs' tests= ;;
        access) crate=coordinator files='coordinator/src/access/**/*.rs' tests='access:: services::' ;;
        # The simulations with hundreds of schedules take minutes without optimisation. Only survivors need
        # them.
        store)
          crate=store files='coordinator/store/src/**/*.rs' tests='--skip store_survives_five_hundred_schedules'
          ;;
        scheduler)
          crate=scheduler files='coordinator/scheduler/src/**/*.rs'
          tests='--skip thousand_schedules_on_failing_disks --skip ten_thousand_schedules'
          ;;
      esac
      mapfile -t mutants < <(drawn "sightline-$crate" "$files")
      [ ${#mutants[@]} -gt 0 ] || die "no mutants in $files"
      if [ -n "$list" ]; then
        printf '%s\n' "${mutants[@]}"
        continue
      fi
      matching < <(printf '%s\n' "${mutants[@]}")
      # --re does not filter mutants that delete a field, so all such mutants of the area are in the sample.
      test_mutants "$out/$area/1" "sightline-$crate" "$tests" --file "$files" "${arguments[@]}"
      mapfile -t mutants < <(missed "$area")
      if [ ${#mutants[@]} -gt 0 ]; then
        matching < <(printf '%s\n' "${mutants[@]}")
        # The second pass also runs all tests of the coordinator, which uses the other crates.
        test_mutants "$out/$area/2" "sightline-$crate" '' --test-package sightline-coordinator \
          --file "$files" "${arguments[@]}"
      fi
      ;;
    *) die "unknown area $area; use filters, store, access, results, scheduler or all" ;;
  esac
  summary "$area" || failed=1
done
exit "$failed"
