"""One thing that an agent had remembered: who wrote it, under which authority, and the label that it had then.

An enforcement point says it to itself, through a store that it does not trust: every row names the one before it, so a
row that was changed, taken out or put back shows. Clause [STM-12] in docs/spec.md.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.statements import admission, statement_form
from capabilities.statements.ask import ID, TOKEN_ID
from capabilities.statements.claims import Claims, malformed, ordered
from capabilities.statements.revocation import Revoked

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "memory"
FIRST_PREVIOUS: Final = "0" * 64
BEHIND: Final = 32
"""Most names behind a row: sponsor, token, and three for each of at most nine hops."""
_REVOCABLE_ID: Final = re.compile(r"[A-Za-z0-9._:@/|+=~%-]{1,256}", re.ASCII)
_REVOCABLE: Final = frozenset(map(str, Revoked)) - {str(Revoked.AUDIENCE)}
_NAMES: Final = (
    "audience", "sequence", "previous", "name", "value", "writer", "hop_id", "token_id", "behind", "sources", "signers",
    "integrity", "age_ms", "tainted", "at",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Remembered:
    """One row of a memory.

    Attributes:
        audience: canonical URL of the enforcement point whose memory it is.
        sequence: of the row, from 1 on, without gaps.
        previous: SHA-256 (hex) of the text of the row before it; zeros for the first.
        name: under which it is remembered; a later row of the same name takes its place.
        value: SHA-256 (hex) of the value's canonical JSON.
        writer, hop_id, token_id: the holder that wrote it, and its token.
        behind: (kind, id) of all whose revocation takes the authority behind it away, each once, in order.
        sources, signers, integrity, age_ms, tainted: its label when it was written, as in a receipt.
        at: when it was written, seconds since the epoch.
    """

    audience: str
    sequence: int
    previous: str
    name: str
    value: str
    writer: str
    hop_id: str
    token_id: str
    behind: tuple[tuple[str, str], ...]
    sources: tuple[str, ...]
    signers: tuple[str, ...]
    integrity: str
    age_ms: int
    tainted: bool
    at: int


def sign(row: Remembered, key: PrivateKey) -> str:
    """The row, signed by the enforcement point."""
    claims: dict[str, object] = {name: getattr(row, name) for name in _NAMES}
    claims |= {
        "behind": [{"kind": kind, "id": id_} for kind, id_ in row.behind],
        "sources": list(row.sources),
        "signers": list(row.signers),
    }
    return statement_form.sign(KIND, claims, key)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Remembered:  # noqa: A001 - read as memory.open
    """The row, signed by one of these keys: that of the enforcement point itself.

    Raises:
        StatementError: as `sealed.open`; also for one without a source, or with names out of order.
    """
    claims = Claims(statement_form.open(KIND, text, keys, caps), *_NAMES)
    row = Remembered(
        audience=claims.url("audience"),
        sequence=claims.integer("sequence", low=1),
        previous=claims.hex_digest("previous"),
        name=claims.name("name"),
        value=claims.hex_digest("value"),
        writer=claims.name("writer"),
        hop_id=claims.token("hop_id", ID),
        token_id=claims.token("token_id", TOKEN_ID),
        behind=ordered(claims.each("behind", _behind, most=BEHIND), "a name"),
        sources=admission.sources(claims),
        signers=admission.signers(claims),
        integrity=admission.integrity(claims),
        age_ms=claims.integer("age_ms"),
        tainted=claims.boolean("tainted"),
        at=claims.integer("at"),
    )
    if (row.sequence == 1) is not (row.previous == FIRST_PREVIOUS):
        raise malformed("the first row follows none, and every other one some")
    return row


def _behind(value: object) -> tuple[str, str]:
    claims = Claims(value, "kind", "id")
    return claims.one_of("kind", _REVOCABLE), claims.token("id", _REVOCABLE_ID)
