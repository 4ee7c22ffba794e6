#!/usr/bin/env bash
# What takes too long for every change: the whole test of the Python package, and the Bevy example, whose
# dependencies take minutes to build.
#
#   scripts/nightly.sh
set -euo pipefail
cd "$(dirname "$0")/.."

scripts/python.sh
cd examples/bevy
cargo fmt --check
cargo test --locked
