"""Labels in the words of statements: stated in receipts and rows of memory, and read back."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypedDict

from capabilities.statements.context.admission import INTEGRITIES
from policies.words.labels import Integrity, Label, Source

if TYPE_CHECKING:
    from capabilities.statements.context.admission import Receipt
    from capabilities.statements.context.memory import Remembered


class Words(TypedDict):
    """Members of a statement that belong to a label."""

    sources: tuple[str, ...]
    signers: tuple[str, ...]
    integrity: str
    age_ms: int
    tainted: bool


def words_of(label: Label) -> Words:
    """Words of the label, to be stated."""
    return Words(
        sources=tuple(sorted(map(str, label.sources))),
        signers=tuple(sorted(label.signers)),
        integrity=INTEGRITIES[label.integrity],
        age_ms=label.age_ms,
        tainted=label.tainted,
    )


def label_in(said: Receipt | Remembered) -> Label:
    """Label that is stated, as it was then."""
    return Label(
        sources=frozenset(map(Source, said.sources)),
        signers=frozenset(said.signers),
        integrity=Integrity(INTEGRITIES.index(said.integrity)),
        age_ms=said.age_ms,
        tainted=said.tainted,
    )
