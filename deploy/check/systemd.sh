#!/usr/bin/env bash
# Checks the units with systemd's own tools: that they can be read, and how much they open of the machine (0 to 10).
set -euo pipefail
cd "$(dirname "$0")/../systemd"

# What `systemd-analyze security` gives the two: 1.4 and 1.8. More than this needs a reason.
most=20 # in tenths
work=$(mktemp -d "${TMPDIR:-/tmp}/sightline-units.XXXXXX")
trap 'rm -rf "$work"' EXIT

for unit in *.service; do
  # A program that is there: `verify` looks for the one that a unit starts.
  sed 's|/usr/local/bin/sightline|/bin/true|' "$unit" >"$work/${unit/@./@1.}"
  found=$(systemd-analyze verify --man=no "$work/${unit/@./@1.}" 2>&1) && [ -z "$found" ] ||
    { printf '%s\n' "$found" >&2; printf 'systemd: %s is not valid (above)\n' "$unit" >&2; exit 1; }
  report=$(systemd-analyze security --offline=true --threshold="$most" --no-pager "$work/${unit/@./@1.}" 2>&1) ||
    { printf '%s\n' "$report" >&2; printf 'systemd: %s opens more than %s tenths (above)\n' "$unit" "$most" >&2; exit 1; }
  printf 'systemd: %s: %s\n' "$unit" "$(sed -n 's/.*exposure level for [^:]*: \([0-9.]*\).*/exposure \1/p' <<<"$report")"
done
