#!/usr/bin/env bash
# Builds the images of compose.yaml. Does not compile the program.
#
#   deploy/build-image.sh [PROGRAM]      `sightline:local`, from a compiled program
#   deploy/build-image.sh --services     `sightline-services:local`: PostgreSQL, HAProxy and Prometheus
#
# Default of PROGRAM: $SIGHTLINE_BIN, or target/release/sightline. The program must have been compiled on the
# same or an older Debian release, because the image contains the glibc of this release. If the base image is
# missing or out of date, the script builds the base image first.
#
#   SIGHTLINE_IMAGE, SIGHTLINE_SERVICES_IMAGE
#                      names of the images. Default: sightline:local and sightline-services:local
#   SIGHTLINE_BASE     pulled image, such as debian:bookworm-slim. Default: the image of deploy/base-image.sh
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)

say() { printf 'build-image: %s\n' "$*" >&2; }
die() { say "$*"; exit 1; }

context=$(mktemp -d "${TMPDIR:-/tmp}/sightline-image.XXXXXX")
trap 'rm -rf "$context"' EXIT

if [ "${1:-}" = --services ]; then
  image=${SIGHTLINE_SERVICES_IMAGE:-sightline-services:local}
  target=services base=sightline-services-base:local dockerfile=$here/services/Dockerfile
  made_from="Debian's packages"
  cp "$here/services/postgres.sh" "$context/"
  chmod 0755 "$context/postgres.sh"
else
  program=${1:-${SIGHTLINE_BIN:-${CARGO_TARGET_DIR:-$here/../target}/release/sightline}}
  image=${SIGHTLINE_IMAGE:-sightline:local}
  target=sightline base=sightline-base:local dockerfile=$here/Dockerfile made_from=$program
  [ -f "$program" ] && [ -x "$program" ] ||
    die "$program does not exist; run cargo build --release, or deploy/build-image.sh PROGRAM"
  # The context contains only the program, so that the engine does not copy sources and build folders. Debug
  # information is most of the file, and no process in the image needs it.
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

# Debian's package of the engine does not contain the BuildKit client. The classic builder is sufficient.
docker buildx version >/dev/null 2>&1 || export DOCKER_BUILDKIT=0
log=$context/build.log
if ! docker build --build-arg "BASE=${SIGHTLINE_BASE:-$base}" --tag "$image" --file "$dockerfile" "$context" \
  >"$log" 2>&1; then
  cat "$log" >&2
  die 'docker build failed, see above'
fi
say "built $image from $made_from"
