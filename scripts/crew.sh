#!/usr/bin/env bash
# Compares the time of one job on a cluster of single-threaded workers with the time of `sightline bake` on
# all cores, and checks that both results have the same bytes.
#
#   scripts/crew.sh SCENE [WORKERS...]
#
# WORKERS are the numbers of workers. Default: 1 2 4. The script runs three rounds. The time of a cluster
# includes submit, watch and fetch. The variable FLAGS contains flags for bake and submit. KILL=S kills the
# leader with SIGKILL S seconds after the submission.
set -euo pipefail
cd "$(dirname "$0")/.."
program=target/release/sightline
if [ ! -x "$program" ]; then
    echo "crew: $program does not exist; run cargo build --release --workspace" >&2
    exit 1
fi
scene=${1:?scripts/crew.sh SCENE [WORKERS...]}
shift
counts=("${@:-1}")
[ $# -gt 0 ] || counts=(1 2 4)
read -ra flags <<<"${FLAGS:-}"
folder=$(mktemp -d)
started=()
workers=()
stop() {
    [ ${#started[@]} -eq 0 ] || kill "${started[@]}" 2>/dev/null || true
    wait || true
    started=()
}
trap 'stop; rm -rf "$folder"' EXIT

# milliseconds COMMAND…: Runs the command and prints its time in milliseconds.
milliseconds() {
    local begun ended
    begun=$(date +%s%N)
    "$@" >"$folder/log" 2>&1 || { cat "$folder/log" >&2; exit 1; }
    ended=$(date +%s%N)
    echo $(((ended - begun) / 1000000))
}

# kill_leader SECONDS: Waits, and kills the worker that leads the only tile: the first worker that does not
# help.
kill_leader() {
    sleep "$1"
    local i
    for i in "${!workers[@]}"; do
        grep -q "helps with" "$folder/worker-$i" || { kill -9 "${workers[$i]}"; return; }
    done
}

# cluster URL: Runs the job on the coordinator and fetches the result.
cluster() {
    "$program" submit "$scene" "${flags[@]}" --coordinator "$1" &&
        { [ -z "${KILL:-}" ] || kill_leader "$KILL"; } &&
        "$program" watch 1 --coordinator "$1" &&
        "$program" fetch 1 -o "$folder/cluster.pvs" --coordinator "$1"
}

for round in 1 2 3; do
    one=$(milliseconds "$program" bake "$scene" "${flags[@]}" -o "$folder/one.pvs" \
        --data-dir "$folder/one-$round")
    line="round $round: one process $one ms"
    for count in "${counts[@]}"; do
        data="$folder/$round-$count"
        "$program" coordinator --listen 127.0.0.1:0 --data-dir "$data" >"$folder/coordinator" 2>&1 &
        started+=($!)
        until url=$(grep -om1 'http://[0-9.:]*' "$folder/coordinator"); do sleep 0.05; done
        workers=()
        for i in $(seq 0 $((count - 1))); do
            "$program" worker --coordinator "$url" --threads 1 --backend cpu >"$folder/worker-$i" 2>&1 &
            started+=($!)
            workers+=($!)
        done
        sleep 1
        many=$(milliseconds cluster "$url")
        cmp "$folder/one.pvs" "$folder/cluster.pvs"
        line+=", $count workers $many ms ($(awk "BEGIN { printf \"%.2f\", $many / $one }"))"
        stop
    done
    echo "$line"
done
