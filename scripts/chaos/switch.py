"""The network between the nodes of a farm: a switch that loses, delays, duplicates and reorders packets.

The namespace of each node has one TUN device, and the switch has the other end of each device. All packets
therefore pass the thread of the switch. `tc netem` of Linux injects the same faults, but some kernels lack
it, and its decisions depend on a clock. The decisions of this switch depend on the seed.
"""

from __future__ import annotations

import heapq
import os
import random
import selectors
import threading
import time
from dataclasses import dataclass, field

# The prefix of all addresses. The last byte of an address is the number of the node.
NETWORK = "10.77.0."
MTU = 1500


@dataclass(frozen=True)
class Weather:
    """Faults of the packets in one direction. Probabilities are from 0 to 1, and times are in seconds."""

    loss: float = 0.0
    delay: float = 0.0
    jitter: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    cut: bool = False


@dataclass
class Counts:
    """The numbers of forwarded, lost, duplicated and delayed packets."""

    sent: int = 0
    lost: int = 0
    doubled: int = 0
    late: int = 0


@dataclass(order=True)
class _Late:
    """A delayed packet with the time at which the switch forwards it."""

    due: float
    number: int
    to: int = field(compare=False)
    packet: bytes = field(compare=False)


class Switch(threading.Thread):
    """A thread that forwards packets between the devices until `end`."""

    def __init__(self, devices: dict[int, int], seed: int) -> None:
        """Creates a switch. `devices` contains the file descriptor of each node's device."""
        super().__init__(daemon=True, name="switch")
        self.counts = Counts()
        self._devices = devices
        self._seed = seed
        self._weather: dict[tuple[int, int], list[Weather]] = {}
        self._draw: dict[tuple[int, int], random.Random] = {}
        self._late: list[_Late] = []
        self._wake, self._woken = os.pipe()
        self._ended = False

    def change(self, source: int, target: int, weather: Weather) -> None:
        """Adds weather to the packets from `source` to `target`, in addition to earlier weather."""
        self._weather[source, target] = [*self._weather.get((source, target), []), weather]

    def restore(self, source: int, target: int, weather: Weather) -> None:
        """Removes weather that `change` added."""
        left = list(self._weather.get((source, target), []))
        if weather in left:
            left.remove(weather)
        self._weather[source, target] = left

    def end(self) -> None:
        """Stops forwarding and closes the devices."""
        self._ended = True
        os.write(self._woken, b"x")
        self.join()
        for device in [*self._devices.values(), self._wake, self._woken]:
            os.close(device)

    def run(self) -> None:
        """Forwards packets until `end`."""
        with selectors.DefaultSelector() as ready:
            for node, device in self._devices.items():
                os.set_blocking(device, False)
                ready.register(device, selectors.EVENT_READ, node)
            ready.register(self._wake, selectors.EVENT_READ, None)
            while not self._ended:
                wait = max(0.0, self._late[0].due - time.monotonic()) if self._late else None
                for key, _ in ready.select(wait):
                    if key.data is not None:
                        self._take(key.data, key.fd)
                now = time.monotonic()
                while self._late and self._late[0].due <= now:
                    late = heapq.heappop(self._late)
                    self._put(late.to, late.packet)

    def _take(self, source: int, device: int) -> None:
        """Reads packets of a node and forwards them."""
        # The number of packets is limited, so that delayed packets of other nodes do not wait longer.
        for _ in range(32):
            try:
                packet = os.read(device, 65535)
            except BlockingIOError:
                return
            except OSError:
                # The link of the node is down. A later call reads its packets.
                return
            # The switch forwards only IPv4. Byte 19 is the last byte of the target's address.
            if len(packet) >= 20 and packet[0] >> 4 == 4 and packet[19] in self._devices:
                self._forward(source, packet[19], packet)

    def _forward(self, source: int, target: int, packet: bytes) -> None:
        """Applies the weather to a packet, and forwards its copies at once or later."""
        weather = self._weather.get((source, target))
        if not weather:
            self._put(target, packet)
            return
        draw = self._draw.setdefault((source, target), random.Random(f"{self._seed}/{source}/{target}"))
        delay, copies = 0.0, 1
        for one in weather:
            # Each fault draws four numbers per packet, so that the faults do not affect each other's numbers.
            lost, doubled, early, shift = (draw.random() for _ in range(4))
            if one.cut or lost < one.loss:
                copies = 0
            copies += copies > 0 and doubled < one.duplicate
            if early >= one.reorder:
                delay += max(0.0, one.delay + (2.0 * shift - 1.0) * one.jitter)
        if copies == 0:
            self.counts.lost += 1
            return
        self.counts.doubled += copies - 1
        self.counts.late += delay > 0.0
        for copy in range(copies):
            if delay > 0.0:
                due = time.monotonic() + delay
                heapq.heappush(self._late,
                               _Late(due, self.counts.sent + len(self._late) + copy, target, packet))
            else:
                self._put(target, packet)

    def _put(self, target: int, packet: bytes) -> None:
        """Writes a packet to the device of a node."""
        try:
            os.write(self._devices[target], packet)
            self.counts.sent += 1
        except OSError:
            # The queue of the device is full, or the link is down. The packet is lost, as on a real network.
            self.counts.lost += 1
