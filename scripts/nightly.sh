#!/usr/bin/env bash
# Runs the checks that take too long for every change:
#
# - the tests of the Python package that pip builds
# - ten million rays of each kind against a search through all triangles
# - the tests of the cpu tracer on another kind of processor (NEON, under qemu) and in WebAssembly (Node.js)
# - the commands of the guides
# - 250 schedules of the chaos harness
# - tests with damaged journals and failing disks
# - the fuzz targets, for an hour
# - the load test, for an hour, and with large outputs for a quarter of an hour
# - the test with more than a thousand hostile clients
# - the Bevy example, whose dependencies take minutes to build
#
#   scripts/nightly.sh
set -euo pipefail
cd "$(dirname "$0")/.."

scripts/python.sh
SIGHTLINE_RAYS=10000000 cargo test --locked --workspace --lib -- --ignored many_rays_have_hits_of_search
if [ "$(uname -m)" = x86_64 ]; then
  rustup target add aarch64-unknown-linux-gnu
  command -v qemu-aarch64-static >/dev/null && command -v aarch64-linux-gnu-g++ >/dev/null || {
    printf 'nightly: install the Debian packages qemu-user-static and g++-aarch64-linux-gnu\n' >&2
    exit 1
  }
  CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc \
    CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER='qemu-aarch64-static -L /usr/aarch64-linux-gnu' \
    cargo test --locked -p sightline-trace --target aarch64-unknown-linux-gnu --lib -- \
      cpu:: lines::packet_walk
fi
rustup target add wasm32-wasip1
command -v clang >/dev/null && command -v node >/dev/null && [ -d /usr/include/wasm32-wasi ] || {
  printf 'nightly: install Node.js 20 or later, and the Debian packages clang and wasi-libc\n' >&2
  exit 1
}
# WASI has no threads. The concurrent compiler of Node.js 20 sometimes crashes.
CC_wasm32_wasip1=clang CFLAGS_wasm32_wasip1=--target=wasm32-wasi \
  CARGO_TARGET_WASM32_WASIP1_RUSTFLAGS='-C target-feature=+simd128' \
  CARGO_TARGET_WASM32_WASIP1_RUNNER="node --no-warnings --single-threaded $PWD/scripts/run_wasi.mjs" \
  cargo test --locked -p sightline-trace --target wasm32-wasip1 --lib -- \
    --test-threads 1 cpu:: lines::packet_walk
cargo build --locked --workspace
export SIGHTLINE_BIN=${CARGO_TARGET_DIR:-$PWD/target}/debug/sightline
scripts/guides.py
# The seeds depend on the date, so that each night tests other schedules. The log contains the seeds for a
# repetition.
scripts/chaos.sh --regressions --seed "$(date +%y%m%d)000" --schedules 250 --jobs 4
# These tests damage every byte of a journal, and run the store, its blobs and whole clusters on failing
# disks.
first=$(($(date +%s) / 86400 * 100000))
printf 'schedules start at SIGHTLINE_FIRST=%s\n' "$first"
SIGHTLINE_FIRST=$first SIGHTLINE_SCHEDULES=100000 cargo test --locked --workspace --lib -- --ignored \
  damage_at_every_byte_loses_no_job_silently store_survives_many_schedules many_schedules_on_failing_disks
# The fuzz targets run for an hour, with other mutations in each round.
fuzzed_until=$((SECONDS + 3600))
seed=$(date +%y%m%d)0000
while [ "$SECONDS" -lt "$fuzzed_until" ]; do
  seed=$((seed + 1000))
  printf 'fuzz targets with SIGHTLINE_FUZZ_SEED=%s\n' "$seed"
  SIGHTLINE_FUZZ_SEED=$seed cargo test --locked --workspace --test fuzzed --test mutations
  SIGHTLINE_FUZZ_SEED=$seed cargo test --locked --workspace --lib -- fuzzed_
done
SIGHTLINE_SOAK_SECONDS=3600 cargo test --locked --workspace --test soak -- --nocapture
SIGHTLINE_SOAK_SECONDS=900 SIGHTLINE_SOAK_TRIANGLES=400000 cargo test --locked --workspace --test soak -- \
  --nocapture
# The test opens one socket per connection, so it needs the maximum number of open files.
ulimit -n "$(ulimit -H -n)"
SIGHTLINE_HOSTILE=full cargo test --locked --workspace --test hostile -- --nocapture --test-threads 1
cd examples/bevy
cargo fmt --check
cargo test --locked
