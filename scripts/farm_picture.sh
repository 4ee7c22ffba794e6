#!/usr/bin/env bash
# Creates docs/farm.png: the dashboard of a coordinator while two workers compute a job.
#
#   scripts/farm_picture.sh
#
# The script needs chromium and chromedriver (scripts/setup.sh --for test). After the build of the program, it
# takes half a minute.
set -euo pipefail
cd "$(dirname "$0")/.."

work=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null; wait; rm -rf "$work"' EXIT
cargo build --quiet --release --locked
sightline=$(realpath "${CARGO_TARGET_DIR:-target}")/release/sightline
"$sightline" generate town --triangles 40000 -o "$work/town.glb"
"$sightline" coordinator --data-dir "$work/data" --listen 127.0.0.1:0 --http 127.0.0.1:0 \
  >"$work/out" 2>"$work/err" &
for _ in $(seq 100); do
  [ "$(wc -l <"$work/out")" = 2 ] && break
  sleep 0.1
done
url=$(sed -n 's/listening on //p' "$work/out")
pages=$(sed -n 's/dashboard on //p' "$work/out")
for name in ann bob; do
  "$sightline" worker --coordinator "$url" --backend cpu --threads 1 --name "$name" >"$work/$name" 2>&1 &
done
"$sightline" submit "$work/town.glb" --cells 32x4x16 --block-cells 32 --backend cpu --coordinator "$url"
# After 6 seconds, about half of the tiles are done.
sleep 6
scripts/screenshot.py "$pages#job=1" docs/farm.png 1100 1180 3
