#!/bin/sh
# Starts PostgreSQL with the data folder $PGDATA. The first start creates the data folder, the database
# `sightline` and the user `sightline`. $PASSWORD_FILE contains the password of the user.
#
# Over the network, only this user can connect, with the password. The superuser can connect only through the
# socket, which is not accessible outside of the container.
set -eu

bin=
for folder in /usr/lib/postgresql/*/bin; do
  [ -x "$folder/postgres" ] && bin=$folder
done
[ -n "$bin" ] || { echo "postgres: PostgreSQL is not installed in /usr/lib/postgresql" >&2; exit 1; }

if [ ! -s "$PGDATA/PG_VERSION" ]; then
  password=$(cat "$PASSWORD_FILE")
  # The password becomes part of an SQL statement, so it must not contain special characters.
  case $password in
    '' | *[!0-9A-Za-z_-]*)
      echo "postgres: the password in $PASSWORD_FILE must contain only letters, digits, _ and -" >&2
      exit 1
      ;;
  esac
  # The script creates the data folder under another name and renames it, so that an interrupted start does
  # not leave an incomplete data folder.
  rm -rf "$PGDATA.new"
  "$bin/initdb" --pgdata="$PGDATA.new" --username=postgres --encoding=UTF8 --locale=C --data-checksums \
    --auth-local=trust --auth-host=scram-sha-256 >/dev/null
  echo 'host sightline sightline all scram-sha-256' >>"$PGDATA.new/pg_hba.conf"
  "$bin/postgres" --single -D "$PGDATA.new" postgres >/dev/null <<SQL
CREATE ROLE sightline LOGIN PASSWORD '$password';
CREATE DATABASE sightline OWNER sightline;
SQL
  mv "$PGDATA.new" "$PGDATA"
fi

exec "$bin/postgres" -D "$PGDATA" -c 'listen_addresses=*' -c unix_socket_directories=/tmp
