"""A receipt: what a PEP admitted for one holder, by its digest, with what it knew of where the value comes from.

It vouches for exactly that value, and allows nothing. Clause [STM-10] in docs/spec.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.statements import statement_form
from capabilities.statements.ask import ID
from capabilities.statements.claims import Claims, malformed, ordered

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
_NAMES: Final = (
    "audience", "agent", "hop_id", "value", "sources", "signers", "integrity", "age_ms", "tainted", "at", "not_after",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Receipt:
    """What one PEP admitted.

    Attributes:
        audience: canonical URL of the PEP that admitted it.
        agent, hop_id: the holder for whom it was admitted.
        value: SHA-256 (hex) of the value's canonical JSON.
        sources: kinds of all that the value derives from, each once, sorted; at least one.
        signers: ids of everybody who signed any of that, each once, sorted; `OTHERS` for those that are not named.
        integrity: of the least of it, one of `INTEGRITIES`.
        age_ms: of the oldest part, when it was admitted.
        tainted: instructions or hidden characters were found in some of it.
        at, not_after: when it was admitted, and until when the receipt counts; seconds since the epoch, at most
            `LIFETIME_S` apart.
    """

    audience: str
    agent: str
    hop_id: str
    value: str
    sources: tuple[str, ...]
    signers: tuple[str, ...]
    integrity: str
    age_ms: int
    tainted: bool
    at: int
    not_after: int


def sign(receipt: Receipt, key: PrivateKey) -> str:
    """The receipt, signed by the PEP that admitted."""
    claims: dict[str, object] = {name: getattr(receipt, name) for name in _NAMES}
    claims |= {"sources": list(receipt.sources), "signers": list(receipt.signers)}
    return statement_form.sign(KIND, claims, key)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Receipt:  # noqa: A001 - read as admission.open
    """The receipt, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`; also for one without a source, with names out of order, and one that lives
            longer than `LIFETIME_S` or not at all.
    """
    claims = Claims(statement_form.open(KIND, text, keys, caps), *_NAMES)
    receipt = Receipt(
        audience=claims.url("audience"),
        agent=claims.name("agent"),
        hop_id=claims.token("hop_id", ID),
        value=claims.hex_digest("value"),
        sources=sources(claims),
        signers=signers(claims),
        integrity=integrity(claims),
        age_ms=claims.integer("age_ms"),
        tainted=claims.boolean("tainted"),
        at=claims.integer("at"),
        not_after=claims.integer("not_after"),
    )
    if not 0 < receipt.not_after - receipt.at <= LIFETIME_S:
        raise malformed(f"it counts for 1 to {LIFETIME_S} s")
    return receipt


# The words of a label, wherever a statement has one.


def sources(claims: Claims) -> tuple[str, ...]:
    """The member of that name: at least one of `SOURCES`, each once, sorted."""
    found = ordered(claims.each("sources", _source, most=len(SOURCES)), "a source")
    if not found:
        raise malformed("no source")
    return found


def signers(claims: Claims) -> tuple[str, ...]:
    """The member of that name: at most `SIGNERS` ids or `OTHERS`, each once, sorted."""
    return ordered(claims.each("signers", _signer, most=SIGNERS), "a signer")


def integrity(claims: Claims) -> str:
    """The member of that name: one of `INTEGRITIES`."""
    return claims.one_of("integrity", frozenset(INTEGRITIES))


def _source(value: object) -> str:
    return Claims({"source": value}, "source").one_of("source", frozenset(SOURCES))


def _signer(value: object) -> str:
    return OTHERS if value == OTHERS else Claims({"signer": value}, "signer").name("signer")
