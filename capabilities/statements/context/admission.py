"""Receipt of an admission: the digest of a value that a PEP admitted for one holder, with the value's origin.

It vouches for exactly that value, and allows nothing. Clause [STM-10] in docs/spec.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

from msgspec import Meta

from capabilities.statements import statement_form
from capabilities.statements.claims import TEXT_BYTES, HexDigest, Id, Name, Url, Whole, lasting, ordered, read
from capabilities.values import text
from capabilities.values.form import Form, plain, upto, whole, words

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "admission"
SOURCES: Final = ("agent", "memory", "operator", "retrieval", "sensor", "text", "tool")
INTEGRITIES: Final = ("none", "agent", "recorded", "curated", "sensed", "principal")
"""Origin of a value and its vouchers: the words of `policies.words.labels`, vouchers from the least up."""
SIGNERS: Final = 64
"""Most signers that a receipt names."""
OTHERS: Final = "*"
"""Stands for signers that are not named, because there are too many."""
LIFETIME_S: Final = 3_600
"""Longest life of a receipt: that of the hop of evidence kind `key` that it is given under."""
Sources = Annotated[tuple[Annotated[str, words(*SOURCES)], ...], Meta(min_length=1, max_length=len(SOURCES))]
Signers = Annotated[tuple[Annotated[str, whole(rf"\*|{text.NAME.pattern}"), upto(TEXT_BYTES)], ...], upto(SIGNERS)]
Integrity = Annotated[str, words(*INTEGRITIES)]


class Receipt(Form, frozen=True):
    """Receipt of one PEP for one admitted value.

    Attributes:
        audience: canonical URL of the PEP that admitted it.
        agent, hop_id: the holder for whom it was admitted.
        value: SHA-256 (hex) of the value's canonical JSON.
        sources: kinds of all that the value derives from, each once, sorted; at least one.
        signers: ids of all who signed any of that, each once, sorted; `OTHERS` for those that are not named.
        integrity: of the least of it, one of `INTEGRITIES`.
        age_ms: of the oldest part, when it was admitted.
        tainted: instructions or hidden characters were found in some of it.
        at, not_after: when it was admitted, and until when the receipt counts; seconds since the epoch, at most
            `LIFETIME_S` apart.
    """

    audience: Url
    agent: Name
    hop_id: Id
    value: HexDigest
    sources: Sources
    signers: Signers
    integrity: Integrity
    age_ms: Whole
    tainted: bool
    at: Whole
    not_after: Whole


def sign(receipt: Receipt, key: PrivateKey) -> str:
    """The receipt, signed by the PEP that admitted."""
    return statement_form.seal(KIND, plain(receipt), key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Receipt:  # noqa: A001 - read as admission.open
    """The receipt, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`; also for one without a source, with names out of order, and one that lives
            longer than `LIFETIME_S` or not at all.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Receipt:
    receipt = read(Receipt, claims)
    ordered(receipt.sources, "a source")
    ordered(receipt.signers, "a signer")
    lasting(receipt.at, receipt.not_after, LIFETIME_S)
    return receipt
