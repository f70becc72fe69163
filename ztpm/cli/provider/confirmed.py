"""Confirmations of a revocation: which connected enforcement points have it in force, and since when."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import typer

from ztpm.cli.output import plain

if TYPE_CHECKING:
    from collections.abc import Callable

    from ztpm_idp.client import Operator
    from ztpm_idp.client.caller import Revocation

WAIT_S: Final = 5.0
"""Longest wait for confirmations: above the lease of a motion, after which a point that heard nothing moves nothing."""
LONGEST_WAIT_S: Final = 300.0
LOOK_S: Final = 0.2
"""Time between two looks."""
MILLI: Final = 1_000


@dataclass(slots=True)
class Confirmed:
    """Progress of enforcement points with one revocation.

    Attributes:
        after_ms: of each that confirmed, by id: the time from the revocation to its confirmation.
        waiting: connected ones that did not, by id.
        gone: ids of those that were not heard for half a minute.
    """

    after_ms: dict[str, int] = field(default_factory=dict)
    waiting: list[str] = field(default_factory=list)
    gone: list[str] = field(default_factory=list)

    @property
    def told(self) -> dict[str, object]:
        """As `--json` tells it."""
        return {"confirmed_after_ms": self.after_ms, "waiting": self.waiting, "not_connected": self.gone}


def wait(
    person: Operator,
    made: Revocation,
    *,
    wait_s: float,
    said: Callable[[str, int], None],
    now: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Confirmed:
    """Waits until every connected enforcement point has confirmed a revocation, or the time is over.

    Args:
        person: who asks.
        made: the revocation.
        wait_s: longest wait, seconds.
        said: told each point's id once, with the milliseconds that it took.
        now: monotonic clock, seconds.
        sleep: waits so many seconds.

    Raises:
        ClientError: the provider does not answer, or not this question.
    """
    found, until = Confirmed(), now() + wait_s
    while True:
        _look(person.points(), made, found, said)
        if not found.waiting or now() + LOOK_S > until:
            return found
        sleep(LOOK_S)


def _look(answer: dict[str, Any], made: Revocation, found: Confirmed, said: Callable[[str, int], None]) -> None:
    found.waiting, found.gone = [], []
    for point in answer["points"]:
        name = str(point["pep"])
        if (point["line"], point["epoch"]) >= (answer["line"], made.epoch):
            if name not in found.after_ms:
                found.after_ms[name] = max(0, int(point["confirmed_ms"]) - made.at_ms)
                said(name, found.after_ms[name])
        elif point["connected"]:
            found.waiting.append(name)
        else:
            found.gone.append(name)


def say(name: str, after_ms: int) -> None:
    """Prints the confirmation of one point."""
    typer.echo(f"  {plain(name)}  confirmed after {after_ms / MILLI:.3f} s")


def say_rest(found: Confirmed) -> None:
    """Prints the points that did not confirm."""
    for name in found.waiting:
        typer.echo(f"  {plain(name)}  connected, and not yet confirmed")
    for name in found.gone:
        typer.echo(f"  {plain(name)}  not connected: it permits nothing once its view is too old")
    if not (found.after_ms or found.waiting or found.gone):
        typer.echo("  No enforcement point is registered.")
