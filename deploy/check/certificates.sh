#!/usr/bin/env bash
# Checks what deploy/certificates.sh makes: names, usages, who may read the keys, and that a renewal keeps the authority.
set -euo pipefail
cd "$(dirname "$0")/.."

die() { printf 'certificates: %s\n' "$*" >&2; exit 1; }
work=$(mktemp -d "${TMPDIR:-/tmp}/sightline-certificates.XXXXXX")
trap 'rm -rf "$work"' EXIT

made() { ./certificates.sh "$work/c" farm.example '*.farm.svc' 10.0.0.5 fd00::5 farm.example 2>"$work/log" || { cat "$work/log" >&2; die 'it fails (above)'; }; }
serves() { openssl verify -CAfile "$work/c/ca.pem" "$@" >/dev/null 2>&1; }

made
coordinator=$work/c/coordinator.pem
for name in farm.example farm-0.farm.svc; do
  serves -purpose sslserver -verify_hostname "$name" "$coordinator" || die "the coordinator's is not for $name"
done
for address in 10.0.0.5 fd00::5; do
  serves -purpose sslserver -verify_ip "$address" "$coordinator" || die "the coordinator's is not for $address"
done
! serves -purpose sslserver -verify_hostname other.example "$coordinator" || die "the coordinator's is for every name"
! serves -purpose sslclient "$coordinator" || die "the coordinator's passes for a worker's"
serves -purpose sslclient "$work/c/worker.pem" || die "the worker's is none"
! serves -purpose sslserver "$work/c/worker.pem" || die "the worker's passes for the coordinator's"
for name in ca coordinator worker; do
  [ "$(stat -c %a "$work/c/$name.key")" = 600 ] || die "others can read $name.key"
done

before=$(sha256sum "$work"/c/ca.* "$work"/c/worker.key)
made
after=$(sha256sum "$work"/c/ca.* "$work"/c/worker.key)
[ "$(grep ca\\. <<<"$before")" = "$(grep ca\\. <<<"$after")" ] || die 'a renewal makes another authority'
[ "$(grep worker <<<"$before")" != "$(grep worker <<<"$after")" ] || die 'a renewal renews nothing'
for name in coordinator worker; do
  [ "$(openssl x509 -in "$work/c/$name.pem" -noout -pubkey)" = "$(openssl pkey -in "$work/c/$name.key" -pubout)" ] ||
    die "after a renewal $name.key is not the key of $name.pem"
done
for bad in 'a b' 'x,DNS:evil' ''; do
  ! ./certificates.sh "$work/c" "$bad" 2>/dev/null || die "the name '$bad' is accepted"
done
printf 'certificates: names, usages, modes and renewal are right\n'
