#!/usr/bin/env bash
# Installs the Debian packages that Sightline needs and that this machine lacks. Requires Debian 12 or newer
# and an installed Rust toolchain.
#
#   scripts/setup.sh [--for run|test]      default: run
#
# run   a C compiler for crates that compile C, the Vulkan loader, and a Vulkan driver
# test  the packages of run, and the tools of scripts/test.sh: Embree, curl, git, strace, openssl, a browser and its driver,
#       PostgreSQL, Mono, venv for Python, and ip and faketime for the chaos harness. If CI is set, also the
#       tools that check deploy/, a container engine, compose and debootstrap. Without CI, the script does not
#       install a container engine, because the daemon of the engine runs as root. If an engine already runs,
#       the script installs the other tools of the container test.
#
# If no package is missing, the script needs neither root nor a network. It does not install Rust crates:
# cargo downloads them during a build.
set -euo pipefail

say() { printf 'setup: %s\n' "$*" >&2; }
die() { say "$*"; exit 1; }

purpose=run
while [ $# -gt 0 ]; do
  case $1 in
    --for)
      purpose=${2:-}
      shift 2 || die '--for needs a value: run or test'
      ;;
    *) die "unknown argument '$1'; usage: scripts/setup.sh [--for run|test]" ;;
  esac
done
case $purpose in run | test) ;; *) die "--for must be run or test, got '$purpose'" ;; esac

# On Debian, the PATH of users other than root lacks the folders of ldconfig and debootstrap.
PATH=$PATH:/usr/sbin:/sbin

have() { command -v "$1" >/dev/null 2>&1; }
libraries=$(ldconfig -p)
have_library() { [[ $libraries == *"$1 "* ]]; }
have_vulkan_driver() {
  compgen -G '/usr/share/vulkan/icd.d/*.json' >/dev/null || compgen -G '/etc/vulkan/icd.d/*.json' >/dev/null
}
in_ci() { [ -n "${CI:-}" ] && [ "$CI" != false ]; }
engine_answers() { docker info >/dev/null 2>&1; }
have_compose() { have docker-compose || docker compose version >/dev/null 2>&1; }

if ! have cargo && [ -r "$HOME/.cargo/env" ]; then
  # This file of rustup adds cargo to the PATH. Only login shells read the file by themselves.
  . "$HOME/.cargo/env"
fi
have cargo || die 'cargo is not on the PATH; install Rust 1.90 or newer (https://rustup.rs), open a new' \
  'shell and run scripts/setup.sh again'

# The missing packages. Each entry is "package<TAB>purpose".
missing=()
# need PACKAGE PURPOSE: Adds an entry to the missing packages.
need() { missing+=("$1"$'\t'"$2"); }

have cc || need gcc 'C compiler, for crates that compile C (zstd, blake3)'
[ -e /usr/include/stdlib.h ] || need libc6-dev 'C headers'
have_library libvulkan.so.1 || need libvulkan1 'Vulkan loader'
have_vulkan_driver || need mesa-vulkan-drivers 'Vulkan drivers, including lavapipe for machines without a GPU'

if [ "$purpose" = test ]; then
  have_library libembree3.so.3 || have_library libembree4.so.4 ||
    need EMBREE 'Embree, for the tests of the backend embree and for the chaos harness'
  have curl || need curl 'curl, which the commands of docs/farm.md use'
  have git || need git 'git, with which cargo deny downloads security advisories'
  have chromedriver || need chromium-driver 'driver of the browser, for the tests of web pages'
  have chromium || need chromium 'browser, for the tests of web pages'
  compgen -G '/usr/lib/postgresql/*/bin/initdb' >/dev/null ||
    need postgresql 'database, for the tests of several coordinators and for the chaos harness'
  have mcs || need mono-mcs 'C# compiler and run-time, for the test of the C# reader'
  python3 -c 'import venv, ensurepip' 2>/dev/null ||
    need python3-venv 'virtual environments, for the tests of the Python package and the check of the chart'
  have strace || need strace 'recorder of system calls, for the tests of the sync order'
  have openssl || need openssl 'creation of certificates, for tests and for the chaos harness'
  # The packages prometheus and haproxy start daemons, so the script installs these tools only in continuous
  # integration. Without them, scripts/check-deploy.sh prints a line for each check that it skips.
  if in_ci; then
    have systemd-analyze || need systemd 'systemd-analyze, for the check of the units'
    have promtool || need prometheus 'promtool, for the check of the alert rules'
    have haproxy || need haproxy 'HAProxy, for the check of its configuration'
  fi
  have ip || need iproute2 'creation of network namespaces, for the chaos harness'
  compgen -G '/usr/lib/*/faketime/libfaketimeMT.so.1' >/dev/null ||
    need faketime 'changes of the clock, for the chaos harness'
  if in_ci || engine_answers; then
    engine_answers || have dockerd || need docker.io 'container engine, for the container test'
    # In Debian 13, the package docker-cli contains the command line; in Debian 12, docker.io contains it.
    have docker || need DOCKER_CLI 'command line of the container engine'
    have_compose || need docker-compose 'compose, for the container test'
    have debootstrap || need debootstrap 'creation of the base image without a registry'
  else
    say 'no container engine answers, so the container test will not run; to run it:' \
      'apt-get install docker.io docker-compose debootstrap'
  fi
fi

if [ ${#missing[@]} -gt 0 ]; then
  purposes=$(printf '%s; ' "${missing[@]#*$'\t'}")
  have apt-get ||
    die "missing: ${purposes}apt-get does not exist here; use the package manager of your system"
  as_root=()
  if [ "$(id -u)" != 0 ]; then
    have sudo || die "missing: ${purposes}run scripts/setup.sh as root to install these, or install sudo"
    as_root=(sudo)
  fi
  log=$(mktemp "${TMPDIR:-/tmp}/sightline-setup.XXXXXX")
  trap 'rm -f "$log"' EXIT
  "${as_root[@]}" apt-get update -q >"$log" 2>&1 ||
    { tail -n 15 "$log" >&2; die 'apt-get update failed, see above; check the network and apt sources'; }

  # installable PACKAGE: Succeeds if apt offers a version of the package.
  installable() {
    [ -n "$(apt-cache policy "$1" 2>/dev/null | awk '/Candidate:/ && $2 != "(none)" { print $2 }')" ]
  }
  packages=()
  for entry in "${missing[@]}"; do
    package=${entry%%$'\t'*}
    purpose_text=${entry#*$'\t'}
    case $package in
      EMBREE)
        if installable libembree4-4; then package=libembree4-4
        elif installable libembree3-3; then package=libembree3-3
        else
          die 'apt offers neither libembree4-4 nor libembree3-3; enable the component main of Debian, or' \
            'install Embree 3 or 4 yourself'
        fi ;;
      DOCKER_CLI)
        installable docker-cli || continue
        package=docker-cli ;;
    esac
    case " ${packages[*]} " in *" $package "*) continue ;; esac
    say "installing $package: $purpose_text"
    packages+=("$package")
  done
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
    apt-get install -q -y --no-install-recommends "${packages[@]}" >"$log" 2>&1 || {
    tail -n 25 "$log" >&2
    die "apt-get could not install ${packages[*]}, see above; fix the cause and run scripts/setup.sh again"
  }
fi

# The package of the engine starts the daemon only if an init system runs. A container has no init system, so
# the script starts the daemon.
if [ "$purpose" = test ] && in_ci && ! engine_answers; then
  as_root=()
  [ "$(id -u)" = 0 ] || as_root=(sudo)
  say 'starting the container engine'
  if [ -d /run/systemd/system ]; then
    "${as_root[@]}" systemctl start docker || true
  else
    # service(8) reads the options of dockerd from /etc/default/docker.
    "${as_root[@]}" service docker start >/dev/null 2>&1 || true
  fi
  for _ in $(seq 30); do
    engine_answers && break
    sleep 1
  done
  engine_answers || say "the container engine does not answer; see 'docker info' and /var/log/docker.log." \
    'If you are not root, join the group docker'
fi
