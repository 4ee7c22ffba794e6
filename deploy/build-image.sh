#!/usr/bin/env bash
# Makes the images of compose.yaml. Builds no Rust.
#
#   deploy/build-image.sh [PROGRAM]      `sightline:local`, from a built program
#   deploy/build-image.sh --services     `sightline-services:local`: PostgreSQL, HAProxy and Prometheus
#
# PROGRAM defaults to $SIGHTLINE_BIN, then target/release/sightline. It must have been built on this Debian release or an
# older one: the image holds this release's glibc. Makes the base image first when it is missing.
#
#   SIGHTLINE_IMAGE, SIGHTLINE_SERVICES_IMAGE
#                      names of the images; default sightline:local and sightline-services:local
#   SIGHTLINE_BASE     pulled image to build on instead of the one of deploy/base-image.sh, such as debian:bookworm-slim
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)

say() { printf 'build-image: %s\n' "$*" >&2; }
die() { say "$*"; exit 1; }

context=$(mktemp -d "${TMPDIR:-/tmp}/sightline-image.XXXXXX")
trap 'rm -rf "$context"' EXIT

if [ "${1:-}" = --services ]; then
  image=${SIGHTLINE_SERVICES_IMAGE:-sightline-services:local}
  target=services base=sightline-services-base:local dockerfile=$here/services/Dockerfile made_from="Debian's packages"
  cp "$here/services/postgres.sh" "$context/"
  chmod 0755 "$context/postgres.sh"
else
  program=${1:-${SIGHTLINE_BIN:-${CARGO_TARGET_DIR:-$here/../target}/release/sightline}}
  image=${SIGHTLINE_IMAGE:-sightline:local}
  target=sightline base=sightline-base:local dockerfile=$here/Dockerfile made_from=$program
  [ -f "$program" ] && [ -x "$program" ] || die "no program at $program; cargo build --release first, or name one: deploy/build-image.sh PROGRAM"
  # A context of one file, so that neither sources nor build folders travel to the engine. Debug information stays behind:
  # it is most of the file, and nothing in the image reads it.
  if command -v strip >/dev/null; then
    strip --strip-debug -o "$context/sightline" "$program" 2>/dev/null || cp "$program" "$context/sightline"
  else
    cp "$program" "$context/sightline"
  fi
  chmod 0755 "$context/sightline"
fi

if [ -z "${SIGHTLINE_BASE:-}" ]; then
  "$here/base-image.sh" "$target"
fi

# Debian's engine comes without the BuildKit client; the classic builder does all that is needed here.
docker buildx version >/dev/null 2>&1 || export DOCKER_BUILDKIT=0
log=$context/build.log
if ! docker build --build-arg "BASE=${SIGHTLINE_BASE:-$base}" --tag "$image" --file "$dockerfile" "$context" >"$log" 2>&1; then
  cat "$log" >&2
  die "docker build failed (above)"
fi
say "made $image from $made_from"
