"""Relay in a process of its own that keeps a client's bytes.

`python relay.py LISTEN ROBOT FILE PORT...` appends one line for each piece of a client's bytes before it passes them on:
number of the connection, port, bytes in hex. After a line `mute` on its standard input nothing of the robot's is passed
on any more, after a line `sound` it is again.
"""

import contextlib
import itertools
import random
import socket
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

PORTS = (29999, 30003, 30004)


def main(listen, robot, file, *ports):
    numbers = itertools.count()
    out = Path(file).open("a", buffering=1)
    mute = threading.Event()

    def pump(source, sink, keep, dropped=lambda: False):
        with contextlib.suppress(OSError):
            while piece := source.recv(65536):
                keep(piece)
                if not dropped():
                    sink.sendall(piece)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def accept(server, port):
        while True:
            client, _ = server.accept()
            upstream = socket.create_connection((robot, port))
            for end in (client, upstream):
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            number = next(numbers)
            keep = lambda piece, number=number: out.write(f"{number} {port} {piece.hex()}\n")  # noqa: E731
            threading.Thread(target=pump, args=(client, upstream, keep), daemon=True).start()
            threading.Thread(target=pump, args=(upstream, client, lambda _: None, mute.is_set), daemon=True).start()

    for port in map(int, ports):
        server = socket.create_server((listen, port))
        threading.Thread(target=accept, args=(server, port), daemon=True).start()
    print("ready", flush=True)
    for line in sys.stdin:
        (mute.set if line.strip() == "mute" else mute.clear)()
        print("done", flush=True)


@dataclass
class Relay:
    """A running relay.

    Attributes:
        host: where clients connect.
        file: what they said.
        process: of it.
    """

    host: str
    file: Path
    process: subprocess.Popen

    def tell(self, line):
        """`mute` or `sound`; it is so when this returns."""
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == "done\n"

    def said(self, port):
        """The bytes of each connection to `port` so far, oldest connection first."""
        found = {}
        for line in self.file.read_text().splitlines():
            number, at, piece = line.split(" ")
            if int(at) == port:
                found[int(number)] = found.get(int(number), b"") + bytes.fromhex(piece)
        return [found[number] for number in sorted(found)]


@contextlib.contextmanager
def relay(robot, file, ports=PORTS):
    """A relay in front of `robot`, on a loopback address of its own."""
    host = f"127.{random.randint(1, 254)}.{random.randint(0, 254)}.{random.randint(1, 254)}"
    command = [sys.executable, __file__, host, robot, str(file), *map(str, ports)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            yield Relay(host, Path(file), process)
        finally:
            process.stdin.close()
            process.wait(10)


if __name__ == "__main__":
    main(*sys.argv[1:])
