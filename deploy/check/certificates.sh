#!/usr/bin/env bash
# Checks the certificates of deploy/certificates.sh: names, usages, modes of the keys, and a renewal.
set -euo pipefail
cd "$(dirname "$0")/.."

die() { printf 'certificates: %s\n' "$*" >&2; exit 1; }
work=$(mktemp -d "${TMPDIR:-/tmp}/sightline-certificates.XXXXXX")
trap 'rm -rf "$work"' EXIT

# made: Creates or renews the certificates.
made() {
  ./certificates.sh "$work/c" farm.example '*.farm.svc' 10.0.0.5 fd00::5 farm.example 2>"$work/log" ||
    { cat "$work/log" >&2; die 'deploy/certificates.sh failed, see above'; }
}
# serves ARGUMENTS…: Succeeds if a certificate is valid for the purpose and the name in the arguments.
serves() { openssl verify -CAfile "$work/c/ca.pem" "$@" >/dev/null 2>&1; }

made
coordinator=$work/c/coordinator.pem
for name in farm.example farm-0.farm.svc; do
  serves -purpose sslserver -verify_hostname "$name" "$coordinator" ||
    die "the coordinator's certificate is not valid for $name"
done
for address in 10.0.0.5 fd00::5; do
  serves -purpose sslserver -verify_ip "$address" "$coordinator" ||
    die "the coordinator's certificate is not valid for $address"
done
! serves -purpose sslserver -verify_hostname other.example "$coordinator" ||
  die "the coordinator's certificate is valid for a name that was not requested"
! serves -purpose sslclient "$coordinator" || die "the coordinator's certificate is valid for a client"
serves -purpose sslclient "$work/c/worker.pem" || die "the worker's certificate is not valid for a client"
! serves -purpose sslserver "$work/c/worker.pem" || die "the worker's certificate is valid for a server"
for name in ca coordinator worker; do
  [ "$(stat -c %a "$work/c/$name.key")" = 600 ] || die "the mode of $name.key is not 600"
done

before=$(sha256sum "$work"/c/ca.* "$work"/c/worker.key)
made
after=$(sha256sum "$work"/c/ca.* "$work"/c/worker.key)
[ "$(grep ca\\. <<<"$before")" = "$(grep ca\\. <<<"$after")" ] || die 'the renewal replaced the authority'
[ "$(grep worker <<<"$before")" != "$(grep worker <<<"$after")" ] ||
  die 'the renewal did not replace worker.key'
for name in coordinator worker; do
  certified=$(openssl x509 -in "$work/c/$name.pem" -noout -pubkey)
  [ "$certified" = "$(openssl pkey -in "$work/c/$name.key" -pubout)" ] ||
    die "after the renewal, $name.key is not the key of $name.pem"
done
for bad in 'a b' 'x,DNS:evil' ''; do
  ! ./certificates.sh "$work/c" "$bad" 2>/dev/null || die "deploy/certificates.sh accepts the name '$bad'"
done
printf 'certificates: names, usages, modes and renewal are correct\n'
