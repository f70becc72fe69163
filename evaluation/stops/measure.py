"""Stop times on an embedded cell: authority revoked, or a person walking in, at random instants of random moves.

t0 is when the identity provider has acknowledged the revocation, or when the sensor has sent the first frame that shows
the person; t1 the first 2 ms sample with commanded deceleration; t2 all joints under 1 mrad/s. The samples come over a
receive connection of the evaluation's own. Every motion has a token with a hop of its own, so that one revocation ends
one motion.
"""

from __future__ import annotations

import json
import math
import random
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from ztpm.demo.run import play
from ztpm.demo.story import STORY
from ztpm.stage.lending import arm_only, hand_down, hop_id
from ztpm.stage.live import stage
from ztpm.stage.samples import StateRecorder
from ztpm.stage.scene import front, person
from ztpm.stage.stage import LEFT, StageError, until
from ztpm.stage.stopping import BAR_S, Stopped, read_stop

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from ztpm.stage.calls import Answer
    from ztpm.stage.stage import Stage

AGENT: Final = "robotic"
FASTEST: Final = 1_000_000
"""Joint speed that the fresh hop is left, urad/s: a little less than the orchestrator holds, as it must be."""
SPEED_RAD_S: Final = (0.25, 0.95)
ACCELERATION_RAD_S2: Final = (0.8, 1.4)
SWING_RAD: Final = (0.45, 0.95)
"""The base axis swings from side to side by so much; the others wander around the sweep's posture."""
WANDER_RAD: Final = (0.0, 0.15, 0.15, 0.25, 0.25, 0.6)
EARLY_S: Final = 0.15
"""Earliest event after the first movement."""
LATE_S: Final = 0.9
"""Latest event before the computed end: twice the longest reaction and brake, so that most motions are cut short."""
SHORTEST_S: Final = EARLY_S + LATE_S + 0.3
QUIET_S: Final = 0.05
"""Standstill that lasts this long is the end of a stop."""
PATIENCE_S: Final = 20.0
TRIES: Final = 5
"""Draws for each wanted stop before the measurement gives up: some are not permitted, some arrive before they end."""
WALK_IN_M: Final = (0.60, 0.75)
"""Distance of the person's body axis from the base axis, in front of the arm."""


class MeasureError(RuntimeError):
    """Failure of the cell to do as the measurement needs."""


@dataclass(frozen=True, slots=True)
class Move:
    """One drawn motion.

    Attributes:
        target: six joint angles, rad.
        speed_rad_s, acceleration_rad_s2: of the leading axis.
        lasts_s: computed duration.
        event_s: when it is to be cut short, after its first movement.
    """

    target: tuple[float, ...]
    speed_rad_s: float
    acceleration_rad_s2: float
    lasts_s: float
    event_s: float


@dataclass(frozen=True, slots=True)
class Report:
    """All stops of one kind.

    Attributes:
        kind: "revoked" or "walk-in".
        stops: one for each event.
        outcomes: how the tool calls ended, by their word.
        spoilt: draws that made no stop: not permitted, or arrived first.
    """

    kind: str
    stops: tuple[Stopped, ...]
    outcomes: dict[str, int]
    spoilt: int

    def figures(self) -> dict[str, Any]:
        """Milliseconds, and how many stops were outside of the model (from t1) and of the bar (from t0)."""
        return {
            "kind": self.kind,
            "count": len(self.stops),
            "spoilt": self.spoilt,
            "outcomes": self.outcomes,
            "reaction_ms": spread([stop.reaction_s * 1000 for stop in self.stops]),
            "braking_ms": spread([stop.braking_s * 1000 for stop in self.stops]),
            "travel_mrad": spread([stop.travel_rad * 1000 for stop in self.stops]),
            "beyond_model": sum(not stop.within_model for stop in self.stops),
            "beyond_bar": sum(not stop.within_bar for stop in self.stops),
        }

    @property
    def ok(self) -> bool:
        """True where no stop left the model, and the reaction is within 150 ms at p99."""
        if not self.stops:
            return False
        p99 = spread([stop.reaction_s * 1000 for stop in self.stops])["p99"]
        return p99 <= BAR_S * 1000 and all(stop.within_model for stop in self.stops)


def spread(values: Sequence[float]) -> dict[str, float]:
    """p50, p90, p99 and the greatest: nearest rank, so each is a value that was measured."""
    ranked = sorted(values)
    if not ranked:
        return {}
    ranks = {"p50": 0.50, "p90": 0.90, "p99": 0.99, "max": 1.0}
    return {name: round(ranked[math.ceil(share * len(ranked)) - 1], 1) for name, share in ranks.items()}


def draw(chance: random.Random, here: Sequence[float]) -> Move:
    """A random motion to the other side that lasts long enough to be cut short.

    Args:
        chance: seeded.
        here: joint angles now.
    """
    while True:
        side = -1.0 if here[0] > 0 else 1.0
        target = [angle + chance.uniform(-w, w) for angle, w in zip(LEFT, WANDER_RAD, strict=True)]
        target[0] = side * chance.uniform(*SWING_RAD)
        speed, acceleration = chance.uniform(*SPEED_RAD_S), chance.uniform(*ACCELERATION_RAD_S2)
        # The wire counts micro-units.
        target, speed, acceleration = [round(a, 6) for a in target], round(speed, 6), round(acceleration, 6)
        way = max(abs(b - a) for a, b in zip(here, target, strict=True))
        lasts_s = way / speed + speed / acceleration
        if lasts_s >= SHORTEST_S:
            event_s = chance.uniform(EARLY_S, lasts_s - LATE_S)
            return Move(tuple(target), speed, acceleration, lasts_s, event_s)


@dataclass
class StopBench:
    """A running cell with an orchestrator that lends, and eyes on its arm."""

    stage: Stage
    eyes: StateRecorder
    chance: random.Random
    calls: ThreadPoolExecutor

    def cut(self, event: Callable[[str], float]) -> tuple[Stopped | None, str]:
        """One random motion, cut short by an event; the stop, or None when there was none, and the call's outcome.

        Args:
            event: given the motion's token, makes the event happen and returns its t0, CLOCK_MONOTONIC in s.
        """
        token = hand_down(self.stage, AGENT, arm_only(speed_high=FASTEST), keep_as="measured")
        move = draw(self.chance, self.eyes.now().q_rad)
        begun_s = time.monotonic()
        call: Future[Answer] = self.calls.submit(
            self.stage.ask,
            AGENT,
            "move_joint",
            {
                "q_rad": list(move.target),
                "speed_rad_s": move.speed_rad_s,
                "acceleration_rad_s2": move.acceleration_rad_s2,
            },
            token=token,
        )
        self._wait(lambda: call.done() or not self.eyes.now().still, "movement")
        if call.done():
            return None, call.result().reason
        time.sleep(move.event_s)
        at_s = event(token)
        self._wait(lambda: self._quiet() and call.done(), "standstill")
        samples = self.eyes.since(begun_s)
        return read_stop(samples, at_s=at_s, acceleration_rad_s2=move.acceleration_rad_s2), _outcome(call)

    def revoke(self, token: str) -> float:
        """The motion's hop is revoked; t0 is when that was acknowledged."""
        self.stage.person("alice").revoke("hop", hop_id(self.stage, token), reason="stop times")
        return time.monotonic()

    def walk_in(self, token: str) -> float:
        """A person stands in front of the arm; t0 is when the first frame that shows it was sent."""
        del token
        radius_m = self.chance.uniform(*WALK_IN_M)
        return shown_s(self.stage, [person("walker", *front(radius_m))])

    def walk_out(self) -> None:
        """The person is gone, and the enforcement point has seen it."""
        self.stage.scene()

    def _quiet(self) -> bool:
        now = self.eyes.now()
        if not now.still:
            self._still_since_s = now.arrived_s
        return now.arrived_s - self._still_since_s > QUIET_S

    def _wait(self, seen: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + PATIENCE_S
        self._still_since_s = time.monotonic()
        while not seen():
            if time.monotonic() > deadline:
                raise MeasureError(f"not seen within {PATIENCE_S:g} s: {what}")
            time.sleep(0.002)

    def __post_init__(self) -> None:
        self._still_since_s = time.monotonic()


def shown_s(on_stage: Stage, people: list[dict[str, object]]) -> float:
    """The sensor sees these people; when it has sent the first frame that shows them, CLOCK_MONOTONIC in s."""
    output = on_stage.cell.sensor.output
    before = len(output)
    on_stage.cell.sensor.tell({"people": people, "objects": []})
    until(lambda: len(output) > before, "the sensor's word that the scene was shown")
    return float(json.loads(output[-1])["shown_ms"]) / 1000


def _outcome(call: Future[Answer]) -> str:
    try:
        answer = call.result()
    except Exception as error:  # noqa: BLE001 - how the call ends is told, not judged; the arm is
        return type(error).__name__
    # After a revocation the SDK looks at the tools once more, and is refused: that is then the last record.
    return str(answer.content.get("outcome") or answer.reason)


def measure(*, count: int, walk_in: int, seed: int, progress: Callable[[str, int], None]) -> Iterator[Report]:
    """Reports of stops, measured on a fresh embedded cell.

    Args:
        count: revocations.
        walk_in: people who walk in.
        seed: of every draw.
        progress: told the kind and how many stops there are.

    Raises:
        MeasureError: the cell did not do as the measurement needs.
    """
    with stage() as on_stage, StateRecorder(on_stage.cell.addresses.host) as eyes, ThreadPoolExecutor(1) as calls:
        for step in STORY.only(frozenset({"delegate"})):
            told = play(on_stage, step)
            if not told.ok:
                raise MeasureError(f"{step.id}: {told.told}")
        bench = StopBench(on_stage, eyes, random.Random(seed), calls)  # noqa: S311 - draws, no secrets
        if count:
            yield _repeat("revoked", count, lambda: bench.cut(bench.revoke), progress)
        if walk_in:

            def walked() -> tuple[Stopped | None, str]:
                try:
                    return bench.cut(bench.walk_in)
                finally:
                    bench.walk_out()

            yield _repeat("walk-in", walk_in, walked, progress)


def _repeat(
    kind: str, count: int, once: Callable[[], tuple[Stopped | None, str]], progress: Callable[[str, int], None]
) -> Report:
    stops: list[Stopped] = []
    outcomes: dict[str, int] = {}
    spoilt = 0
    while len(stops) < count:
        stop, outcome = once()
        if stop is None:
            spoilt += 1
            if spoilt > count * (TRIES - 1):
                raise MeasureError(f"{kind}: {spoilt} draws made no stop, the last one {outcome}")
            continue
        stops.append(stop)
        outcomes[outcome] = outcomes.get(outcome, 0) + 1
        progress(kind, len(stops))
    return Report(kind, tuple(stops), outcomes, spoilt)


__all__ = ["MeasureError", "Report", "StageError", "measure"]
