"""Network namespaces, one per node, each with a TUN device that is connected to the switch."""

from __future__ import annotations

import fcntl
import os
import struct
import subprocess
from pathlib import Path

from .switch import MTU, NETWORK

# Constants of linux/if_tun.h: the request, and the flags of a device of IP packets without an additional
# header.
TUNSETIFF = 0x400454CA
IFF_TUN = 0x0001
IFF_NO_PI = 0x1000


class NoNamespaces(Exception):
    """The error for a missing requirement of the harness, such as network namespaces.

    The text names the requirement.
    """


def _ip(*words: str, lines: str | None = None) -> None:
    """Runs the command ip with these arguments and with `lines` as input."""
    ran = subprocess.run(["ip", *words], input=lines, capture_output=True, text=True, check=False)
    if ran.returncode != 0:
        raise NoNamespaces(f"ip {' '.join(words)}: {ran.stderr.strip()}")


class Space:
    """The network namespace of one node."""

    def __init__(self, name: str, number: int) -> None:
        """Creates a namespace.

        `name` is unique on this machine and has at most 13 characters. `number` is the last byte of the
        address.
        """
        self.name = name
        self.number = number
        self.address = f"{NETWORK}{number}"
        _ip("netns", "add", name)
        self.device = self._open_device()

    def _open_device(self) -> int:
        """Creates the device, moves it to the namespace, and returns its file descriptor for the switch."""
        try:
            device = os.open("/dev/net/tun", os.O_RDWR | os.O_CLOEXEC)
        except OSError as error:
            raise NoNamespaces(f"/dev/net/tun: {error.strerror}") from error
        # The file descriptor stays open in this process after the device moves to the namespace.
        title = f"t-{self.name}"[:15]
        request = struct.pack("16sH22x", title.encode(), IFF_TUN | IFF_NO_PI)
        try:
            fcntl.ioctl(device, TUNSETIFF, request)
        except OSError as error:
            raise NoNamespaces(f"this system permits no new TUN device: {error.strerror}") from error
        _ip("link", "set", title, "netns", self.name)
        lines = f"link set lo up\nlink set {title} name eth0 mtu {MTU}\n"
        lines += f"addr add {self.address}/24 dev eth0\nlink set eth0 up\n"
        _ip("-netns", self.name, "-batch", "-", lines=lines)
        return device

    def link(self, up: bool) -> None:
        """Activates or deactivates the node's link, like a network cable."""
        _ip("-netns", self.name, "link", "set", "eth0", "up" if up else "down")

    def within(self, command: list[str]) -> list[str]:
        """Returns the command that runs `command` in this namespace, in the same process."""
        return ["nsenter", f"--net={Path('/run/netns') / self.name}", *command]

    def remove(self) -> None:
        """Removes the namespace after the end of its processes."""
        _ip("netns", "delete", self.name)
