#!/usr/bin/env bash
# Builds the Python package with pip in a new virtual environment, as a user does, and runs the tests of the
# package. The tests include the example of its README. pip compiles all crates again with optimisation, so
# scripts/test.sh does not run this script. scripts/test.sh runs the same tests with the library that cargo
# builds next to the program.
#
#   scripts/python.sh
set -euo pipefail
cd "$(dirname "$0")/.."

target=${CARGO_TARGET_DIR:-$PWD/target}
environment=$(mktemp -d "${TMPDIR:-/tmp}/sightline-python.XXXXXX")
trap 'rm -rf "$environment"' EXIT

python3 -m venv "$environment"
CARGO_TARGET_DIR=$target "$environment/bin/python" -m pip install --quiet --disable-pip-version-check \
  './python[test]'
cargo build --release --locked
cd "$environment"
SIGHTLINE_BIN=$target/release/sightline PYTHONDONTWRITEBYTECODE=1 \
  "$environment/bin/python" -m pytest --quiet -p no:cacheprovider "$OLDPWD/python/tests"
