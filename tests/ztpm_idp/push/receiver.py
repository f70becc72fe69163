"""A webhook's server on loopback, which answers as a test says and keeps what it was sent."""

from __future__ import annotations

import json
import queue
import threading
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

HANG = "hang"


@dataclass(frozen=True)
class Post:
    """One request as it came."""

    path: str
    headers: dict[str, str]
    raw: bytes

    @property
    def body(self) -> dict:
        return json.loads(self.raw)


class Receiver:
    """Takes POSTs; the first answers are those of `answers`, each (status, headers) or `HANG`, all others 200.

    Args:
        tls: context of the server's side, or None.
    """

    def __init__(self, *answers, tls=None) -> None:
        self.answers = queue.SimpleQueue()
        for answer in answers:
            self.answers.put(answer)
        self.posts = queue.SimpleQueue()
        self._ends = threading.Event()
        receiver = self

        class Taking(BaseHTTPRequestHandler):
            def do_POST(self):
                raw = self.rfile.read(int(self.headers["content-length"]))
                receiver.posts.put(Post(self.path, {n.lower(): v for n, v in self.headers.items()}, raw))
                try:
                    answer = receiver.answers.get_nowait()
                except queue.Empty:
                    answer = 200, {}
                if answer == HANG:
                    receiver._ends.wait(30)
                    return
                self.send_response(answer[0])
                for name, value in answer[1].items():
                    self.send_header(name, value)
                self.end_headers()
                self.wfile.write(b"ok" * 10_000)  # nobody reads it

            do_GET = do_POST

            def log_message(self, *_):
                pass

        class Serving(ThreadingHTTPServer):
            daemon_threads = True

            def handle_error(self, *_):
                pass  # a client that went away while it hung

        self.server = Serving(("127.0.0.1", 0), Taking)
        if tls is not None:
            self.server.socket = tls.wrap_socket(self.server.socket, server_side=True)
        self.port = self.server.server_address[1]
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()

    def url(self, path="/hook/s3cret", *, scheme="http", host="127.0.0.1"):
        return f"{scheme}://{host}:{self.port}{path}"

    def all(self) -> list[Post]:
        """Requests since the last call."""
        found = []
        while not self.posts.empty():
            found.append(self.posts.get_nowait())
        return found

    def close(self):
        self._ends.set()
        self.server.shutdown()
        self.server.server_close()
