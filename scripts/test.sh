#!/usr/bin/env bash
# Everything that has to hold before a change goes in; continuous integration runs just this.
#
#   scripts/test.sh
#
# Quick checks first, the container test last. Each phase says how long it took and is bounded in time. A check that
# cannot run says so in one line; where CI is set that is a failure, except for the advisories (see below).
set -euo pipefail
cd "$(dirname "$0")/.."

# Held to this version, so that a new one cannot turn an unchanged checkout red.
cargo_deny_version=0.20.2

in_ci() { [ -n "${CI:-}" ] && [ "$CI" != false ]; }
die() { printf 'test: %s\n' "$*" >&2; exit 1; }
skipped() {
  printf 'not run: %s\n' "$*"
  if in_ci; then die "in continuous integration every check has to run"; fi
}

# bounded SECONDS COMMAND…: ends the command and all its children after that time. timeout(1) puts them in a process group
# of their own, where Ctrl-C does not reach them; hence the trap.
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

# phase NAME COMMAND…: stops the script when the command fails.
timings=()
phase() {
  local name=$1 started=$SECONDS
  shift
  printf '\n== %s\n' "$name"
  "$@" || die "failed: $name (after $((SECONDS - started)) s)"
  timings+=("$(printf '%6d s  %s' "$((SECONDS - started))" "$name")")
  printf -- '-- %s: %d s\n' "$name" "$((SECONDS - started))"
}

# Licences, sources and bans need nothing but Cargo.lock and the crates. Advisories need a database from the network;
# where that cannot be fetched they are left out even in CI, as the outcome would say nothing about the change.
dependencies() {
  local deny=(cargo deny) tools=$PWD/target/tools
  if ! cargo deny --version >/dev/null 2>&1; then
    if [ "$("$tools/bin/cargo-deny" --version 2>/dev/null)" != "cargo-deny $cargo_deny_version" ]; then
      # It runs for a second and is built on the spot: unoptimised, it is ready several times sooner.
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

# The container test brings its own clock; here it is only seen to that it is not left out silently.
containers() {
  bounded 1200 cargo test --locked --workspace --test containers -- --nocapture
}

# Mesa's Vulkan loader complains on every start when it has no run-time directory.
export XDG_RUNTIME_DIR=${XDG_RUNTIME_DIR:-${TMPDIR:-/tmp}}

./scripts/setup.sh --for test
command -v cargo >/dev/null || . "$HOME/.cargo/env"

# `--workspace` everywhere: with other selections cargo unifies features anew and builds the dependencies again.
phase 'format' bounded 60 cargo fmt --all --check
phase 'line width' bounded 60 scripts/lines.sh
phase 'clippy' bounded 1200 cargo clippy --locked --workspace --all-targets -- -D warnings
phase 'dependencies: licences, bans, sources, advisories' dependencies
phase 'build' bounded 2700 bash -c 'cargo build --locked --workspace && cargo test --locked --workspace --no-run'
# The integration tests run this program; without it they would build one of their own.
export SIGHTLINE_BIN=${CARGO_TARGET_DIR:-$PWD/target}/debug/sightline
phase 'deployment: compose, chart, units, alerts, certificates' bounded 300 scripts/check-deploy.sh

phase 'unit and property tests' bounded 900 cargo test --locked --workspace --lib --bins
phase 'documentation' bounded 600 env RUSTDOCFLAGS='-D warnings' cargo doc --locked --workspace --no-deps --quiet
phase 'documentation tests' bounded 600 cargo test --locked --workspace --doc
phase 'integration tests' bounded 2400 scripts/run_tests.py --skip containers_
phase 'container test' containers

printf '\n== passed\n'
printf '%s\n' "${timings[@]}"
