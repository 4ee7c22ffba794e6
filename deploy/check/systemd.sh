#!/usr/bin/env bash
# Checks the units with systemd's tools: their syntax, and their exposure of the machine, from 0 to 10.
set -euo pipefail
cd "$(dirname "$0")/../systemd"

# The maximum exposure, in tenths. `systemd-analyze security` reports 1.4 and 1.8 for the two units.
most=20
work=$(mktemp -d "${TMPDIR:-/tmp}/sightline-units.XXXXXX")
trap 'rm -rf "$work"' EXIT

for unit in *.service; do
  # `systemd-analyze verify` requires that the program exists, so replace it by an existing one.
  sed 's|/usr/local/bin/sightline|/bin/true|' "$unit" >"$work/${unit/@./@1.}"
  found=$(systemd-analyze verify --man=no "$work/${unit/@./@1.}" 2>&1) && [ -z "$found" ] ||
    { printf '%s\n' "$found" >&2; printf 'systemd: %s is not valid, see above\n' "$unit" >&2; exit 1; }
  report=$(systemd-analyze security --offline=true --threshold="$most" --no-pager \
    "$work/${unit/@./@1.}" 2>&1) || {
    printf '%s\n' "$report" >&2
    printf 'systemd: the exposure of %s exceeds %s tenths, see above\n' "$unit" "$most" >&2
    exit 1
  }
  printf 'systemd: %s: %s\n' "$unit" \
    "$(sed -n 's/.*exposure level for [^:]*: \([0-9.]*\).*/exposure \1/p' <<<"$report")"
done
