#!/usr/bin/env bash
# Builds the base image of a Dockerfile from Debian packages, without a registry:
#
#   sightline  `sightline-base:local`: Mesa's Vulkan driver, for deploy/Dockerfile
#   services   `sightline-services-base:local`: PostgreSQL, HAProxy and Prometheus, for services/Dockerfile
#
# debootstrap installs the Debian release of the host from the mirror that the host's apt uses. The image and
# the host therefore have the same C library and the same version of Mesa. If the image exists and this
# version of the script built it with the same packages, the script does not build it again. The image does
# not contain the program; deploy/build-image.sh adds the program.
#
#   deploy/base-image.sh [--force] [sightline|services]        default: sightline
#
#   --force            build the image again, also if it is up to date
#   SIGHTLINE_SUITE    code name of the Debian release. Default: the release of the host, or bookworm if the
#                      host is not Debian
#   SIGHTLINE_MIRROR   Debian mirror. Default: the mirror in the host's apt sources
set -euo pipefail

say() { printf 'base-image: %s\n' "$*" >&2; }
die() { say "$*"; exit 1; }

# apt_mirror SUITE: Prints the first mirror in apt's sources whose suite is the Debian release itself. Reads
# "deb [options] URI SUITE …" lines and deb822 paragraphs, and ignores addresses other than http and https.
apt_mirror() {
  local suite=$1 file
  for file in /etc/apt/sources.list /etc/apt/sources.list.d/*.list /etc/apt/sources.list.d/*.sources; do
    [ -r "$file" ] || continue
    awk -v suite="$suite" -v deb822="$([[ $file == *.sources ]] && echo 1 || echo 0)" '
      function paragraph() {
        if (types ~ /(^| )deb( |$)/ && (" " suites " ") ~ (" " suite " ") && uri && enabled != "no") print uri
        types = suites = uri = enabled = ""
      }
      /^[[:space:]]*#/ { next }
      deb822 && /^[[:space:]]*$/ { paragraph(); next }
      deb822 { key = tolower($1); value = $0; sub(/^[^:]*:[[:space:]]*/, "", value)
               if (key == "types:") types = value
               if (key == "suites:") suites = value
               if (key == "uris:") { split(value, all, /[[:space:]]+/); uri = all[1] }
               if (key == "enabled:") enabled = tolower(value)
               next }
      $1 == "deb" { sub(/\[[^]]*\]/, ""); if ($3 == suite) print $2 }
      END { if (deb822) paragraph() }' "$file"
  done | grep -E '^https?://' | head -n 1 || true
}

force=0 target=sightline
for argument in "$@"; do
  case $argument in
    --force) force=1 ;;
    sightline | services) target=$argument ;;
    *) die "unknown argument '$argument'; usage: deploy/base-image.sh [--force] [sightline|services]" ;;
  esac
done

host_suite=$(. /etc/os-release && [ "${ID:-}" = debian ] && printf '%s' "${VERSION_CODENAME:-}" || true)
suite=${SIGHTLINE_SUITE:-${host_suite:-bookworm}}
mirror=${SIGHTLINE_MIRROR:-$(apt_mirror "$suite")}
mirror=${mirror:-http://deb.debian.org/debian}
# The package ca-certificates is for object stores, whose certificates come from public authorities.
case $target in
  sightline) image=sightline-base:local packages=libvulkan1,mesa-vulkan-drivers,ca-certificates ;;
  services) image=sightline-services-base:local packages=postgresql,haproxy,prometheus ;;
esac

command -v docker >/dev/null ||
  die 'docker is not installed; run apt-get install docker.io or scripts/setup.sh --for test'
docker info >/dev/null 2>&1 ||
  die 'no container engine answers; start the engine (systemctl start docker), or join the group docker'

recipe=$(printf '%s\n' "$suite" "$packages" "$(sha256sum <"$0")" | sha256sum | cut -d ' ' -f 1)
made=$(docker image inspect --format '{{ index .Config.Labels "sightline.recipe" }}' "$image" 2>/dev/null || true)
if [ "$force" = 0 ] && [ "$made" = "$recipe" ]; then
  say "$image is up to date ($suite)"
  exit 0
fi

command -v debootstrap >/dev/null || PATH=$PATH:/usr/sbin
command -v debootstrap >/dev/null ||
  die 'debootstrap is not installed; run apt-get install debootstrap or scripts/setup.sh --for test'
as_root=()
if [ "$(id -u)" != 0 ]; then
  command -v sudo >/dev/null ||
    die 'debootstrap needs root; run deploy/base-image.sh as root, or install sudo'
  as_root=(sudo)
fi

work=$(mktemp -d "${TMPDIR:-/tmp}/sightline-base.XXXXXX")
trap '"${as_root[@]}" rm -rf --one-file-system "$work"' EXIT
root=$work/root

say "building $image: Debian $suite with $packages (this takes about one minute)"
if ! "${as_root[@]}" debootstrap --variant=minbase --include="$packages" "$suite" "$root" "$mirror" \
  >"$work/log" 2>&1; then
  tail -n 20 "$work/log" >&2
  [ -r "$root/debootstrap/debootstrap.log" ] && tail -n 20 "$root/debootstrap/debootstrap.log" >&2
  die "debootstrap failed, see above; check that $mirror is reachable, or name a mirror in SIGHTLINE_MIRROR"
fi

# The image does not contain caches, logs, documentation and settings of the host. The public mirror of Debian
# replaces the mirror of the host.
"${as_root[@]}" sh -eu -c '
  cd "$1"
  rm -rf var/cache/apt/* var/lib/apt/lists/* var/log/* usr/share/doc usr/share/man usr/share/info usr/share/locale tmp/*
  rm -f etc/resolv.conf etc/hostname
  echo "deb http://deb.debian.org/debian $2 main" >etc/apt/sources.list' sh "$root" "$suite"

"${as_root[@]}" tar -C "$root" --numeric-owner -c . |
  docker import \
    --change "LABEL sightline.recipe=$recipe" \
    --change 'ENV PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin' \
    --change 'CMD ["/bin/bash"]' \
    - "$image" >/dev/null
say "built $image, $(docker image inspect --format '{{ .Size }}' "$image" | awk '{ printf "%.0f MB", $1 / 1e6 }')"
