#!/usr/bin/env bash
# Breaks a farm of real processes by seeded schedules of faults: scripts/chaos.sh --help.
#
#   scripts/chaos.sh [--seed N] [--schedules N] [--jobs N] [--keep DIR]
#
# All of it runs in namespaces of its own, so that nothing of it outlives this command: processes, mounts, devices.
set -euo pipefail
export PYTHONPATH=$(cd "$(dirname "$0")" && pwd)${PYTHONPATH:+:$PYTHONPATH}
# A user's PATH on Debian leaves out where ip lives.
PATH=$PATH:/usr/sbin:/sbin
export PYTHONDONTWRITEBYTECODE=1

# What needs no namespaces.
for word in "$@"; do
  case $word in -h | --help | --print) exec python3 -m chaos "$@" ;; esac
done
if ! why=$(unshare --mount --net --pid --fork --mount-proc true 2>&1); then
  echo "chaos: cannot run here: namespaces cannot be made: $why" >&2
  exit 2
fi
# unshare itself ignores signals that ask it to end; with its death all of it ends.
export TMPDIR=$(mktemp -d "${TMPDIR:-/tmp}/sightline-chaos.XXXXXX")
setpriv --pdeathsig KILL unshare --mount --net --pid --fork --kill-child --mount-proc python3 -m chaos "$@" &
all=$!
trap 'trap "" INT TERM; kill -KILL "$all" 2>/dev/null || true; wait "$all" 2>/dev/null || true; rm -rf "$TMPDIR"' EXIT
trap 'exit 130' INT TERM
status=0
wait "$all" || status=$?
exit "$status"
