"""One measured cell: a peer, a scope, a depth and what is timed, with the proof that the right thing is timed."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, StrEnum
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from evaluation.tokens.workload import Workload


class Verdict(Enum):
    """What a timed call came to."""

    ALLOWED = "allowed"
    REFUSED = "refused"
    OVERRUN = "overrun"
    """The peer gave up for its own limit of time and not for what it was asked: nothing is known, nothing counted."""


class Kind(StrEnum):
    """What is timed."""

    FIRST = "first"
    """From wire bytes to a decision, where nothing at all is remembered, not even what is common to all tokens."""
    COLD = "cold"
    """From wire bytes that were never seen to a decision, by a verifier that has served other tokens of such a scope:
    a renewed token, or the next agent's."""
    NOVEL = "novel"
    """The same, under limits that were never seen either."""
    WARM = "warm"
    """A further request under a token that was seen before, in the form that the peer keeps it in."""
    STREAM = "stream"
    """One frame of a session that was opened with a proof, to a decision."""
    MINT = "mint"
    """A new token."""
    ATTENUATE = "attenuate"
    """One more hop on a token, to the depth of the row."""


@dataclass(frozen=True, slots=True)
class Cell:
    """What is timed, and how it is known to be right.

    Attributes:
        peer, scope, depth, kind: of the row.
        proof: a proof of possession, made for this very call outside the timed part, is checked.
        checks: what a decision of this row rests on, in a few words.
        fresh: an input that no call has had before; not timed.
        act: the timed call.
        judge: what the outcome of `act` amounts to; not timed.
        wrong: by what is wrong with them, inputs that the same `act` must refuse.
    """

    peer: str
    scope: str
    depth: int
    kind: Kind
    proof: bool
    checks: str
    fresh: Callable[[], Any]
    act: Callable[[Any], Any]
    judge: Callable[[Any], Verdict] = lambda verdict: verdict
    wrong: Mapping[str, Callable[[], Any]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Which cell it is, for people."""
        return f"{self.peer} {self.scope} depth {self.depth} {self.kind}"


@dataclass(frozen=True, slots=True)
class Unmeasured:
    """A row without figures, and why: the peer is not installed, or has no such form, or refuses this depth."""

    peer: str
    scope: str
    depth: int
    kind: Kind
    proof: bool
    why: str


@dataclass(frozen=True, slots=True)
class Prepared:
    """What a peer makes of one scope at one depth.

    Attributes:
        cells: what is measured of it, or why not.
        bytes: of the token on the wire, before any base64; None when there is no token.
    """

    cells: tuple[Cell | Unmeasured, ...]
    bytes: int | None


class Peer(Protocol):
    """A peer, ready to be asked for cells."""

    name: str
    version: str

    def prepare(self, workload: Workload, depth: int, calls: int) -> Prepared:
        """Cells of one scope at one depth, each good for `calls` calls."""


def endless(made: Iterator[Any]) -> Callable[[], Any]:
    """What was made beforehand, one at each call."""
    return made.__next__
