#!/usr/bin/env bash
# What takes too long for every change: the Bevy example, whose dependencies take minutes to build.
#
#   scripts/nightly.sh
set -euo pipefail
cd "$(dirname "$0")/.."

cd examples/bevy
cargo fmt --check
cargo test --locked
