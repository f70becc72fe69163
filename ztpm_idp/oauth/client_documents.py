"""Client ID metadata documents, fetched with care.

Only where the settings switch it on, only for a person who has logged in, only from public addresses, only once for
each page. The name is resolved here and the connection goes to the address that was looked at, so that no second
answer of a name server leads elsewhere.
"""

from __future__ import annotations

import asyncio
import hashlib
import ipaddress
from dataclasses import dataclass
from typing import Final, Protocol
from urllib.parse import urlsplit

import httpx2

from capabilities.values.strict_json import JsonError, read
from ztpm_idp.oauth.redirect import REDIRECTS, may_be_registered
from ztpm_idp.outward import Pinned, Resolver, pinned, resolve

DOCUMENT_BYTES: Final = 5_120
"""Largest document: 5 KiB, as the draft (draft-ietf-oauth-client-id-metadata-document, 6.6) says."""
DOCUMENT_DEPTH: Final = 8
FETCH_S: Final = 3.0
"""Longest time for all of it: name, connection, TLS, body."""
URL_BYTES: Final = 256
NAME_CHARACTERS: Final = 64
_REFUSED_BYTES: Final = frozenset('\\"<>^`{|}#@ ')
_SECRET_METHODS: Final = frozenset({"client_secret", "client_secret_expires_at"})


class DocumentError(Exception):
    """A document that cannot be had, or is refused.

    Attributes:
        why: a fixed sentence, for the person and the client's developer.
    """

    def __init__(self, why: str) -> None:
        super().__init__(why)
        self.why = why


@dataclass(frozen=True, slots=True)
class ClientDocument:
    """Document of a client.

    Attributes:
        client_id: its URL.
        host: of the URL; people are shown it first.
        name: as the client calls itself, unverified; "" where it does not.
        redirects: exact URIs.
        digest: SHA-256 of its bytes.
    """

    client_id: str
    host: str
    name: str
    redirects: tuple[str, ...]
    digest: bytes


class Fetch(Protocol):
    """Port by which a document is fetched."""

    async def __call__(self, url: str) -> ClientDocument:
        """The document of this URL.

        Raises:
            DocumentError: it cannot be had, or is refused.
        """


def is_document_url(text: str) -> bool:
    """True for a client id that is the URL of a metadata document: https, a name, a path, no port."""
    if not 1 <= len(text) <= URL_BYTES or not text.isascii() or any(not "!" <= each <= "~" for each in text):
        return False
    if not text.startswith("https://") or _REFUSED_BYTES & set(text):
        return False
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError:
        return False
    dots = {".", ".."} & set(parts.path.split("/"))
    # No port of choice, no address in place of a name: neither says whose client it is.
    return bool(parts.hostname) and parts.path not in {"", "/"} and not dots and port is None and _is_name(parts.netloc)


async def fetch(
    url: str, *, resolver: Resolver = resolve, transport: httpx2.AsyncBaseTransport | None = None
) -> ClientDocument:
    """The document of this URL, read strictly.

    Args:
        url: for which `is_document_url` holds.
        resolver: of names.
        transport: of the connection; None: the ordinary one, without a proxy of the environment.

    Raises:
        DocumentError: it cannot be had, or is refused.
    """
    host = urlsplit(url).hostname or ""
    try:
        async with asyncio.timeout(FETCH_S):
            target = await pinned(url, resolver)
            if target is None:
                raise DocumentError("the client's host has no public address, or also another one")
            raw = await _get(target, transport)
    except (httpx2.HTTPError, OSError, TimeoutError, UnicodeError):
        raise DocumentError("the client's document cannot be fetched") from None
    return _read(url, host, raw)


async def _get(target: Pinned, transport: httpx2.AsyncBaseTransport | None) -> bytes:
    async with httpx2.AsyncClient(
        transport=transport or httpx2.AsyncHTTPTransport(), trust_env=False, follow_redirects=False, timeout=FETCH_S
    ) as client:
        headers = {**target.headers, "Accept": "application/json", "Accept-Encoding": "identity"}
        asked = client.stream("GET", target.url, headers=headers, extensions=dict(target.extensions))
        async with asked as response:
            if response.status_code != 200:
                raise DocumentError("the client's document is answered with another status than 200")
            if response.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
                raise DocumentError("the client's document is not of type application/json")
            raw = bytearray()
            async for part in response.aiter_raw():
                raw += part
                if len(raw) > DOCUMENT_BYTES:
                    raise DocumentError(f"the client's document has more than {DOCUMENT_BYTES} bytes")
    return bytes(raw)


def _read(url: str, host: str, raw: bytes) -> ClientDocument:
    try:
        stated = read(raw, limit_bytes=DOCUMENT_BYTES, limit_depth=DOCUMENT_DEPTH)
    except JsonError:
        raise DocumentError("the client's document is not strict JSON") from None
    if not isinstance(stated, dict) or stated.get("client_id") != url:
        raise DocumentError("the client's document is of another client_id than its own URL")
    if _SECRET_METHODS & stated.keys() or stated.get("token_endpoint_auth_method", "none") != "none":
        raise DocumentError("a client with a document has the token_endpoint_auth_method none")
    redirects = stated.get("redirect_uris")
    if not isinstance(redirects, list) or not 1 <= len(redirects) <= REDIRECTS:
        raise DocumentError(f"the client's document has 1 to {REDIRECTS} redirect_uris")
    if not all(isinstance(uri, str) and may_be_registered(uri) for uri in redirects):
        raise DocumentError("a redirect URI of the client is neither https nor loopback")
    name = stated.get("client_name", "")
    known = name if isinstance(name, str) else ""
    # Only letters that everybody reads alike; the host is shown first in any case.
    plain = "".join(each for each in known if " " <= each <= "~")[:NAME_CHARACTERS].strip()
    return ClientDocument(url, host, plain, tuple(redirects), hashlib.sha256(raw).digest())


def _is_name(netloc: str) -> bool:
    """True for a name of a host with a dot in it, and no address."""
    try:
        ipaddress.ip_address(netloc.strip("[]"))
    except ValueError:
        return "." in netloc.strip(".") and ":" not in netloc and not netloc.rpartition(".")[2].isdigit()
    return False
