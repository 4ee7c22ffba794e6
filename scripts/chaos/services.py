"""The services that coordinators use: a PostgreSQL server, and an object store with a bucket."""

from __future__ import annotations

import os
import pwd
import shutil
import subprocess
from pathlib import Path

from .nodes import BUCKET, DATABASE
from .spaces import NETWORK, NoNamespaces

PORT_OF_DATABASE = 5432
PORT_OF_BUCKET = 9000
# The key and the secret of the object store (tests/s3), and the password of the database. Logs must not
# contain the secret and the password.
KEY = "test-key"
SECRET = "7Wf0qN-secret-of-tests-3pLm"
PASSWORD = "a-password-of-the-chaos-harness"
# The size of a database's file system, in bytes.
ROOM = 256 << 20
# The folder of the databases, a separate file system. The user of the databases may enter its parent folders.
RUN = Path("/run/sightline-chaos")
# The possible sizes of a coordinator's cache of blobs, which hold none, a few or all copies.
CACHES = ("0", "20K", "1G")


def _programs() -> Path:
    """Returns the folder with the programs of the newest installed PostgreSQL."""
    found = [path for path in Path("/usr/lib/postgresql").glob("*/bin") if (path / "initdb").is_file()]
    if not found:
        raise NoNamespaces("PostgreSQL is not installed (scripts/setup.sh --for test)")
    return max(found, key=lambda path: int(path.parent.name) if path.parent.name.isdigit() else 0)


def _user() -> str:
    """Returns the user that runs the server. PostgreSQL does not run as root."""
    for name in ("postgres", "nobody"):
        try:
            return pwd.getpwnam(name).pw_name
        except KeyError:
            continue
    raise NoNamespaces("PostgreSQL needs the user postgres or the user nobody, and neither exists")


def _as_user(command: list[str]) -> list[str]:
    """Returns the command that runs `command` as the user of the server, in the same process."""
    return ["setpriv", "--reuid", _user(), "--clear-groups", "--", *command]


class Database:
    """The PostgreSQL server of one schedule, on a separate file system in memory."""

    def __init__(self, template: Path, name: str) -> None:
        """Copies the files `template`, which `prepare` created. `name` is unique in this command."""
        self._at = RUN / name
        self._at.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={ROOM},mode=755", "tmpfs", str(self._at)],
                       check=True)
        subprocess.run(["cp", "-a", str(template), str(self._at / "data")], check=True)
        shutil.chown(self._at, _user())

    @staticmethod
    def prepare(template: Path) -> None:
        """Creates the files of a server with the user `sightline`.

        Raises NoNamespaces with the missing requirement.
        """
        programs, at = _programs(), RUN / "template"
        RUN.mkdir(exist_ok=True)
        subprocess.run(["mount", "-t", "tmpfs", "-o", "mode=755", "tmpfs", str(RUN)], check=True)
        at.mkdir(mode=0o755)
        shutil.chown(at, _user())
        password = at / "password"
        password.write_text(PASSWORD)
        password.chmod(0o600)
        shutil.chown(password, _user())
        made = subprocess.run(
            _as_user([str(programs / "initdb"), "--username", "sightline", "--auth-local", "reject",
                      "--auth-host", "scram-sha-256", "--no-sync", "--no-locale", "--encoding", "UTF8",
                      "--wal-segsize", "1", "--pwfile", str(password), "--pgdata", str(at / "data")]),
            cwd=at, capture_output=True, text=True, check=False)
        if made.returncode != 0:
            raise NoNamespaces(f"initdb: {made.stderr.strip()}")
        with (at / "data" / "pg_hba.conf").open("a") as access:
            access.write(f"host all all {NETWORK}0/24 scram-sha-256\n")
        subprocess.run(["cp", "-a", str(at / "data"), str(template)], check=True)
        shutil.rmtree(at)

    def command(self) -> list[str]:
        """Returns the command of the server."""
        settings = {
            "listen_addresses": f"{NETWORK}{DATABASE}", "port": PORT_OF_DATABASE,
            "unix_socket_directories": self._at,
            # The harness kills processes and never the machine, so written data survives without a sync.
            "fsync": "off", "shared_buffers": "16MB", "max_connections": 60, "min_wal_size": "2MB",
            "max_wal_size": "32MB",
        }
        flags = [word for name, value in settings.items() for word in ("-c", f"{name}={value}")]
        return _as_user([str(_programs() / "postgres"), "-D", str(self._at / "data"), *flags])

    def written(self) -> int:
        """Returns the time of the last write to the log of changes, in nanoseconds.

        Each commit writes to the log.
        """
        newest = 0
        for path in (self._at / "data" / "pg_wal").glob("0*"):
            try:
                newest = max(newest, path.stat().st_mtime_ns)
            except OSError:
                # The server has renamed the file.
                continue
        return newest

    def remove(self) -> None:
        """Removes the files of the server after its end."""
        subprocess.run(["umount", "--lazy", str(self._at)], check=True)
        self._at.rmdir()

    @staticmethod
    def environment() -> dict[str, str]:
        """Returns the variables with which a coordinator uses the database."""
        url = f"postgres://sightline@{NETWORK}{DATABASE}:{PORT_OF_DATABASE}/postgres?sslmode=disable"
        return {"SIGHTLINE_STORE": url, "PGPASSWORD": PASSWORD}


class Bucket:
    """The object store of one schedule, which stores its objects in a folder of the coordinator's disk."""

    def __init__(self, program: Path, folder: Path, seed: int) -> None:
        self._program = program.parent / "sightline-test-s3"
        self._folder = folder
        self._cache = CACHES[seed % len(CACHES)]

    @staticmethod
    def check(program: Path) -> None:
        """Raises NoNamespaces if the program of the object store is not in the folder of `program`."""
        server = program.parent / "sightline-test-s3"
        if not os.access(server, os.X_OK):
            raise NoNamespaces(f"{server} does not exist; run cargo build --workspace")

    def command(self) -> list[str]:
        """Returns the command of the object store."""
        return [str(self._program), f"{NETWORK}{BUCKET}:{PORT_OF_BUCKET}", str(self._folder), "farm"]

    def coordinator(self) -> list[str]:
        """Returns the arguments with which a coordinator uses the object store."""
        return ["--blobs",
                f"s3://farm/one?endpoint=http://{NETWORK}{BUCKET}:{PORT_OF_BUCKET}&cache={self._cache}"]

    @staticmethod
    def environment() -> dict[str, str]:
        """Returns the variables with which a coordinator uses the object store."""
        return {"AWS_ACCESS_KEY_ID": KEY, "AWS_SECRET_ACCESS_KEY": SECRET}
