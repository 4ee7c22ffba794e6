#!/usr/bin/env bash
# Makes what compose.yaml and compose.tls.yaml read as secrets, where it is missing: two passwords, and with names of
# this machine the certificates (anew each time).
#
#   deploy/secrets.sh [NAME…]
#
# A secret of compose is the file itself, seen from inside with its owner and its mode, and the containers run as user
# 10001. So the files can be read by everybody, and the folder, which nobody sees from inside, can be entered by its
# owner alone. The authority's key is for no container.
#
#   SIGHTLINE_SECRETS    the folder; default deploy/secrets
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
folder=${SIGHTLINE_SECRETS:-$here/secrets}

mkdir -p -m 0700 "$folder"
chmod 0700 "$folder"
for name in postgres-password grafana-password; do
  [ -s "$folder/$name" ] || openssl rand -hex 24 >"$folder/$name"
done
if [ $# -gt 0 ]; then
  # `farm` is the coordinator's name on the network of the workers.
  "$here/certificates.sh" "$folder" "$@" localhost 127.0.0.1 farm coordinator
fi
for file in "$folder"/*; do
  case $file in
    */ca.key) chmod 0600 "$file" ;;
    *) chmod 0644 "$file" ;;
  esac
done
printf 'secrets: %s\n' "$folder" >&2
