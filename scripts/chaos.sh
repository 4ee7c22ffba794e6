#!/usr/bin/env bash
# Runs the chaos harness, which injects faults into a farm of real processes: scripts/chaos.sh --help.
#
#   scripts/chaos.sh [--seed N] [--schedules N] [--jobs N] [--keep DIR]
#
# The harness runs in separate namespaces, so that its processes, mounts and devices end with this command.
set -euo pipefail
export PYTHONPATH=$(cd "$(dirname "$0")" && pwd)${PYTHONPATH:+:$PYTHONPATH}
# On Debian, the PATH of users other than root lacks the folder of ip.
PATH=$PATH:/usr/sbin:/sbin
export PYTHONDONTWRITEBYTECODE=1

# These options only print text, so they need no namespaces.
for word in "$@"; do
  case $word in -h | --help | --print) exec python3 -m chaos "$@" ;; esac
done
if ! why=$(unshare --mount --net --pid --fork --mount-proc true 2>&1); then
  echo "chaos: cannot run here: this system permits no new namespaces: $why" >&2
  exit 2
fi
# unshare ignores SIGINT and SIGTERM, so the trap kills it. With --kill-child, all processes of the harness
# then end.
export TMPDIR=$(mktemp -d "${TMPDIR:-/tmp}/sightline-chaos.XXXXXX")
setpriv --pdeathsig KILL unshare --mount --net --pid --fork --kill-child --mount-proc python3 -m chaos "$@" &
all=$!
trap 'trap "" INT TERM; kill -KILL "$all" 2>/dev/null || true; wait "$all" 2>/dev/null || true
  rm -rf "$TMPDIR"' EXIT
trap 'exit 130' INT TERM
status=0
wait "$all" || status=$?
exit "$status"
