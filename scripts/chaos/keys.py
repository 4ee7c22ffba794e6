"""Certificates and tokens of a farm, created as in docs/operations.md, and the secrets that they contain."""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

from .nodes import BALANCER, COORDINATOR, SECOND
from .spaces import NETWORK


@dataclass(frozen=True)
class Keys:
    """The files of a farm with encryption and tokens."""

    folder: Path

    def coordinator(self, pair: bool) -> list[str]:
        """Returns the arguments of a coordinator.

        Two coordinators authenticate each other by certificates, and workers by a token.
        """
        at = self.folder
        return ["--tls-cert", str(at / "coordinator.pem"), "--tls-key", str(at / "coordinator.key"),
                "--peer-ca" if pair else "--client-ca", str(at / "ca.pem"), "--tokens",
                str(at / "tokens.json")]

    def worker(self, pair: bool) -> list[str]:
        """Returns the arguments of a worker.

        With two coordinators, workers use a token, because a standby cannot forward a certificate.
        """
        at = self.folder
        if pair:
            return ["--ca", str(at / "ca.pem"), "--token-file", str(at / "worker.token")]
        return ["--ca", str(at / "ca.pem"), "--cert", str(at / "worker.pem"), "--key", str(at / "worker.key")]

    def client(self) -> list[str]:
        """Returns the arguments of a client with the scope admin."""
        return ["--ca", str(self.folder / "ca.pem"), "--token-file", str(self.folder / "root.token")]

    def secrets(self) -> list[bytes]:
        """Returns the secrets of tokens and the lines of keys, which logs and argument lists must not
        contain."""
        found = []
        for path in sorted(self.folder.glob("*.key")):
            lines = path.read_bytes().splitlines()
            found += [line for line in lines if len(line) >= 32 and not line.startswith(b"-")]
        for path in sorted(self.folder.glob("*.token")):
            # A token is slt_ID_SECRET. The id is not secret, and lists contain it.
            found.append(path.read_bytes().strip().split(b"_", 2)[2])
        return found


def make(program: Path, folder: Path) -> Keys:
    """Creates an authority, certificates of the authority, and tokens."""
    folder.mkdir()
    before = os.umask(0o077)
    try:
        _openssl(folder, "req", "-x509", *_NEW, "-days", "3650", "-keyout", "ca.key", "-out", "ca.pem",
                 "-subj", "/CN=farm")
        _certify(folder, "coordinator", f"extendedKeyUsage=serverAuth\nsubjectAltName={_names()}\n")
        _certify(folder, "worker", "extendedKeyUsage=clientAuth\n")
        for user, scope in (("root", "admin"), ("worker", "worker")):
            token = subprocess.run([program, "token", "new", "--tokens", folder / "tokens.json", "--user",
                                    user,
                                    "--scope", scope], capture_output=True, check=True)
            (folder / f"{user}.token").write_bytes(token.stdout)
    finally:
        os.umask(before)
    return Keys(folder)


def _names() -> str:
    """Returns the addresses of the coordinators, as names of a certificate."""
    return ",".join(f"IP:{NETWORK}{number}" for number in (COORDINATOR, SECOND, BALANCER)) + ",IP:127.0.0.1"


_NEW = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes")


def _openssl(folder: Path, *words: str) -> None:
    subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)


def _certify(folder: Path, name: str, extensions: str) -> None:
    """Creates a key and a certificate of the authority."""
    (folder / "extensions").write_text(extensions)
    _openssl(folder, "req", *_NEW, "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}")
    _openssl(folder, "x509", "-req", "-in", f"{name}.csr", "-CA", "ca.pem", "-CAkey", "ca.key",
             "-CAcreateserial",
             "-days", "365", "-out", f"{name}.pem", "-extfile", "extensions")
