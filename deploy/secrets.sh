#!/usr/bin/env bash
# Creates the secrets of compose.yaml and compose.tls.yaml: two passwords, if they are missing, and
# certificates, if NAME is given.
#
#   deploy/secrets.sh [NAME…]
#
# NAME is a name or an address of this machine. Each run with NAME renews the certificates.
#
# Compose mounts the file of a secret into a container with the owner and the mode of the file, and the
# containers run as the user 10001. The files are therefore readable by all users. Only the owner can enter
# the folder, and the containers do not mount the folder. No container needs the key of the authority, so only
# the owner can read this key.
#
#   SIGHTLINE_SECRETS    folder of the secrets. Default: deploy/secrets
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
folder=${SIGHTLINE_SECRETS:-$here/secrets}

mkdir -p -m 0700 "$folder"
chmod 0700 "$folder"
for name in postgres-password grafana-password; do
  [ -s "$folder/$name" ] || openssl rand -hex 24 >"$folder/$name"
done
if [ $# -gt 0 ]; then
  # The coordinator has the name `farm` on the network of the workers.
  "$here/certificates.sh" "$folder" "$@" localhost 127.0.0.1 farm coordinator
fi
for file in "$folder"/*; do
  case $file in
    */ca.key) chmod 0600 "$file" ;;
    *) chmod 0644 "$file" ;;
  esac
done
printf 'secrets: %s\n' "$folder" >&2
