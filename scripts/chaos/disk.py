"""The coordinator's disk: a small file system that the harness fills, and files that it damages."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path


# The size of a journal's header, in bytes.
JOURNAL_HEADER = 24


class Disk:
    """A tmpfs with the data directory of the coordinator.

    In a farm with a database, the tmpfs contains the data directories of both coordinators and their shared
    blobs. In a farm with a bucket, the tmpfs also contains the objects of the bucket.
    """

    def __init__(self, at: Path, size: int, store: str) -> None:
        self.at = at
        self.data = at / "data"
        # The data directory of the second coordinator.
        self.second = at / "second"
        self.bucket = at / "bucket"
        at.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(at)], check=True)
        self.data.mkdir()
        self._blobs = self.data / "blobs"
        if store == "bucket":
            self._blobs = self.bucket / "farm" / "one"
            self.bucket.mkdir()
        if store == "database":
            self._blobs = at / "shared"
            self._blobs.mkdir()
            self.second.mkdir()
            for data in (self.data, self.second):
                (data / "blobs").symlink_to(self._blobs)

    def remove(self) -> None:
        """Unmounts the disk."""
        subprocess.run(["umount", str(self.at)], check=True)

    def fill(self, name: str, left: int) -> Path:
        """Writes a file that fills the disk except for `left` bytes.

        Returns the file, whose deletion frees the space.
        """
        filler = self.at / name
        with filler.open("wb") as file:
            # Other processes write at the same time, so the loop queries the free space before each step.
            while (free := self._free() - left) >= 4096:
                try:
                    os.posix_fallocate(file.fileno(), os.fstat(file.fileno()).st_size, min(free, 1 << 20))
                except OSError:
                    break
        return filler

    def _free(self) -> int:
        """Returns the free space, in bytes."""
        stat = os.statvfs(self.at)
        return stat.f_bavail * stat.f_frsize

    @property
    def journal(self) -> Path:
        """The journal of the first coordinator."""
        return self.data / "state" / "journal"

    def blobs(self, scenes: set[str]) -> tuple[list[Path], list[Path]]:
        """Returns the stored scenes, by their digests, and the outputs and packs of tiles, but no results."""
        # The probe and the identity, which a coordinator writes when it starts, are not blobs.
        found = [path for path in _files(self._blobs)
                 if path.parent.name != "tmp" and not path.name.startswith(("probe", "store-identity"))]
        of_scenes = [path for path in found if path.name in scenes]
        return of_scenes, [path for path in found if path not in of_scenes and _head(path) != b"\x89PVS"]

    def outcomes(self) -> list[Path]:
        """Returns the stored outcomes of phases."""
        return [*_files(self.data / "crews"), *_files(self.second / "crews")]

    def unfinished(self) -> list[Path]:
        """Returns the files of blobs that a coordinator has not finished."""
        return _files(self.data / "blobs" / "tmp")

    def view(self) -> list[Path]:
        """Returns the files of the view, which a coordinator can build again from the journal."""
        return _files(self.data / "state" / "sled")

    def events(self, second: bool = False) -> Path:
        """Returns the file of events of a coordinator."""
        return (self.second if second else self.data) / "events" / "events.jsonl"


def _files(below: Path) -> list[Path]:
    """Returns all files below a folder, sorted, so that a fraction selects the same file among the same
    files."""
    return sorted(path for path in below.rglob("*") if path.is_file())


def _head(path: Path) -> bytes:
    """Returns the first four bytes of a file, or nothing if the file cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(4)
    except OSError:
        return b""


def choose(files: list[Path], fraction: float) -> Path | None:
    """Returns the file at a fraction of the list, or None if the list is empty."""
    return files[int(fraction * len(files))] if files else None


def flip(path: Path, byte: float, bit: int) -> str | None:
    """Flips a bit of a file and returns a description, or None if the file is empty or does not exist."""
    try:
        with path.open("r+b") as file:
            length = os.fstat(file.fileno()).st_size
            at = int(byte * length)
            file.seek(at)
            old = file.read(1)
            if not old:
                return None
            file.seek(at)
            file.write(bytes([old[0] ^ (1 << bit)]))
    except FileNotFoundError:
        return None
    return f"bit {bit} of byte {at} of {length} of {path.name}"


def tear(path: Path, most: int, fraction: float) -> str:
    """Removes at most `most` bytes from the end of a file, and returns a description."""
    try:
        length = path.stat().st_size
        cut = min(length, 1 + int(fraction * most))
        os.truncate(path, length - cut)
    except OSError as error:
        return f"{path.name}: {error.strerror}"
    return f"the last {cut} of {length} bytes of {path.name}"


def leave_unfinished(path: Path, fraction: float) -> str:
    """Appends the first part of a frame to a journal, and returns a description."""
    length = 300
    frame = length.to_bytes(4, "little") + bytes(range(7, 23)) + bytes(i * 37 % 251 for i in range(length))
    part = frame[:1 + int(fraction * (len(frame) - 2))]
    try:
        with path.open("ab") as file:
            file.write(part)
    except OSError as error:
        return f"{path.name}: {error.strerror}"
    return f"{len(part)} bytes of an unfinished frame on {path.name}"
