"""Asking an address of a configuration for a document: https by given authorities, no redirect, bounded, no proxy."""

from __future__ import annotations

import asyncio
import ssl
from typing import TYPE_CHECKING, Final

import httpx2

from ztpm_idp.keys.key_files import SettingsError

if TYPE_CHECKING:
    from pathlib import Path

FETCH_S: Final = 5.0
"""Longest wait for a whole document, connection and all."""
BEARER_BYTES: Final = 16_384
"""Longest token of a bearer file: a cluster's are below 2 KiB."""


async def fetched(setting: str, url: str, *, ca: Path, most_bytes: int, bearer: Path | None = None) -> bytes:
    """The document at an address.

    Args:
        setting: that has the address, for errors.
        url: https.
        ca: PEM file of the authorities whose server certificates are believed, and no others.
        most_bytes: of the document, as sent.
        bearer: file with the token to ask with.

    Raises:
        SettingsError: `setting`, when there is no such document.
    """
    headers = {"accept": "application/json", "accept-encoding": "identity"}
    try:
        context = ssl.create_default_context(cafile=str(ca))
        if bearer is not None:
            token = await asyncio.to_thread(bearer.read_bytes)
            headers["authorization"] = f"Bearer {token[:BEARER_BYTES].decode('ascii').strip()}"
        # Connecting and the handshake end by themselves: one that is cancelled in its midst keeps its socket.
        patience = httpx2.Timeout(FETCH_S, connect=FETCH_S / 2)
        # A client for each question: none goes on under authorities or a session from before a change.
        async with (
            asyncio.timeout(FETCH_S),
            httpx2.AsyncClient(verify=context, trust_env=False, follow_redirects=False, timeout=patience) as http,
            http.stream("GET", url, headers=headers) as answer,
        ):
            if answer.status_code != 200:
                raise SettingsError(setting, f"status {answer.status_code}")
            content = bytearray()
            async for part in answer.aiter_raw():
                content += part
                if len(content) > most_bytes:
                    raise SettingsError(setting, f"over {most_bytes} bytes")
            return bytes(content)
    except (TimeoutError, httpx2.TimeoutException):
        raise SettingsError(setting, f"no answer within {FETCH_S:.0f} s") from None
    except (httpx2.HTTPError, httpx2.InvalidURL, ssl.SSLError, OSError, UnicodeError) as error:
        raise SettingsError(setting, type(error).__name__) from None
