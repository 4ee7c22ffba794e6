"""The coordinator's disk: a small file system that can be filled, and files on it that can be damaged."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path


# Bytes of a journal before its first frame.
JOURNAL_HEADER = 24


class Disk:
    """A tmpfs with the data directory of a coordinator; in a farm with a database with those of two, who share the blobs;
    in a farm with a bucket with its objects."""

    def __init__(self, at: Path, size: int, store: str) -> None:
        self.at = at
        self.data = at / "data"
        # That of the other coordinator.
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
        subprocess.run(["umount", str(self.at)], check=True)

    def fill(self, name: str, left: int) -> Path:
        """Takes all space but `left` bytes; removing the file that is returned frees it again."""
        filler = self.at / name
        with filler.open("wb") as file:
            # Others write meanwhile, so what is free shrinks under this loop.
            while (free := self._free() - left) >= 4096:
                try:
                    os.posix_fallocate(file.fileno(), os.fstat(file.fileno()).st_size, min(free, 1 << 20))
                except OSError:
                    break
        return filler

    def _free(self) -> int:
        stat = os.statvfs(self.at)
        return stat.f_bavail * stat.f_frsize

    @property
    def journal(self) -> Path:
        return self.data / "state" / "journal"

    def blobs(self, scenes: set[str]) -> tuple[list[Path], list[Path]]:
        """The stored scenes, by their digests, and the outputs and packs of tiles. Results are in neither."""
        # What a coordinator writes at its start, to see whether a bucket can be used, is no blob.
        found = [path for path in _files(self._blobs) if path.parent.name != "tmp" and not path.name.startswith(("probe", "store-identity"))]
        of_scenes = [path for path in found if path.name in scenes]
        return of_scenes, [path for path in found if path not in of_scenes and _head(path) != b"\x89PVS"]

    def outcomes(self) -> list[Path]:
        """What crews have kept of their phases."""
        return [*_files(self.data / "crews"), *_files(self.second / "crews")]

    def unfinished(self) -> list[Path]:
        """Blobs that are being written."""
        return _files(self.data / "blobs" / "tmp")

    def view(self) -> list[Path]:
        """The files of the view that can be built from the journal again."""
        return _files(self.data / "state" / "sled")

    def events(self, second: bool = False) -> Path:
        return (self.second if second else self.data) / "events" / "events.jsonl"


def _files(below: Path) -> list[Path]:
    """All files below a folder, sorted, so that a fraction chooses the same one where the same ones are there."""
    return sorted(path for path in below.rglob("*") if path.is_file())


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(4)
    except OSError:
        return b""


def choose(files: list[Path], fraction: float) -> Path | None:
    """One of the files; none when there are none."""
    return files[int(fraction * len(files))] if files else None


def flip(path: Path, byte: float, bit: int) -> str | None:
    """Turns one bit of a file over and says which; none when the file is empty or has gone."""
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
    """Cuts up to `most` bytes off the end of a file; says how many."""
    try:
        length = path.stat().st_size
        cut = min(length, 1 + int(fraction * most))
        os.truncate(path, length - cut)
    except OSError as error:
        return f"{path.name}: {error.strerror}"
    return f"the last {cut} of {length} bytes of {path.name}"


def leave_unfinished(path: Path, fraction: float) -> str:
    """Appends an unfinished frame: its header and a part of its bytes."""
    length = 300
    frame = length.to_bytes(4, "little") + bytes(range(7, 23)) + bytes(i * 37 % 251 for i in range(length))
    part = frame[:1 + int(fraction * (len(frame) - 2))]
    try:
        with path.open("ab") as file:
            file.write(part)
    except OSError as error:
        return f"{path.name}: {error.strerror}"
    return f"{len(part)} bytes of an unfinished frame on {path.name}"
