#!/usr/bin/env bash
# Runs all checks that a change must pass. Continuous integration runs only this script.
#
#   scripts/test.sh
#
# Quick checks run first and the container test runs last. Each phase has a time limit, and the script prints its time.
# A check that cannot run prints one line. If CI is set, this line is a failure; advisories are the exception (below).
set -euo pipefail
cd "$(dirname "$0")/.."

# A fixed version, because a new version could reject an unchanged checkout.
cargo_deny_version=0.20.2

in_ci() { [ -n "${CI:-}" ] && [ "$CI" != false ]; }
die() { printf 'test: %s\n' "$*" >&2; exit 1; }
skipped() {
  printf 'not run: %s\n' "$*"
  if in_ci; then die "in continuous integration every check has to run"; fi
}

# bounded SECONDS COMMAND…: ends the command and all its children after SECONDS. timeout(1) puts them into another
# process group, which Ctrl-C does not reach. The trap ends this group.
bounded() {
  local limit=$1 status=0
  shift
  timeout --kill-after=20 "$limit" "$@" &
  local group=$!
  trap 'kill -TERM "$group" 2>/dev/null; wait "$group"; exit 130' INT TERM
  wait "$group" || status=$?
  trap - INT TERM
  if [ "$status" = 124 ] || [ "$status" = 137 ]; then
    printf 'test: ended after %s s: %s\n' "$limit" "$*" >&2
  fi
  return "$status"
}

# phase NAME COMMAND…: runs the command and stops the script if it fails.
timings=()
phase() {
  local name=$1 started=$SECONDS
  shift
  printf '\n== %s\n' "$name"
  "$@" || die "failed: $name (after $((SECONDS - started)) s)"
  timings+=("$(printf '%6d s  %s' "$((SECONDS - started))" "$name")")
  printf -- '-- %s: %d s\n' "$name" "$((SECONDS - started))"
}

# Checks licences, bans, sources and advisories. The first three need only Cargo.lock and the crates. Advisories need a
# database from the network. If it cannot be fetched, even CI omits them, because the change is not the cause.
dependencies() {
  local deny=(cargo deny) tools=$PWD/target/tools
  if ! cargo deny --version >/dev/null 2>&1; then
    if [ "$("$tools/bin/cargo-deny" --version 2>/dev/null)" != "cargo-deny $cargo_deny_version" ]; then
      # The build without optimisation takes a fraction of the time, and the check runs for one second.
      if ! CARGO_PROFILE_RELEASE_OPT_LEVEL=0 CARGO_PROFILE_RELEASE_LTO=off CARGO_PROFILE_RELEASE_CODEGEN_UNITS=16 \
        bounded 600 cargo install --quiet --locked --root "$tools" --target-dir target/tools/build \
        --version "$cargo_deny_version" cargo-deny; then
        skipped 'cargo deny (it is not installed and could not be: cargo install --locked cargo-deny)'
        return 0
      fi
      rm -rf target/tools/build
    fi
    deny=("$tools/bin/cargo-deny")
  fi
  bounded 120 "${deny[@]}" --log-level error --locked check --hide-inclusion-graph licenses bans sources || return 1
  if bounded 60 "${deny[@]}" --log-level error fetch db >/dev/null 2>&1; then
    bounded 120 "${deny[@]}" --log-level error --locked check --disable-fetch --hide-inclusion-graph advisories
  else
    printf 'not run: advisories (their database cannot be reached from here)\n'
  fi
}

# Builds the documentation site. mdBook is installed at the first run, which needs the network.
site() {
  local status=0
  bounded 900 scripts/book.sh || status=$?
  if [ "$status" = 3 ]; then
    skipped 'documentation site (mdBook is not installed and could not be: see scripts/book.sh)'
    return 0
  fi
  return "$status"
}

# Runs the container test, which prints a reason when it cannot run.
containers() {
  bounded 1200 cargo test --locked --workspace --test containers -- --nocapture
}

# Mesa's Vulkan loader prints a warning at each start without a run-time directory.
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-${TMPDIR:-/tmp}}

./scripts/setup.sh --for test
command -v cargo >/dev/null || . "$HOME/.cargo/env"

# All commands select `--workspace`. Cargo unifies features by selection, and builds dependencies again for another one.
phase 'format' bounded 60 cargo fmt --all --check
phase 'line width' bounded 60 scripts/lines.sh
phase 'prose' bounded 120 bash -c 'scripts/prose.py --self-test && scripts/prose.py'
phase 'clippy' bounded 1200 cargo clippy --locked --workspace --all-targets -- -D warnings
phase 'dependencies: licences, bans, sources, advisories' dependencies
phase 'build' bounded 2700 bash -c 'cargo build --locked --workspace && cargo test --locked --workspace --no-run'
# The integration tests run this program. Without the variable they build another one.
export SIGHTLINE_BIN=${CARGO_TARGET_DIR:-$PWD/target}/debug/sightline
phase 'deployment: compose, chart, units, alerts, certificates' bounded 300 scripts/check-deploy.sh

phase 'unit and property tests' bounded 900 cargo test --locked --workspace --lib --bins
phase 'documentation' bounded 600 env RUSTDOCFLAGS='-D warnings' cargo doc --locked --workspace --no-deps --quiet
phase 'documentation site' site
phase 'documentation tests' bounded 600 cargo test --locked --workspace --doc
phase 'integration tests' bounded 2400 scripts/run_tests.py --skip containers_
phase 'commands of the guides' bounded 900 scripts/guides.py
phase 'container test' containers

printf '\n== passed\n'
printf '%s\n' "${timings[@]}"
