"""A plain RTDE client, in the vendor's order: what ur_rtde does not let a test say or see."""

import socket

from pep.rtde.wire import codec as c
from pep.rtde.wire import messages as m

RTDE = 30004


class Plain:
    """One connection. `pieces` are the sizes of what came, as the socket gave them."""

    def __init__(self, host, protocol=2, timeout_s=15):
        self.socket = socket.create_connection((host, RTDE), timeout=timeout_s)
        self.framer, self.waiting, self.pieces, self.protocol = c.Framer(c.MAX_FRAME), [], [], 1
        if protocol == 2:
            assert self.ask(m.RequestProtocol(2)) == m.ProtocolAnswer(True)
            self.protocol = 2

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def send(self, request):
        self.socket.sendall(c.encode_request(request, self.protocol))

    def next(self):
        """The next frame, or None when the controller has closed the connection."""
        while not self.waiting:
            received = self.socket.recv(65536)
            if not received:
                return None
            self.pieces.append(len(received))
            self.waiting += self.framer.feed(received)
        return c.decode_answer(self.waiting.pop(0), self.protocol)

    def ask(self, request):
        """The answer; packages of a stream that come before it are passed over."""
        self.send(request)
        while isinstance(answer := self.next(), m.Values):
            pass
        return answer

    def values(self, recipe):
        """The next package, by name."""
        while not isinstance(package := self.next(), m.Values):
            assert package is not None
        return recipe.unpack(package.packed)

    def ended(self):
        """Reads to the end: True when the controller closed the connection."""
        try:
            while self.next() is not None:
                pass
        except ConnectionError:
            pass
        return True
