"""What coordinators rely on: a PostgreSQL server, and a server with a bucket of objects."""

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
# The key and the secret of the test server (tests/s3), and the password of the database. No log may have them.
KEY = "test-key"
SECRET = "7Wf0qN-secret-of-tests-3pLm"
PASSWORD = "a-password-of-the-chaos-harness"
# Bytes of the file system of a database.
ROOM = 256 << 20
# Where databases are: a file system of this command's own, below folders that their user may enter.
RUN = Path("/run/sightline-chaos")
# Room for copies of blobs; one of them is a coordinator's: none, a few, all.
CACHES = ("0", "20K", "1G")


def _programs() -> Path:
    """Where Debian has the programs of its newest server."""
    found = [path for path in Path("/usr/lib/postgresql").glob("*/bin") if (path / "initdb").is_file()]
    if not found:
        raise NoNamespaces("PostgreSQL is not installed (scripts/setup.sh --for test)")
    return max(found, key=lambda path: int(path.parent.name) if path.parent.name.isdigit() else 0)


def _user() -> str:
    """Who runs the server, which refuses to run as root."""
    for name in ("postgres", "nobody"):
        try:
            return pwd.getpwnam(name).pw_name
        except KeyError:
            continue
    raise NoNamespaces("there is neither a user postgres nor a user nobody to run PostgreSQL")


def _as_user(command: list[str]) -> list[str]:
    # It replaces itself with the program, so that the process is the program's.
    return ["setpriv", "--reuid", _user(), "--clear-groups", "--", *command]


class Database:
    """The server of one schedule, on a file system of its own in memory."""

    def __init__(self, template: Path, name: str) -> None:
        """`template` is what `prepare` has made; `name` is unique in this command."""
        self._at = RUN / name
        self._at.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={ROOM},mode=755", "tmpfs", str(self._at)], check=True)
        subprocess.run(["cp", "-a", str(template), str(self._at / "data")], check=True)
        shutil.chown(self._at, _user())

    @staticmethod
    def prepare(template: Path) -> None:
        """Makes the files of a server with the user `sightline`.

        Raises NoNamespaces with what this machine lacks.
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
            _as_user([str(programs / "initdb"), "--username", "sightline",
                      "--auth-local", "reject", "--auth-host", "scram-sha-256", "--no-sync", "--no-locale", "--encoding", "UTF8", "--wal-segsize", "1", "--pwfile", str(password),
                      "--pgdata", str(at / "data")]),
            cwd=at, capture_output=True, text=True, check=False)
        if made.returncode != 0:
            raise NoNamespaces(f"initdb: {made.stderr.strip()}")
        with (at / "data" / "pg_hba.conf").open("a") as access:
            access.write(f"host all all {NETWORK}0/24 scram-sha-256\n")
        subprocess.run(["cp", "-a", str(at / "data"), str(template)], check=True)
        shutil.rmtree(at)

    def command(self) -> list[str]:
        """The command of the server."""
        settings = {
            "listen_addresses": f"{NETWORK}{DATABASE}", "port": PORT_OF_DATABASE, "unix_socket_directories": self._at,
            # A killed process leaves what it has written, and here nothing else happens to it.
            "fsync": "off", "shared_buffers": "16MB", "max_connections": 60, "min_wal_size": "2MB", "max_wal_size": "32MB",
        }
        flags = [word for name, value in settings.items() for word in ("-c", f"{name}={value}")]
        return _as_user([str(_programs() / "postgres"), "-D", str(self._at / "data"), *flags])

    def written(self) -> int:
        """When the log of changes was last written to, in nanoseconds; it grows with commits."""
        newest = 0
        for path in (self._at / "data" / "pg_wal").glob("0*"):
            try:
                newest = max(newest, path.stat().st_mtime_ns)
            except OSError:
                # It was renamed meanwhile.
                continue
        return newest

    def remove(self) -> None:
        """Removes its files once nothing runs there."""
        subprocess.run(["umount", "--lazy", str(self._at)], check=True)
        self._at.rmdir()

    @staticmethod
    def environment() -> dict[str, str]:
        """What a coordinator needs to know."""
        url = f"postgres://sightline@{NETWORK}{DATABASE}:{PORT_OF_DATABASE}/postgres?sslmode=disable"
        return {"SIGHTLINE_STORE": url, "PGPASSWORD": PASSWORD}


class Bucket:
    """The object store of one schedule, with its objects in a folder of the coordinator's disk."""

    def __init__(self, program: Path, folder: Path, seed: int) -> None:
        self._program = program.parent / "sightline-test-s3"
        self._folder = folder
        self._cache = CACHES[seed % len(CACHES)]

    @staticmethod
    def check(program: Path) -> None:
        """Raises NoNamespaces unless the server is beside the program."""
        server = program.parent / "sightline-test-s3"
        if not os.access(server, os.X_OK):
            raise NoNamespaces(f"there is no {server}: cargo build --workspace")

    def command(self) -> list[str]:
        """The command of the server."""
        return [str(self._program), f"{NETWORK}{BUCKET}:{PORT_OF_BUCKET}", str(self._folder), "farm"]

    def coordinator(self) -> list[str]:
        """The coordinator's arguments."""
        return ["--blobs", f"s3://farm/one?endpoint=http://{NETWORK}{BUCKET}:{PORT_OF_BUCKET}&cache={self._cache}"]

    @staticmethod
    def environment() -> dict[str, str]:
        """What a coordinator needs to know."""
        return {"AWS_ACCESS_KEY_ID": KEY, "AWS_SECRET_ACCESS_KEY": SECRET}
