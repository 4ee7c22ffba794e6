#!/usr/bin/env bash
# What takes too long for every change: runs once a night.
#
#   scripts/nightly.sh
set -euo pipefail
cd "$(dirname "$0")/.."

scripts/python.sh
