"""Base of the peers that check no proof of possession: cells from six small functions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any, ClassVar, Final

from evaluation.harness.timing import Cell, Verdict
from evaluation.tokens.cell import Kind, Prepared, TokenKey, endless

if TYPE_CHECKING:
    from collections.abc import Callable

    from evaluation.tokens.workload import Given, Workload

NEVER_LENT: Final = "teach_mode"
"""An operation that no workload lends."""


@dataclass(frozen=True, slots=True)
class Ask:
    """A request: an operation and its arguments."""

    operation: str
    arguments: dict[str, Given]


class PlainPeer(ABC):
    """A peer whose tokens are bearer tokens."""

    name: str
    version: str
    checks: ClassVar[str]
    """Checks that a decision from the wire rests on."""
    checks_seen: ClassVar[str]
    """Checks that a decision under a token read before rests on; "" where reading leaves nothing to keep."""
    limits: ClassVar[bool] = True
    """Values are checked, and not the operation alone."""
    words: ClassVar[bool] = False
    """Limits of texts, paths and URLs are among them."""

    def __init__(self) -> None:
        self._serials = count()

    @abstractmethod
    def size(self, token: Any) -> int:
        """Its bytes, before any base64."""

    @abstractmethod
    def decide(self, token: Any, ask: Ask) -> Verdict:
        """Decision from the wire."""

    def read(self, token: Any) -> Any:
        """Part of a read token that is kept."""
        return token

    def decide_read(self, kept: Any, ask: Ask) -> Verdict:
        """Decision from the kept part of a token."""
        return self.decide(kept, ask)

    @abstractmethod
    def mint(self, workload: Workload, serial: int) -> Any:
        """A token of depth 0, in the form that `attenuate` takes."""

    @abstractmethod
    def attenuate(self, made: Any, workload: Workload, hop: int, serial: int) -> Any:
        """Token with one more hop."""

    @abstractmethod
    def wire(self, made: Any) -> Any:
        """Token as it goes over the wire."""

    def lend(self, workload: Workload, depth: int, serial: int) -> Any:
        """A token of this depth, as it goes over the wire."""
        made = self.mint(workload, serial)
        for hop in range(1, depth + 1):
            made = self.attenuate(made, workload, hop, serial)
        return self.wire(made)

    def prepare(self, workload: Workload, depth: int, calls: int) -> Prepared:
        """Cells of one scope at one depth, each good for `calls` calls."""
        good = Ask(workload.operation, workload.named(workload.values))
        wrong = {"an operation that is not lent": Ask(NEVER_LENT, good.arguments)}
        if self.limits:
            wrong["a value out of limits"] = Ask(workload.operation, workload.named(workload.outside))
        pool = [self.lend(workload, depth, next(self._serials)) for _ in range(calls)]
        one = self.lend(workload, depth, next(self._serials))

        def cell(
            kind: Kind, checks: str, fresh: Callable[[], Any], act: Callable[[Any], Any], **other: Any
        ) -> Cell[TokenKey]:
            return Cell(TokenKey(self.name, workload.name, depth, kind, proof=False), checks, fresh, act, **other)

        def refused(token: Any) -> dict[str, Callable[[], tuple[Any, Ask]]]:
            return {why: partial(_pair, token, ask) for why, ask in wrong.items()}

        cells = [
            cell(
                Kind.COLD,
                self.checks,
                endless((token, good) for token in pool),
                lambda given: self.decide(*given),
                wrong=refused(one),
            )
        ]
        if self.checks_seen:
            kept = self.read(one)
            cells.append(
                cell(
                    Kind.WARM,
                    self.checks_seen,
                    lambda: (kept, good),
                    lambda given: self.decide_read(*given),
                    wrong=refused(kept),
                )
            )
        judge = lambda made: self.decide(self.wire(made), good)  # noqa: E731
        if depth == 0:
            fresh, act = lambda: next(self._serials), lambda serial: self.mint(workload, serial)
            cells.append(cell(Kind.MINT, "", fresh, act, judge=judge))
        else:
            serial = next(self._serials)
            parent = self.mint(workload, serial)
            for hop in range(1, depth):
                parent = self.attenuate(parent, workload, hop, serial)
            again = lambda _: self.attenuate(parent, workload, depth, serial)  # noqa: E731
            cells.append(cell(Kind.ATTENUATE, "", lambda: None, again, judge=judge))
        return Prepared(tuple(cells), self.size(one))


def _pair(token: Any, ask: Ask) -> tuple[Any, Ask]:
    return token, ask
