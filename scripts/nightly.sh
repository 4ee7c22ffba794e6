#!/usr/bin/env bash
# The checks that are too long for every change: the whole test of the Python package, more schedules of the chaos
# harness, an hour of fuzzing, an hour of load and a quarter of an hour with large outputs, damaged journals and failing
# disks, hostile clients by the thousand, and the Bevy example, whose
# dependencies take minutes to build.
#
#   scripts/nightly.sh
set -euo pipefail
cd "$(dirname "$0")/.."

scripts/python.sh
# Another day, other seeds; whoever reads the log can repeat them.
cargo build --locked --workspace
SIGHTLINE_BIN=${CARGO_TARGET_DIR:-$PWD/target}/debug/sightline \
  scripts/chaos.sh --regressions --seed "$(date +%y%m%d)000" --schedules 250 --jobs 4
# Damage at every byte of a journal; the store and its blobs, and whole clusters with them, on disks that fail.
first=$(($(date +%s) / 86400 * 100000))
printf 'schedules from SIGHTLINE_FIRST=%s on\n' "$first"
SIGHTLINE_FIRST=$first SIGHTLINE_SCHEDULES=100000 cargo test --locked --workspace --lib -- --ignored \
  damage_at_every_byte_loses_no_job_silently store_survives_many_schedules many_schedules_on_failing_disks
# The fuzz targets, for an hour with other mutations in each round.
fuzzed_until=$((SECONDS + 3600))
seed=$(date +%y%m%d)0000
while [ "$SECONDS" -lt "$fuzzed_until" ]; do
  seed=$((seed + 1000))
  printf 'fuzz targets with SIGHTLINE_FUZZ_SEED=%s\n' "$seed"
  SIGHTLINE_FUZZ_SEED=$seed cargo test --locked --workspace --test fuzzed --test mutations
  SIGHTLINE_FUZZ_SEED=$seed cargo test --locked --workspace --lib -- fuzzed_
done
SIGHTLINE_SOAK_SECONDS=3600 cargo test --locked --workspace --test soak -- --nocapture
SIGHTLINE_SOAK_SECONDS=900 SIGHTLINE_SOAK_TRIANGLES=400000 cargo test --locked --workspace --test soak -- --nocapture
# The test has a socket for each connection, too.
ulimit -n "$(ulimit -H -n)"
SIGHTLINE_HOSTILE=full cargo test --locked --workspace --test hostile -- --nocapture --test-threads 1
cd examples/bevy
cargo fmt --check
cargo test --locked
