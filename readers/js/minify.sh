#!/bin/sh
# Writes pvs.min.mjs: the reader without comments, indentation and empty lines, below 12 kB.
set -eu
cd "$(dirname "$0")"
{
    echo "// Reads .pvs results. MIT OR Apache-2.0. Made of pvs.mjs."
    sed -e 's/^ *//' -e '/^\/\//d' -e '/^$/d' pvs.mjs
} > pvs.min.mjs
