#!/bin/sh
# Starts PostgreSQL on $PGDATA. The first start makes the cluster, with one database and one user, both `sightline`,
# whose password is the text of $PASSWORD_FILE.
#
# Over the network only that user is let in, with the password; the superuser is let in through the socket alone, which
# nobody outside this container reaches.
set -eu

bin=
for folder in /usr/lib/postgresql/*/bin; do
  [ -x "$folder/postgres" ] && bin=$folder
done
[ -n "$bin" ] || { echo "postgres: there is no PostgreSQL in /usr/lib/postgresql" >&2; exit 1; }

if [ ! -s "$PGDATA/PG_VERSION" ]; then
  password=$(cat "$PASSWORD_FILE")
  # It goes into a statement below.
  case $password in
    '' | *[!0-9A-Za-z_-]*) echo "postgres: the password in $PASSWORD_FILE must be letters, digits, _ and - alone" >&2; exit 1 ;;
  esac
  # Made beside and renamed, so that a start that was interrupted leaves no half of a cluster.
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
