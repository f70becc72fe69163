"""Rows of the benchmark of tokens: the timed call of each peer, and the cells that it lines up."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from evaluation.harness.bench import Row
    from evaluation.harness.timing import Cell
    from evaluation.tokens.workload import Workload


class Kind(StrEnum):
    """Kind of timed call."""

    FIRST = "first"
    """From wire bytes to a decision, where nothing at all is remembered, not even parts common to all tokens."""
    COLD = "cold"
    """From unseen wire bytes to a decision, by a verifier that has served other tokens of such a scope.

    These are a renewed token, or the next agent's.
    """
    NOVEL = "novel"
    """The same as `COLD`, under limits that were never seen either."""
    WARM = "warm"
    """A further request under a token that was seen before, in the form that the peer keeps it in."""
    STREAM = "stream"
    """One frame of a session that was opened with a proof, to a decision."""
    MINT = "mint"
    """A new token."""
    ATTENUATE = "attenuate"
    """One more hop on a token, to the depth of the row."""


@dataclass(frozen=True, slots=True)
class TokenKey:
    """The key of a row.

    Attributes:
        peer: who answers.
        scope, depth: of the tokens; None, and so the others, for a peer that is not installed.
        kind: the timed call.
        proof: a proof of possession, made for this very call outside the timed part, is checked.
    """

    peer: str
    scope: str | None = None
    depth: int | None = None
    kind: Kind | None = None
    proof: bool | None = None


@dataclass(frozen=True, slots=True)
class Prepared:
    """Cells of a peer for one scope at one depth.

    Attributes:
        cells: the measured cells, or rows that say why there is none.
        bytes: of the token on the wire, before any base64; None when there is no token.
    """

    cells: tuple[Cell[TokenKey] | Row[TokenKey], ...]
    bytes: int | None


class Peer(Protocol):
    """A peer, ready to be asked for cells."""

    name: str
    version: str
    words: ClassVar[bool]
    """It is measured on limits of texts, paths and URLs, too."""

    def prepare(self, workload: Workload, depth: int, calls: int) -> Prepared:
        """Cells of one scope at one depth, each good for `calls` calls."""


def endless(made: Iterator[Any]) -> Callable[[], Any]:
    """Function that answers the next prepared value at each call."""
    return made.__next__
