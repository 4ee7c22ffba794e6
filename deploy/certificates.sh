#!/usr/bin/env bash
# Creates a private authority, and certificates of this authority for a coordinator and for workers:
#
#   deploy/certificates.sh DIR NAME…
#
# NAME is a name or an address of the coordinator, such as farm.example, *.farm.svc or 10.0.0.5. The first
# NAME becomes the subject of the certificate. The script writes ca.pem, ca.key, coordinator.pem,
# coordinator.key, worker.pem and worker.key to DIR. If DIR contains an authority, the script uses this
# authority. To renew the certificates, run the script again. Do not store ca.key on a server.
#
#   SIGHTLINE_DAYS    validity of the certificates, in days. Default: 365. The authority is valid for
#                     3650 days.
set -euo pipefail

die() { printf 'certificates: %s\n' "$*" >&2; exit 1; }
[ $# -ge 2 ] || die 'usage: deploy/certificates.sh DIR NAME…'
command -v openssl >/dev/null || die 'openssl is not installed; run apt-get install openssl'
folder=$1
shift
days=${SIGHTLINE_DAYS:-365}

names=
for name in "$@"; do
  case $name in
    '' | *[!0-9A-Za-z.:*_-]*) die "'$name' is neither a host name nor an IP address" ;;
    *:* | *[0-9].[0-9]*.[0-9]*.[0-9]*) [[ $name == *[g-zG-Z]* ]] && kind=DNS || kind=IP ;;
    *) kind=DNS ;;
  esac
  case ,$names, in *",$kind:$name,"*) continue ;; esac
  names+=${names:+,}$kind:$name
done

umask 077 # Only the owner may read the keys.
mkdir -p "$folder"
# The script creates all files in this folder and copies them at the end. If an earlier step fails, DIR
# therefore does not contain a certificate and a key of different runs.
work=$(mktemp -d "$folder/.new.XXXXXX")
trap 'rm -rf "$work"' EXIT
# quietly COMMAND…: Runs the command, and prints its errors only if the command fails.
quietly() { "$@" 2>"$work/log" || { cat "$work/log" >&2; die 'openssl failed, see above'; }; }
key=(-newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes)

if [ ! -f "$folder/ca.pem" ] || [ ! -f "$folder/ca.key" ]; then
  quietly openssl req -x509 "${key[@]}" -days 3650 -subj '/CN=Sightline authority' \
    -addext 'keyUsage=critical,keyCertSign,cRLSign' -keyout "$work/ca.key" -out "$work/ca.pem"
  mv "$work/ca.key" "$work/ca.pem" "$folder/"
fi

# certify NAME SUBJECT EXTENSIONS: Creates a key and a certificate.
certify() {
  printf '%b' "basicConstraints=critical,CA:FALSE\nkeyUsage=critical,digitalSignature\n$3\n" >"$work/extensions"
  quietly openssl req "${key[@]}" -keyout "$work/$1.key" -subj "/CN=$2" -out "$work/$1.csr"
  quietly openssl x509 -req -in "$work/$1.csr" -CA "$folder/ca.pem" -CAkey "$folder/ca.key" \
    -set_serial "0x$(openssl rand -hex 16)" -days "$days" -extfile "$work/extensions" -out "$work/$1.pem"
}
# The certificates have different usages, so that an attacker with a worker's key cannot act as coordinator.
certify coordinator "${1:0:64}" "extendedKeyUsage=serverAuth\nsubjectAltName=$names"
certify worker worker 'extendedKeyUsage=clientAuth'
for name in coordinator worker; do
  # `cat` writes to the existing files instead of replacing them, so that a container with a mounted file
  # reads the new content.
  for part in pem key; do
    cat "$work/$name.$part" >"$folder/$name.$part"
  done
done
printf 'certificates: %s: valid for %s days, for %s\n' "$folder" "$days" "$names" >&2
