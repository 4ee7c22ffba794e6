#!/usr/bin/env bash
# Makes the image `sightline:local` from a built program: deploy/build-image.sh [PROGRAM]
#
# PROGRAM defaults to $SIGHTLINE_BIN, then target/release/sightline. It must have been built on this Debian release or an
# older one: the image holds this release's glibc. Makes the base image first when it is missing. Builds no Rust.
#
#   SIGHTLINE_IMAGE    name of the image; default sightline:local
#   SIGHTLINE_BASE     pulled image to build on instead of sightline-base:local, such as debian:bookworm-slim
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)

say() { printf 'build-image: %s\n' "$*" >&2; }
die() { say "$*"; exit 1; }

program=${1:-${SIGHTLINE_BIN:-${CARGO_TARGET_DIR:-$here/../target}/release/sightline}}
image=${SIGHTLINE_IMAGE:-sightline:local}
[ -f "$program" ] && [ -x "$program" ] || die "no program at $program; cargo build --release first, or name one: deploy/build-image.sh PROGRAM"

if [ -z "${SIGHTLINE_BASE:-}" ]; then
  "$here/base-image.sh"
fi

# A context of one file, so that neither sources nor build folders travel to the engine. Debug information stays behind:
# it is most of the file, and nothing in the image reads it.
context=$(mktemp -d "${TMPDIR:-/tmp}/sightline-image.XXXXXX")
trap 'rm -rf "$context"' EXIT
if command -v strip >/dev/null; then
  strip --strip-debug -o "$context/sightline" "$program" 2>/dev/null || cp "$program" "$context/sightline"
else
  cp "$program" "$context/sightline"
fi
chmod 0755 "$context/sightline"

# Debian's engine comes without the BuildKit client; the classic builder does all that is needed here.
docker buildx version >/dev/null 2>&1 || export DOCKER_BUILDKIT=0
log=$context/build.log
if ! docker build --build-arg "BASE=${SIGHTLINE_BASE:-sightline-base:local}" --tag "$image" \
    --file "$here/Dockerfile" "$context" >"$log" 2>&1; then
  cat "$log" >&2
  die "docker build failed (above)"
fi
say "made $image from $program"
