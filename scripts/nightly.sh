#!/usr/bin/env bash
# What takes too long for every change: the whole test of the Python package, more schedules of the chaos harness, an
# hour of load and a quarter of an hour with large outputs, and the Bevy example, whose dependencies take minutes to build.
#
#   scripts/nightly.sh
set -euo pipefail
cd "$(dirname "$0")/.."

scripts/python.sh
# Another day, other seeds; whoever reads the log can repeat them.
cargo build --locked --workspace
SIGHTLINE_BIN=${CARGO_TARGET_DIR:-$PWD/target}/debug/sightline \
  scripts/chaos.sh --regressions --seed "$(date +%y%m%d)000" --schedules 250 --jobs 4
SIGHTLINE_SOAK_SECONDS=3600 cargo test --locked --workspace --test soak -- --nocapture
SIGHTLINE_SOAK_SECONDS=900 SIGHTLINE_SOAK_TRIANGLES=400000 cargo test --locked --workspace --test soak -- --nocapture
cd examples/bevy
cargo fmt --check
cargo test --locked
