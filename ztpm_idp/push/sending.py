"""Sending to one webhook: one POST, bounded in time and size, no redirect followed, no proxy of the environment."""

from __future__ import annotations

import asyncio
import logging
import ssl
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

import httpx2

from ztpm_idp.domain.asking.pushes import PushCode

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ztpm_idp.webhook_settings import Webhook

SEND_S: Final = 5.0
"""Ours: longest time for one try, with name, connection, TLS and the head of the answer."""
AGAIN_MOST_S: Final = 60
"""Ours: longest pause that an answer may ask for."""
_HTTPS, _HTTP = 443, 80
_OK, _MULTIPLE, _BAD, _BROKEN = 200, 300, 400, 500
_LATER: Final = frozenset({408, 425, 429})
"""Statuses of the client's side after which the same may be sent again (RFC 9110, RFC 8470, RFC 6585)."""


@dataclass(frozen=True, slots=True)
class Sent:
    """End of one try.

    Attributes:
        code: the reason for which it was not taken; None: it was.
        detail: status or kind of fault, without any part of the address.
        again: the same may be sent again.
        again_s: pause that the answer asks for, at most `AGAIN_MOST_S`; 0 where it asks for none.
        status: of the answer; 0 where there was none.
    """

    code: PushCode | None
    detail: str = ""
    again: bool = False
    again_s: int = 0
    status: int = 0


async def send(webhook: Webhook, url: str, body: bytes, *, patience_s: float = SEND_S) -> Sent:
    """Sends a message once.

    Args:
        webhook: says whose certificate is believed.
        url: of `message.request_of`.
        body: likewise.
        patience_s: longest time for all of it.
    """
    verify: ssl.SSLContext | bool = webhook.authorities if webhook.authorities is not None else False
    return await post(url, body, headers={"content-type": "application/json"}, verify=verify, patience_s=patience_s)


async def post(
    url: str | httpx2.URL,
    body: bytes,
    *,
    headers: Mapping[str, str],
    verify: ssl.SSLContext | bool,
    extensions: Mapping[str, str] = MappingProxyType({}),
    patience_s: float,
) -> Sent:
    """Sends a body once.

    Args:
        url: of the receiver.
        body: of the request.
        headers: beside those that every request has.
        verify: authorities by which its certificate is believed; False: it is on this machine, in the clear.
        extensions: of the connection.
        patience_s: longest time for all of it.
    """
    every = {"accept-encoding": "identity", "user-agent": "ztpm", **headers}
    # Connecting and the handshake end by themselves: one that is cancelled in its midst keeps its socket.
    patience = httpx2.Timeout(patience_s, connect=patience_s / 2)
    try:
        async with (
            asyncio.timeout(patience_s),
            httpx2.AsyncClient(verify=verify, trust_env=False, follow_redirects=False, timeout=patience) as http,
            # Its body is not read: what is in it decides nothing.
            http.stream("POST", url, content=body, headers=every, extensions=dict(extensions)) as answer,
        ):
            return replace(_judged(answer), status=answer.status_code)
    except (TimeoutError, httpx2.TimeoutException):
        return Sent(PushCode.PUSH_UNREACHABLE, f"no answer within {patience_s:g} s", again=True)
    except (httpx2.HTTPError, httpx2.InvalidURL, ssl.SSLError, OSError, UnicodeError) as error:
        return Sent(PushCode.PUSH_UNREACHABLE, type(error).__name__, again=True)


async def reached(webhook: Webhook, *, patience_s: float = SEND_S) -> Sent:
    """Connects to a webhook's host, with TLS where its address has it, and sends nothing.

    Args:
        webhook: whose host is tried.
        patience_s: longest time for all of it.
    """
    parts = urlsplit(webhook.url)
    port = parts.port or (_HTTPS if parts.scheme == "https" else _HTTP)
    try:
        async with asyncio.timeout(patience_s):
            _, writer = await asyncio.open_connection(parts.hostname, port, ssl=webhook.authorities)
    except TimeoutError:
        return Sent(PushCode.PUSH_UNREACHABLE, f"no connection within {patience_s:g} s")
    except (OSError, UnicodeError) as error:
        return Sent(PushCode.PUSH_UNREACHABLE, type(error).__name__)
    writer.close()
    return Sent(None)


def _judged(answer: httpx2.Response) -> Sent:
    status = answer.status_code
    if _OK <= status < _MULTIPLE:
        return Sent(None)
    if status in _LATER or status >= _BROKEN:
        return Sent(PushCode.PUSH_NOT_TAKEN, f"status {status}", again=True, again_s=_pause_s(answer))
    if _MULTIPLE <= status < _BAD:
        return Sent(PushCode.PUSH_REFUSED, f"status {status}: a redirect, which is not followed")
    return Sent(PushCode.PUSH_REFUSED, f"status {status}")


def _pause_s(answer: httpx2.Response) -> int:
    said = answer.headers.get("retry-after", "")
    return min(int(said), AGAIN_MOST_S) if said.isascii() and said.isdigit() and len(said) <= 9 else 0


def silence() -> None:
    """The client's own log says nothing below warnings from now on: it would have each address."""
    for name in ("httpx2", "httpcore2"):
        log = logging.getLogger(name)
        log.setLevel(max(log.level, logging.WARNING))
