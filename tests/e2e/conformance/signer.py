"""Connector of a client that knows nothing of proofs: passes each HTTP request on, signed, and its answer back.

It changes nothing else: bodies, streams, and the headers that the client made, also a wrong `Host`.
"""

from __future__ import annotations

import asyncio
import threading
import time
from contextlib import contextmanager
from urllib.parse import urlsplit

import httpx2
import uvicorn
from tests.ztpm_idp.test_process import free_port

from ztpm_idp.client import ProofAuth

HOP = {"connection", "keep-alive", "transfer-encoding", "content-length"}
"""Headers of one connection (RFC 9110, section 7.6.1)."""
ANSWER_S = 30.0


class Signer:
    """ASGI app at an address of its own, before the server at a URL."""

    def __init__(self, url, token, key):
        self._there = url
        self._auth = ProofAuth(key, token)
        self.http = httpx2.AsyncClient(timeout=ANSWER_S, trust_env=False)
        self.port = free_port()
        self.url = f"http://127.0.0.1:{self.port}/mcp"

    def _headers(self, scope):
        here, there = f"127.0.0.1:{self.port}".encode(), urlsplit(self._there).netloc.encode()
        # Its own address is the server's to the client: another one is passed on as it is.
        return [
            (name, value.replace(here, there) if name in {b"host", b"origin"} else value)
            for name, value in scope["headers"]
            if name.decode() not in HOP
        ]

    async def __call__(self, scope, receive, send):
        if scope["type"] != "http":
            return
        body, more = b"", True
        while more:
            message = await receive()
            body, more = body + message.get("body", b""), message.get("more_body", False)
        passing = asyncio.create_task(self._passed(scope, body, send))
        gone = asyncio.create_task(receive())  # a client that goes is an event of its own
        await asyncio.wait({passing, gone}, return_when=asyncio.FIRST_COMPLETED)
        for task in (passing, gone):
            task.cancel()
        await asyncio.gather(passing, gone, return_exceptions=True)

    async def _passed(self, scope, body, send):
        request = self.http.build_request(scope["method"], self._there, headers=self._headers(scope), content=body)
        answer = await self.http.send(request, auth=self._auth, stream=True)
        try:
            told = [(name, value) for name, value in answer.headers.raw if name.lower().decode() not in HOP]
            await send({"type": "http.response.start", "status": answer.status_code, "headers": told})
            async for piece in answer.aiter_raw():
                await send({"type": "http.response.body", "body": piece, "more_body": True})
            await send({"type": "http.response.body", "body": b""})
        finally:
            await answer.aclose()


@contextmanager
def signing(url, token, key):
    """A connector that serves; the URL at which it does."""
    app = Signer(url, token, key)
    config = uvicorn.Config(
        app, port=app.port, log_level="error", lifespan="off", http="h11", timeout_graceful_shutdown=1
    )
    served = uvicorn.Server(config)

    async def serve():
        async with app.http:
            await served.serve()

    thread = threading.Thread(target=lambda: asyncio.run(serve()), daemon=True)
    thread.start()
    try:
        while not served.started:
            time.sleep(0.01)
        yield app.url
    finally:
        served.should_exit = True
        thread.join(10)
