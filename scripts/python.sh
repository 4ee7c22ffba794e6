#!/usr/bin/env bash
# Builds the Python package as a user does, with pip, in an environment of its own, and runs its tests and the example
# of its README with it. This compiles everything once more, optimised, and so is not part of scripts/test.sh; there the
# same tests run with the library that is built with the program.
#
#   scripts/python.sh
set -euo pipefail
cd "$(dirname "$0")/.."

target=${CARGO_TARGET_DIR:-$PWD/target}
environment=$(mktemp -d "${TMPDIR:-/tmp}/sightline-python.XXXXXX")
trap 'rm -rf "$environment"' EXIT

python3 -m venv "$environment"
CARGO_TARGET_DIR=$target "$environment/bin/python" -m pip install --quiet --disable-pip-version-check './python[test]'
cargo build --release --locked
cd "$environment"
SIGHTLINE_BIN=$target/release/sightline PYTHONDONTWRITEBYTECODE=1 \
  "$environment/bin/python" -m pytest --quiet -p no:cacheprovider "$OLDPWD/python/tests"
