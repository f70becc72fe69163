"""HTTP straight to the address that was named: no proxy or password of the environment, and its certificates.

`trust_env=False` alone leaves SSL_CERT_FILE unread too; a client with a transport of its own reads it.
"""

from __future__ import annotations

import functools
import os
from typing import TYPE_CHECKING

import httpx2

if TYPE_CHECKING:
    import ssl


def client(timeout_s: float, transport: httpx2.BaseTransport | None = None) -> httpx2.Client:
    """A client that waits so long for each step of a request.

    Args:
        timeout_s: longest wait to connect, to send, for an answer, seconds.
        transport: in place of the network's, for tests.
    """
    return httpx2.Client(
        transport=transport or httpx2.HTTPTransport(verify=_trusted()), timeout=timeout_s, trust_env=False
    )


def async_client() -> httpx2.AsyncClient:
    """Client for an event loop. The caller bounds each request."""
    return httpx2.AsyncClient(transport=httpx2.AsyncHTTPTransport(verify=_trusted()), trust_env=False)


def _trusted() -> ssl.SSLContext:
    """The trusted certificates, read once until the environment names others: that takes tens of milliseconds."""
    file = os.environ.get("SSL_CERT_FILE")
    changed_ns = os.stat(file).st_mtime_ns if file and os.path.exists(file) else None  # noqa: PTH110, PTH116
    return _read(file, changed_ns, os.environ.get("SSL_CERT_DIR"))


@functools.lru_cache(maxsize=1)
def _read(_file: str | None, _changed_ns: int | None, _folder: str | None) -> ssl.SSLContext:
    return httpx2.create_ssl_context()
