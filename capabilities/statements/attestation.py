"""Attestation evidence: what a delegate signs, with its own key, for exactly one hop."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.statements import statement_form
from capabilities.statements.claims import Claims

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "attestation"
NONCE: Final = re.compile(r"[A-Za-z0-9_-]{16,64}", re.ASCII)
"""Form of every nonce: 16 to 64 base64url characters."""

WORKLOAD: Final = re.compile(r"|[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+", re.ASCII)
"""Nothing, or three parts; what they say is judged by `capabilities.statements.workload`, which also bounds them."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """The agent's key signs its own measurement; with a platform's token inside, the evidence is of kind `jwt`.

    Attributes:
        agent: the agent's id.
        key_thumbprint: RFC 7638 thumbprint of its key.
        nonce: of the identity provider, used once.
        delegator: who delegates: the sponsor's subject at hop 0, the parent's agent id later, "" when no hop is asked
            for.
        request_digest: SHA-256 of the canonical hop request; 32 zero bytes when no hop is asked for.
        measurement: SHA-256 over what the agent runs.
        at: seconds since the epoch.
        workload: the platform's token (capabilities.statements.workload) as it came, or "" for evidence of kind `key`.
    """

    agent: str
    key_thumbprint: str
    nonce: str
    delegator: str
    request_digest: bytes
    measurement: bytes
    at: int
    workload: str = ""


def sign(evidence: Evidence, key: PrivateKey) -> str:
    """The signed evidence."""
    claims: dict[str, object] = {
        "agent": evidence.agent,
        "key": evidence.key_thumbprint,
        "nonce": evidence.nonce,
        "delegator": evidence.delegator,
        "request": evidence.request_digest.hex(),
        "measurement": evidence.measurement.hex(),
        "at": evidence.at,
        "workload": evidence.workload,
    }
    return statement_form.sign(KIND, claims, key)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Evidence:  # noqa: A001 - read as attestation.open
    """The evidence, signed by one of these keys; it names the very key that signed it.

    Raises:
        StatementError: as `sealed.open`.
    """
    members = statement_form.open(KIND, text, keys, caps)
    claims = Claims(members, "agent", "key", "nonce", "delegator", "request", "measurement", "at", "workload")
    return Evidence(
        agent=claims.name("agent"),
        key_thumbprint=claims.one_of("key", frozenset({statement_form.signer_thumbprint(text)})),
        nonce=claims.token("nonce", NONCE),
        delegator=claims.name_or_empty("delegator"),
        request_digest=claims.digest("request"),
        measurement=claims.digest("measurement"),
        at=claims.integer("at"),
        workload=claims.token("workload", WORKLOAD),
    )
