"""Campaign: one claim about tokens, tried so many times, with its settings and its result."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of a campaign.

    Attributes:
        quick: few trials, which show that it runs; the bar is of the full number.
        seed: of every draw.
        vectors: the directory of vectors made by others, with `biscuit` and `wycheproof` in it; None where absent.
        clock_ns: a monotonic clock.
        told: receives the name of each step.
    """

    quick: bool
    seed: int
    vectors: Path | None
    clock_ns: Callable[[], int]
    told: Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a campaign.

    Attributes:
        trials: their number.
        figures: by name; the ones that the bar is about come first.
        missed: each miss in a few words, the first ones only; empty when the bar is met.
    """

    trials: int
    figures: Mapping[str, int | float | str]
    missed: tuple[str, ...] = ()

    @property
    def met(self) -> bool:
        """True where the bar is met."""
        return not self.missed


@dataclass(frozen=True, slots=True)
class Skipped:
    """Reason for which a campaign did not run."""

    why: str


@dataclass(frozen=True, slots=True)
class Campaign:
    """A claim.

    Attributes:
        id: as in the list of bars, e.g. "A3".
        title: the claim that is tried.
        bar: the result that must come out.
        run: does it.
    """

    id: str
    title: str
    bar: str
    run: Callable[[Settings], Outcome | Skipped]


def missed(faults: Mapping[str, bool], failures: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """Misses of a bar: each fault that is there, and of each kind of failure the number and the first.

    The first failure is told whole.

    Args:
        faults: each possible fault, and whether it is there.
        failures: each kind, with texts that show it; made of random draws, so that only the text itself shows it again.
    """
    told = [f"{len(each)} {what}, the first: {each[0]}" for what, each in failures.items() if each]
    return (*(what for what, bad in faults.items() if bad), *told)


MISSES: int = 5
"""Most misses that are told."""


@dataclass(slots=True)
class Misses:
    """Misses as they come: all are counted, the first are told."""

    count: int = 0
    first: list[str] = field(default_factory=list)

    def add(self, what: str) -> None:
        """One more."""
        self.count += 1
        if len(self.first) < MISSES:
            self.first.append(what)

    def told(self) -> tuple[str, ...]:
        """The first ones, and how many more."""
        more = self.count - len(self.first)
        return (*self.first, f"and {more} more") if more else tuple(self.first)
