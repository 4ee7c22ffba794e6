"""A balancer of TCP connections, as a separate process: forwards each connection to an address that accepts
it.

    python3 -m chaos.balancer LISTEN PORT ADDRESS...

The balancer alternates between the addresses. It does not detect the leader, or a coordinator that accepts
connections and does not answer. If one side of a forwarded connection ends, the balancer ends the other side.
"""

from __future__ import annotations

import itertools
import socket
import sys
import threading

# The time limit for an address to accept a connection, in seconds.
ACCEPTS = 1.0


def _copy(source: socket.socket, target: socket.socket) -> None:
    """Copies the bytes of one socket to the other until one of them ends, and then ends both."""
    try:
        while part := source.recv(1 << 16):
            target.sendall(part)
    except OSError:
        # A socket is broken. The code below ends both.
        pass
    for one in (source, target):
        try:
            one.shutdown(socket.SHUT_RDWR)
        except OSError:
            # The socket has already ended.
            pass


def _join(client: socket.socket, port: int, addresses: list[str]) -> None:
    """Connects a client with the first address that accepts, and copies bytes until the connection ends."""
    with client:
        for address in addresses:
            try:
                server = socket.create_connection((address, port), timeout=ACCEPTS)
            except OSError:
                continue
            with server:
                server.settimeout(None)
                for one in (client, server):
                    one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                back = threading.Thread(target=_copy, args=(server, client), daemon=True)
                back.start()
                _copy(client, server)
                back.join()
            return


def main(listen: str, port: int, addresses: list[str]) -> None:
    """Accepts and forwards connections until a signal ends the process."""
    with socket.create_server((listen, port), backlog=64) as listener:
        print(f"listening on {listen}:{port}", flush=True)
        for turn in itertools.count():
            client, _ = listener.accept()
            # Each connection begins with the next address, so that all coordinators receive connections.
            first = turn % len(addresses)
            ordered = [*addresses[first:], *addresses[:first]]
            threading.Thread(target=_join, args=(client, port, ordered), daemon=True).start()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3:])
