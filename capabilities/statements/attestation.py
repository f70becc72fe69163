"""Attestation evidence: a delegate's statement, signed with its own key, for exactly one hop."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

from msgspec import field

from capabilities.keys import keys as key_forms
from capabilities.statements import statement_form
from capabilities.statements.claims import Name, NameOrEmpty, Nonce, Sha256, Thumbprint, Whole, malformed, read
from capabilities.values.form import Form, plain, whole

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "attestation"
WORKLOAD: Final = r"|[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+\.[A-Za-z0-9_-]+"
"""Form of a workload token: empty, or three parts; `capabilities.statements.workload` bounds and judges them."""


class Evidence(Form, frozen=True):
    """The agent's key signs its own measurement; with a platform's token inside, the evidence is of kind `jwt`.

    Attributes:
        agent: the agent's id.
        key_thumbprint: RFC 7638 thumbprint of its key.
        nonce: of the identity provider, used once.
        delegator: who delegates: the sponsor's subject at hop 0, the parent's agent id later, "" when no hop is asked
            for.
        request_digest: SHA-256 of the canonical hop request; 32 zero bytes when no hop is asked for.
        measurement: SHA-256 over the software that the agent runs.
        at: seconds since the epoch.
        workload: the platform's token (capabilities.statements.workload) as it came, or "" for evidence of kind `key`.
    """

    agent: Name
    key_thumbprint: Thumbprint = field(name="key")
    nonce: Nonce
    delegator: NameOrEmpty
    request_digest: Sha256 = field(name="request")
    measurement: Sha256
    at: Whole
    workload: Annotated[str, whole(WORKLOAD)]


def sign(evidence: Evidence, key: PrivateKey) -> str:
    """The signed evidence."""
    digests = {"request": evidence.request_digest.hex(), "measurement": evidence.measurement.hex()}

    def reader(claims: dict[str, object]) -> Evidence:
        return _read(claims, key_forms.thumbprint(key_forms.public_raw(key)))

    return statement_form.seal(KIND, plain(evidence) | digests, key, reader)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Evidence:  # noqa: A001 - read as attestation.open
    """The evidence, signed by one of these keys; it names the very key that signed it.

    Raises:
        StatementError: as `sealed.open`.
    """
    claims = statement_form.open(KIND, text, keys, caps)
    return _read(claims, statement_form.signer_thumbprint(text))


def _read(claims: dict[str, object], signer: str) -> Evidence:
    evidence = read(Evidence, claims)
    if evidence.key_thumbprint != signer:
        raise malformed("key: not the one that signed")
    return evidence
