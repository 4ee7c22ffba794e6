#!/usr/bin/env bash
# Whether this version of the program goes on from where an earlier one stopped, with real processes.
#
#   scripts/upgrade-check.sh OLD
#
# OLD is a commit, whose program is built in a temporary worktree, or a program that is built already. Its coordinator
# ends one job, is stopped in the middle of a second one, and this version's coordinator starts on its data. Then
#   - the job that was done is there, its result has the same bytes, and this program reads it;
#   - a worker of OLD works, or is refused with an error that names both versions;
#   - the second job goes on from the tiles that were done to the bytes that OLD's program bakes alone, or it fails with
#     a reason that names the other version;
#   - a new job is done.
# The program of this version is SIGHTLINE_BIN, or target/debug/sightline, which is built. Exit code 0 when all that
# holds, 1 when it does not.
set -euo pipefail
shopt -s extglob

say() { printf '== %s\n' "$*"; }
die() { printf 'upgrade-check: %s\n' "$*" >&2; exit "${2:-1}"; }

[ $# -eq 1 ] || die "give the earlier version: a commit, or a program" 2
case $1 in
  -h | --help)
    sed -n '2,/^set/{/^#/s/^# \{0,1\}//p}' "$0"
    exit 0
    ;;
esac
old=$1
root=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d)
running=()
clean_up() {
  for process in "${running[@]}"; do kill "$process" 2>/dev/null || true; done
  wait
  git -C "$root" worktree remove --force "$work/tree" 2>/dev/null || true
  rm -rf "$work"
}
trap clean_up EXIT

if [ -f "$old" ] && [ -x "$old" ]; then
  old=$(realpath "$old")
else
  commit=$(git -C "$root" rev-parse --verify --quiet "$old^{commit}") || die "$old is no commit and no program" 2
  say "building the program of $commit"
  git -C "$root" worktree add --quiet --detach "$work/tree" "$commit"
  # Not into this version's folder, whose program is compared with it.
  (cd "$work/tree" && CARGO_TARGET_DIR=$work/tree/target cargo build --locked --quiet --bin sightline)
  old=$work/tree/target/debug/sightline
fi
new=${SIGHTLINE_BIN:-}
if [ -z "$new" ]; then
  (cd "$root" && CARGO_TARGET_DIR=$root/target cargo build --locked --quiet --bin sightline)
  new=$root/target/debug/sightline
fi
new=$(realpath "$new")
cd "$work"

# serve PROGRAM NAME: starts a coordinator on the data; sets url and coordinator.
serve() {
  "$1" coordinator --listen 127.0.0.1:0 --data-dir data >"$2.out" 2>"$2.err" &
  coordinator=$!
  running+=("$coordinator")
  for _ in $(seq 300); do
    url=$(sed -n 's/^listening on //p' "$2.out")
    [ -n "$url" ] && return
    kill -0 "$coordinator" 2>/dev/null || die "the coordinator has not started: $(cat "$2.err")"
    sleep 0.1
  done
  die "the coordinator does not listen: $(cat "$2.err")"
}

# work_for PROGRAM NAME: starts a worker; sets worker.
work_for() {
  "$1" worker --backend cpu --threads 1 --name "$2" --coordinator "$url" 2>"$2.err" &
  worker=$!
  running+=("$worker")
}

# quietly COMMAND...: runs it, and shows what it says where it fails.
quietly() { "$@" >said 2>&1 || die "$* has failed: $(cat said)"; }

stop() {
  kill "$1"
  wait "$1" || true
}

# field PROGRAM JOB NAME: a text or a number of a job.
field() {
  "$1" show "$2" --json --coordinator "$url" |
    sed -n -e "s/.*[{,]\"$3\":\"\([^\"]*\)\".*/\1/p" -e "s/.*[{,]\"$3\":\([0-9]*\)[,}].*/\1/p"
}

# until_is PROGRAM JOB PATTERN: waits for a state of a job.
until_is() {
  for _ in $(seq 3000); do
    state=$(field "$1" "$2" state)
    # shellcheck disable=SC2254  # The pattern is one.
    case $state in $3) return ;; esac
    sleep 0.1
  done
  die "job $2 is still $state: $("$1" logs "$2" --coordinator "$url" | tail -3)"
}

small="rooms.glb --cells 2x2x1 --backend cpu"
large="rooms.glb --cells 8x8x4 --block-cells 4 --backend cpu --cell-to-cell off"
say "with $("$old" --version)"
quietly "$old" generate rooms --triangles 2000 -o rooms.glb
# shellcheck disable=SC2086  # Several arguments.
quietly "$old" bake $large -o alone.pvs --data-dir alone
serve "$old" before
work_for "$old" old
# shellcheck disable=SC2086
done_job=$("$old" submit $small --coordinator "$url" 2>said) || die "$(cat said)"
until_is "$old" "$done_job" done
quietly "$old" fetch "$done_job" -o before.pvs --coordinator "$url"
# shellcheck disable=SC2086
begun_job=$("$old" submit $large --coordinator "$url" 2>said) || die "$(cat said)"
for _ in $(seq 3000); do
  tiles=$(field "$old" "$begun_job" tiles_done)
  [ "$tiles" -ge 3 ] && break
  sleep 0.05
done
stop "$worker"
stop "$coordinator"
say "job $done_job is done, and the coordinator was stopped when job $begun_job had $tiles tiles"

say "with $("$new" --version)"
serve "$new" after
[ "$(field "$new" "$done_job" state)" = done ] || die "job $done_job is not done any more"
quietly "$new" fetch "$done_job" -o after.pvs --coordinator "$url"
cmp before.pvs after.pvs || die "the result of job $done_job has other bytes"
quietly "$new" info after.pvs
say "job $done_job is there, with the same bytes"
kept=$(field "$new" "$begun_job" tiles_done)

work_for "$old" old
sleep 3
if kill -0 "$worker" 2>/dev/null; then
  say "the worker of before works"
  stop "$worker"
else
  wait "$worker" && die "the worker of before has ended without an error"
  grep -q "version" old.err || die "the worker of before is refused, and does not say why: $(cat old.err)"
  say "the worker of before is refused: $(grep -m 1 "version" old.err)"
fi

work_for "$new" new
until_is "$new" "$begun_job" '@(done|failed)'
if [ "$state" = done ]; then
  [ "$kept" -ge "$tiles" ] || die "of $tiles tiles that were done there were $kept after the start"
  quietly "$new" fetch "$begun_job" -o begun.pvs --coordinator "$url"
  cmp alone.pvs begun.pvs || die "the result of job $begun_job is not that of the program of before"
  say "job $begun_job went on from $kept tiles, to the bytes that the program of before bakes alone"
else
  reason=$(field "$new" "$begun_job" reason)
  case $reason in
    *"another version"*) say "job $begun_job is refused: $reason" ;;
    *) die "job $begun_job has failed, and its reason names no version: $reason" ;;
  esac
fi
# shellcheck disable=SC2086
next_job=$("$new" submit $small --seed 2 --coordinator "$url" 2>said) || die "$(cat said)"
until_is "$new" "$next_job" done
say "a new job is done: this version goes on from there"
