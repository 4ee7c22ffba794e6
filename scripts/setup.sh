#!/usr/bin/env bash
# Installs what Sightline needs from Debian's packages and this machine lacks. Debian 12 and newer; with Rust already there.
#
#   scripts/setup.sh [--for run|test]      default: run
#
# run   a C compiler (some crates build C), the Vulkan loader and a driver, Embree's run-time library
# test  that, git, strace, what the chaos harness needs (ip, openssl, faketime), and where CI is set what checks deploy/, a container
#       engine, compose and debootstrap. Elsewhere no engine is installed unasked,
#       for its daemon runs as root; where one already runs, what the container test needs beside it is completed.
#
# Quick when nothing is missing, and then needs neither root nor network. Rust crates are cargo's affair, not this script's.
set -euo pipefail

say() { printf 'setup: %s\n' "$*" >&2; }
die() { say "$*"; exit 1; }

purpose=run
while [ $# -gt 0 ]; do
  case $1 in
    --for)
      purpose=${2:-}
      shift 2 || die '--for wants run or test'
      ;;
    *) die "unknown argument '$1'; usage: scripts/setup.sh [--for run|test]" ;;
  esac
done
case $purpose in run | test) ;; *) die "--for wants run or test, not '$purpose'" ;; esac

# A user's PATH on Debian leaves out where ldconfig and debootstrap live.
PATH=$PATH:/usr/sbin:/sbin

have() { command -v "$1" >/dev/null 2>&1; }
libraries=$(ldconfig -p)
have_library() { [[ $libraries == *"$1 "* ]]; }
have_vulkan_driver() { compgen -G '/usr/share/vulkan/icd.d/*.json' >/dev/null || compgen -G '/etc/vulkan/icd.d/*.json' >/dev/null; }
in_ci() { [ -n "${CI:-}" ] && [ "$CI" != false ]; }
engine_answers() { docker info >/dev/null 2>&1; }
have_compose() { have docker-compose || docker compose version >/dev/null 2>&1; }

if ! have cargo && [ -r "$HOME/.cargo/env" ]; then
  # rustup writes this for login shells; a script started elsewhere has not read it.
  . "$HOME/.cargo/env"
fi
have cargo || die 'cargo is not on the PATH; install Rust 1.90 or newer (https://rustup.rs), open a new shell and run this again'

# Every missing thing adds one entry "package<TAB>what it is for" here.
missing=()
need() { missing+=("$1"$'\t'"$2"); }

have cc || need gcc 'C compiler, for crates that build C (zstd, blake3)'
[ -e /usr/include/stdlib.h ] || need libc6-dev 'C headers'
have_library libvulkan.so.1 || need libvulkan1 'Vulkan loader'
have_vulkan_driver || need mesa-vulkan-drivers 'Vulkan drivers, among them lavapipe for machines without a GPU'
have_library libembree3.so.3 || have_library libembree4.so.4 || need EMBREE 'Embree, the CPU ray tracer'

if [ "$purpose" = test ]; then
  have git || need git 'cargo deny fetches the advisories with it'
  have chromedriver || need chromium-driver 'drives the browser of the tests of pages'
  have chromium || need chromium 'the browser of the tests of pages'
  compgen -G '/usr/lib/postgresql/*/bin/initdb' >/dev/null || need postgresql 'the database of the tests of replicas, and of the chaos harness'
  have mcs || need mono-mcs 'compiles and runs the test of the C# reader'
  python3 -c 'import venv, ensurepip' 2>/dev/null || need python3-venv 'builds the Python package for its test, and checks the chart'
  have strace || need strace 'records the order of system calls, for the tests of what is synced'
  have openssl || need openssl 'makes certificates, of the chaos harness too'
  # Two of them are daemons, which a package starts; elsewhere scripts/check-deploy.sh says what it leaves out.
  if in_ci; then
    have systemd-analyze || need systemd 'checks the units'
    have promtool || need prometheus 'its promtool checks the rules of alerts'
    have haproxy || need haproxy 'checks its own configuration'
  fi
  have ip || need iproute2 'network namespaces of the chaos harness'
  compgen -G '/usr/lib/*/faketime/libfaketimeMT.so.1' >/dev/null || need faketime 'steps the clock in the chaos harness'
  if in_ci || engine_answers; then
    engine_answers || have dockerd || need docker.io 'container engine, for the container test'
    # Debian 13 packs the engine's command line apart from the daemon; on Debian 12 docker.io holds both.
    have docker || need DOCKER_CLI 'command line of the container engine'
    have_compose || need docker-compose 'compose, for the container test'
    have debootstrap || need debootstrap 'makes the base image where none can be pulled'
  else
    say "no container engine answers: the container test will not run (to have it: apt-get install docker.io docker-compose debootstrap)"
  fi
fi

if [ ${#missing[@]} -gt 0 ]; then
  have apt-get || die "missing: $(printf '%s; ' "${missing[@]#*$'\t'}")and there is no apt-get here to install them; install them by your system's means"
  as_root=()
  if [ "$(id -u)" != 0 ]; then
    have sudo || die "missing: $(printf '%s; ' "${missing[@]#*$'\t'}")installing needs root; run this as root once, or install sudo"
    as_root=(sudo)
  fi
  log=$(mktemp "${TMPDIR:-/tmp}/sightline-setup.XXXXXX")
  trap 'rm -f "$log"' EXIT
  "${as_root[@]}" apt-get update -q >"$log" 2>&1 ||
    { tail -n 15 "$log" >&2; die 'apt-get update failed (above); check the network and /etc/apt/sources.list'; }

  installable() { [ -n "$(apt-cache policy "$1" 2>/dev/null | awk '/Candidate:/ && $2 != "(none)" { print $2 }')" ]; }
  packages=()
  for entry in "${missing[@]}"; do
    package=${entry%%$'\t'*}
    purpose_text=${entry#*$'\t'}
    case $package in
      EMBREE)
        if installable libembree4-4; then package=libembree4-4
        elif installable libembree3-3; then package=libembree3-3
        else die 'apt offers neither libembree4-4 nor libembree3-3; enable Debian main, or install Embree 3 or 4 by hand'; fi ;;
      DOCKER_CLI)
        installable docker-cli || continue
        package=docker-cli ;;
    esac
    case " ${packages[*]} " in *" $package "*) continue ;; esac
    say "installing $package: $purpose_text"
    packages+=("$package")
  done
  "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends "${packages[@]}" >"$log" 2>&1 ||
    { tail -n 25 "$log" >&2; die "apt-get could not install ${packages[*]} (above); repair that and run this again"; }
fi

# Installing the engine's package starts it where an init system runs; a bare container or a rescue shell has none.
if [ "$purpose" = test ] && in_ci && ! engine_answers; then
  as_root=()
  [ "$(id -u)" = 0 ] || as_root=(sudo)
  say 'starting the container engine'
  if [ -d /run/systemd/system ]; then
    "${as_root[@]}" systemctl start docker || true
  else
    # service(8) knows dockerd's flags from /etc/default/docker; starting it is all that is wanted here.
    "${as_root[@]}" service docker start >/dev/null 2>&1 || true
  fi
  for _ in $(seq 30); do
    engine_answers && break
    sleep 1
  done
  engine_answers || say "the container engine does not answer; see 'docker info' and /var/log/docker.log (as a plain user: join the group docker)"
fi
