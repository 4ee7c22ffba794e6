"""Network namespaces, one a node, each with a device whose other end the switch holds."""

from __future__ import annotations

import fcntl
import os
import struct
import subprocess
from pathlib import Path

from .switch import MTU, NETWORK

# From linux/if_tun.h: the request, and a device of IP packets without a header of its own.
TUNSETIFF = 0x400454CA
IFF_TUN = 0x0001
IFF_NO_PI = 0x1000


class NoNamespaces(Exception):
    """This machine cannot make network namespaces with TUN devices; the text says why."""


def _ip(*words: str, lines: str | None = None) -> None:
    ran = subprocess.run(["ip", *words], input=lines, capture_output=True, text=True, check=False)
    if ran.returncode != 0:
        raise NoNamespaces(f"ip {' '.join(words)}: {ran.stderr.strip()}")


class Space:
    """The namespace of one node."""

    def __init__(self, name: str, number: int) -> None:
        """`name` is unique on this machine and has at most 13 characters; `number` is the address's last byte."""
        self.name = name
        self.number = number
        self.address = f"{NETWORK}{number}"
        _ip("netns", "add", name)
        self.device = self._open_device()

    def _open_device(self) -> int:
        try:
            device = os.open("/dev/net/tun", os.O_RDWR | os.O_CLOEXEC)
        except OSError as error:
            raise NoNamespaces(f"/dev/net/tun: {error.strerror}") from error
        # The device is made here and moved: its other end stays open in this process.
        title = f"t-{self.name}"[:15]
        request = struct.pack("16sH22x", title.encode(), IFF_TUN | IFF_NO_PI)
        try:
            fcntl.ioctl(device, TUNSETIFF, request)
        except OSError as error:
            raise NoNamespaces(f"a TUN device cannot be made: {error.strerror}") from error
        _ip("link", "set", title, "netns", self.name)
        lines = f"link set lo up\nlink set {title} name eth0 mtu {MTU}\naddr add {self.address}/24 dev eth0\nlink set eth0 up\n"
        _ip("-netns", self.name, "-batch", "-", lines=lines)
        return device

    def link(self, up: bool) -> None:
        """Takes the node's link up or down, as pulling its plug would."""
        _ip("-netns", self.name, "link", "set", "eth0", "up" if up else "down")

    def within(self, command: list[str]) -> list[str]:
        """The command that runs `command` in this namespace, as the same process."""
        return ["nsenter", f"--net={Path('/run/netns') / self.name}", *command]

    def remove(self) -> None:
        """Removes the namespace once nothing runs in it."""
        _ip("netns", "delete", self.name)
