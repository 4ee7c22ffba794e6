#!/usr/bin/env bash
# Builds the documentation site in target/book/html, and fails if a link between its pages is dead.
#
#   scripts/book.sh
#
# docs/SUMMARY.md lists the pages. The script generates the page of all commands from the help texts of the
# program that SIGHTLINE_BIN names. Default: target/debug/sightline. Exit code 3: mdBook is not installed, and
# the script cannot install mdBook.
set -euo pipefail
cd "$(dirname "$0")/.."

# The version of mdBook. Another version may generate other anchors.
mdbook_version=0.5.4

die() { printf 'book: %s\n' "$*" >&2; exit 1; }

program=${SIGHTLINE_BIN:-${CARGO_TARGET_DIR:-$PWD/target}/debug/sightline}
[ -x "$program" ] || die "$program does not exist; run cargo build --locked --workspace"

tools=$PWD/target/tools
PATH=$tools/bin:$PATH
if [ "$(mdbook --version 2>/dev/null)" != "mdbook v$mdbook_version" ]; then
  # mdBook runs for one second, so compile it without optimisation and without its server.
  CARGO_PROFILE_RELEASE_OPT_LEVEL=0 CARGO_PROFILE_RELEASE_LTO=off CARGO_PROFILE_RELEASE_CODEGEN_UNITS=16 \
    cargo install --quiet --locked --root "$tools" --target-dir target/tools/build --no-default-features \
    --features search --version "$mdbook_version" mdbook || exit 3
  rm -rf target/tools/build
fi

out=$PWD/target/book
scripts/book.py stage "$out" "$program"
mdbook build "$out"
scripts/book.py check "$out/html"
