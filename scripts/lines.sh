#!/usr/bin/env bash
# Fails when a line of a tracked .rs, .proto or .wgsl file is wider than 110 characters, and prints each as file:line:
# width. Characters are counted, not bytes; the bytes that continue a UTF-8 character are dropped first, so
# that the result does not depend on the locale.
#
#   scripts/lines.sh
set -euo pipefail
cd "$(dirname "$0")/.."

most=110
wide=$(
  git ls-files -z -- '*.rs' '*.proto' '*.wgsl' |
    while IFS= read -r -d '' file; do
      # A tracked file that was deleted in the work tree has no lines.
      [ -f "$file" ] || continue
      LC_ALL=C tr -d '\200-\277' <"$file" |
        LC_ALL=C awk -v file="$file" -v most="$most" \
          'length($0) > most { print file ":" FNR ": " length($0) " characters" }'
    done
)
if [ -n "$wide" ]; then
  printf '%s\n' "$wide"
  printf 'lines: lines wider than %s characters: %s\n' "$most" "$(wc -l <<<"$wide")" >&2
  exit 1
fi
