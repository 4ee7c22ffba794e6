"""A balancer of TCP connections, as a process of its own: each goes to the first of some addresses that takes it.

    python3 -m chaos.balancer LISTEN PORT ADDRESS...

It knows nothing of who leads, nor whether a coordinator that takes connections answers. Connections that are open end with
those they lead to.
"""

from __future__ import annotations

import itertools
import socket
import sys
import threading

# How long an address may take to accept a connection, in seconds.
ACCEPTS = 1.0


def _copy(source: socket.socket, target: socket.socket) -> None:
    """Copies what one socket yields into the other until either ends, and ends both."""
    try:
        while part := source.recv(1 << 16):
            target.sendall(part)
    except OSError:
        # Whoever is at the other end sees that as well.
        pass
    for one in (source, target):
        try:
            one.shutdown(socket.SHUT_RDWR)
        except OSError:
            # It has ended already.
            pass


def _join(client: socket.socket, port: int, addresses: list[str]) -> None:
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
    """Serves until it is killed."""
    with socket.create_server((listen, port), backlog=64) as listener:
        print(f"listening on {listen}:{port}", flush=True)
        for turn in itertools.count():
            client, _ = listener.accept()
            # In turns, so that all of them are used.
            first = turn % len(addresses)
            ordered = [*addresses[first:], *addresses[:first]]
            threading.Thread(target=_join, args=(client, port, ordered), daemon=True).start()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3:])
