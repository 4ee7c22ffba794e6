#!/usr/bin/env bash
# Checks that no line of a tracked .rs, .proto or .wgsl file has more than 110 characters, and prints each
# longer line as `file:line: width`. The script deletes the continuation bytes of UTF-8 characters before it
# counts, so that the result does not depend on the locale.
#
#   scripts/lines.sh
set -euo pipefail
cd "$(dirname "$0")/.."

most=110
wide=$(
  git ls-files -z -- '*.rs' '*.proto' '*.wgsl' |
    while IFS= read -r -d '' file; do
      # The index still lists files that were deleted from the work tree.
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
