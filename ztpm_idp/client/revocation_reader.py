"""Reader of the revocation index, for programs that verify a token now and then; enforcement points follow a feed."""

from __future__ import annotations

import secrets
import time
from typing import TYPE_CHECKING, Final

import httpx2

from capabilities.statements import revocation
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import StatementError
from ztpm_idp.client import direct_http
from ztpm_idp.client.caller import TIMEOUT_S, ClientError

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.keys.trust import TrustBundle
    from capabilities.statements.revocation import RevocationIndex

PAGES: Final = 10_000
"""Most indices that are read for one view: each has one entry at least, most have thousands."""


def read_revocations(
    trust: TrustBundle,
    *,
    transport: httpx2.BaseTransport | None = None,
    monotonic: Callable[[], float] = time.monotonic,
) -> revocation.RevocationView:
    """All that the provider of the bundle has revoked, as it says now. Suspensions are in the registry, not here.

    Args:
        trust: holds the issuer and its feed key.
        transport: of `httpx2`, for tests.
        monotonic: clock of the view's age, seconds.

    Raises:
        ClientError: `UNREACHABLE`, a refusal of the provider, or `ANSWER_MALFORMED` for an index that is not its own,
            not an answer to this question, or never whole.
    """
    revoked: set[tuple[str, str]] = set()
    since, begun = 0, monotonic()
    with direct_http.client(TIMEOUT_S, transport) as http:
        for _ in range(PAGES):
            index = _index(http, trust, since)
            revoked |= {(str(entry.kind), entry.id) for entry in index.entries}
            if index.last >= index.epoch:
                age_ms = int((monotonic() - begun) * 1_000)
                return revocation.RevocationView(index.epoch, age_ms, frozenset(revoked))
            if index.last <= since:
                break
            since = index.last
    raise ClientError("ANSWER_MALFORMED", 200, "the revocation index is never whole")


def _index(http: httpx2.Client, trust: TrustBundle, since: int) -> RevocationIndex:
    nonce = secrets.token_urlsafe(24)
    try:
        answer = http.get(
            f"{trust.issuer}/revocations", params={"since": str(since), "nonce": nonce}, follow_redirects=False
        )
    except httpx2.HTTPError as error:
        raise ClientError("UNREACHABLE", 0, f"{trust.issuer}: {type(error).__name__}") from error
    if not answer.is_success:
        try:
            code = str(answer.json()["code"])
        except (ValueError, KeyError, TypeError):
            code = "ANSWER_MALFORMED"
        raise ClientError(code, answer.status_code)
    try:
        index = revocation.open(answer.text, trust.feed, DEFAULT)
    except StatementError as error:
        raise ClientError("ANSWER_MALFORMED", answer.status_code, f"the revocation index: {error.code}") from error
    if (index.issuer, index.since, index.nonce) != (trust.issuer, since, nonce):
        raise ClientError("ANSWER_MALFORMED", answer.status_code, "the revocation index answers another question")
    return index
