"""Requests at the application itself, as a server hands them over, from a client that hangs up at once."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import unquote, urlsplit

ORIGIN = "http://127.0.0.1:8700"


@dataclass(frozen=True)
class Answer:
    """An answer; `status` is 0 where the client was gone before there was one."""

    status: int
    headers: dict[str, list[str]]
    body: bytes

    def header(self, name: str) -> str:
        return ", ".join(self.headers.get(name, []))


async def send(app, method: str, url: str, headers: list[tuple[str, str]], body: bytes) -> Answer:
    """Sends one request to an ASGI application, as `uvicorn` hands it over.

    Args:
        url: whole, or a path with its query.
        headers: names and values in Latin-1.
    """
    parts = urlsplit(url)
    # What an HTTP server lets in: anything else never comes to the application.
    path = parts.path.encode("ascii")
    scope = {
        "type": "http", "asgi": {"version": "3.0", "spec_version": "2.4"}, "http_version": "1.1", "method": method,
        "scheme": "http", "path": unquote(path.decode()), "raw_path": path, "root_path": "", "state": {},
        "query_string": parts.query.encode("ascii"), "client": ("127.0.0.1", 9), "server": ("127.0.0.1", 8700),
        "headers": [(b"host", b"127.0.0.1:8700")]
        + [(name.lower().encode("latin-1"), value.encode("latin-1")) for name, value in headers],
    }  # fmt: skip
    told, status, came = bytearray(), 0, {}
    coming = [{"type": "http.request", "body": body, "more_body": False}]

    async def receive():
        return coming.pop() if coming else {"type": "http.disconnect"}

    async def take(message):
        nonlocal status
        if message["type"] == "http.response.start":
            status = message["status"]
            for name, value in message.get("headers", []):
                came.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
        else:
            told.extend(message.get("body", b""))

    await app(scope, receive, take)
    return Answer(status, came, bytes(told))
