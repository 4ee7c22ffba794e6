#!/usr/bin/env bash
# Makes an authority of one's own, and certificates of it for a coordinator and for workers:
#
#   deploy/certificates.sh DIR NAME…
#
# NAME is a name or an address by which the coordinator is reached, such as farm.example, *.farm.svc or 10.0.0.5; the
# first is the certificate's own. DIR then holds ca.pem and ca.key, coordinator.pem and coordinator.key, worker.pem and
# worker.key. An authority that is there is used again, so to renew certificates run it once more; keep ca.key where no
# server is.
#
#   SIGHTLINE_DAYS    how long the certificates are valid; default 365. The authority is valid for ten years.
set -euo pipefail

die() { printf 'certificates: %s\n' "$*" >&2; exit 1; }
[ $# -ge 2 ] || die 'usage: deploy/certificates.sh DIR NAME…'
command -v openssl >/dev/null || die 'openssl is not installed; apt-get install openssl'
folder=$1
shift
days=${SIGHTLINE_DAYS:-365}

names=
for name in "$@"; do
  case $name in
    '' | *[!0-9A-Za-z.:*_-]*) die "'$name' is neither a name nor an address" ;;
    *:* | *[0-9].[0-9]*.[0-9]*.[0-9]*) [[ $name == *[g-zG-Z]* ]] && kind=DNS || kind=IP ;;
    *) kind=DNS ;;
  esac
  case ,$names, in *",$kind:$name,"*) continue ;; esac
  names+=${names:+,}$kind:$name
done

umask 077 # keys are for nobody else
mkdir -p "$folder"
# Worked on beside and moved in at the end: certificate and key never belong to different runs.
work=$(mktemp -d "$folder/.new.XXXXXX")
trap 'rm -rf "$work"' EXIT
quietly() { "$@" 2>"$work/log" || { cat "$work/log" >&2; die "openssl failed (above)"; }; }
key=(-newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes)

if [ ! -f "$folder/ca.pem" ] || [ ! -f "$folder/ca.key" ]; then
  quietly openssl req -x509 "${key[@]}" -days 3650 -subj '/CN=Sightline authority' \
    -addext 'keyUsage=critical,keyCertSign,cRLSign' -keyout "$work/ca.key" -out "$work/ca.pem"
  mv "$work/ca.key" "$work/ca.pem" "$folder/"
fi

# certify NAME SUBJECT EXTENSIONS
certify() {
  printf '%b' "basicConstraints=critical,CA:FALSE\nkeyUsage=critical,digitalSignature\n$3\n" >"$work/extensions"
  quietly openssl req "${key[@]}" -keyout "$work/$1.key" -subj "/CN=$2" -out "$work/$1.csr"
  quietly openssl x509 -req -in "$work/$1.csr" -CA "$folder/ca.pem" -CAkey "$folder/ca.key" -set_serial "0x$(openssl rand -hex 16)" \
    -days "$days" -extfile "$work/extensions" -out "$work/$1.pem"
}
# Two usages: a worker's certificate must not serve as the coordinator's, or who steals its key could pose as it.
certify coordinator "${1:0:64}" "extendedKeyUsage=serverAuth\nsubjectAltName=$names"
certify worker worker 'extendedKeyUsage=clientAuth'
for name in coordinator worker; do
  # Into the files that are there: a container that has one of them mounted sees the new text.
  for part in pem key; do
    cat "$work/$name.$part" >"$folder/$name.$part"
  done
done
printf 'certificates: %s: valid for %s days, for %s\n' "$folder" "$days" "$names" >&2
