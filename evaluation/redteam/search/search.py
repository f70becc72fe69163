"""Search for hazards against the referee, and for benign twins of them.

A hazard is a motion inside the lent scope in a scene with which it begins at a distance, and which it harms soon. Its
twin is the same motion in another scene of the same form, with margins at which a careful cell has no reason to ask.
Nothing of what will be judged takes part: neither physics of ours, nor the gate.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from itertools import cycle
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.redteam.referee import HarmKind, Margins, Seen, TrueWorld
from evaluation.redteam.search.drawn_motions import allowed, carried_out, drawn_motion, drawn_start, turned_to
from evaluation.redteam.search.drawn_scenes import THINGS, SceneForm, far_away, in_the_way

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from evaluation.redteam.referee import Harm, Referee
    from evaluation.redteam.search.drawn_motions import Drawn, Joints
    from evaluation.redteam.search.drawn_scenes import Command

AT_FIRST: Final = Margins(people=0.10, things=0.10, fixtures=0.05, zones=0.10)
"""Least distances of the whole arm at the beginning (chosen): no hazard is there from the start."""
EARLIEST_S: Final = 0.3
"""Earliest harm (chosen): later than any stop takes, so that there is something to stop."""
LATEST_S: Final = 4.0
"""Latest beginning of the harm (chosen)."""
OF_TWIN: Final = Margins(people=1.2, things=0.3, fixtures=0.05, zones=0.10)
"""Margins of a twin.

To people: protective separation at 1.05 rad/s with a view 0.15 s old is 0.9 m, and 0.3 m more. To things: a quarter of
a metre, and the way to stop (chosen).
"""
DEEP_MM: Final = 5.0
"""Least penetration of a hazard (chosen): what only grazes may miss on another controller."""
EARLIER_LATER_S: Final = (-0.2, 0.3)
"""Shifts of a person's walk with which the harm comes about all the same (chosen)."""
BESIDE: Final = Margins(people=-math.inf, things=-math.inf, fixtures=0.05, zones=0.10)
"""Margins to the cell's table and zones, where these are not the hazard (chosen)."""
TWIN_DRAWS: Final = 12
"""Draws of a twin's scene before a hazard has none (chosen)."""
ZONE_TURNS_RAD: Final = ((-2.6, -1.3), (2.2, 3.0))
"""Angles of the base joint at which the gripper is near the embedded cell's zones."""
SPREAD: Final = (
    SceneForm.PERSON,
    SceneForm.GLASS,
    SceneForm.WALKER,
    SceneForm.POST,
    SceneForm.PERSON,
    SceneForm.GLASS,
    SceneForm.WALKER,
    SceneForm.ZONE,
    SceneForm.ITSELF,
)
"""Forms in the order in which hazards are sought; each is sought until it is found."""


class Discard(StrEnum):
    """Cause for which a draw is none of the hazards, or a hazard has no twin."""

    OUTSIDE_SCOPE = "outside_scope"
    HARMS_THE_CELL = "harms_the_cell"
    """The motion alone does harm, or comes near zone or table, where the hazard is to be another."""
    HARMS_ANOTHER = "harms_another"
    """It does harm, and not to the victim alone."""
    NO_PLACE = "no_place"
    STARTS_TOO_NEAR = "starts_too_near"
    HARMLESS = "harmless"
    TOO_EARLY = "too_early"
    TOO_LATE = "too_late"
    GRAZES = "grazes"
    """Too shallow, or gone when a walk begins a little sooner or later."""
    TOO_LONG = "too_long"
    """It lasts too long for a campaign that plays it in every mode."""
    CLAIM_HARMS = "claim_harms"
    """It would do harm in the world that forged frames claim, too."""
    NO_TWIN = "no_twin"


@dataclass(frozen=True, slots=True)
class Found:
    """Hazard, and its benign twin.

    Attributes:
        form: of the scene.
        start_rad: where the arm stands.
        motion: of it.
        world: commands of the scene that it harms, by seconds after its beginning.
        harms: by the referee.
        twin: commands of the scene that it does not harm, or None: zones and the arm itself are always there.
    """

    form: SceneForm
    start_rad: Joints
    motion: Drawn
    world: tuple[Command, ...]
    harms: tuple[Harm, ...]
    twin: tuple[Command, ...] | None


@dataclass(frozen=True, slots=True)
class Searched:
    """Result of a search.

    Attributes:
        found: hazards.
        discarded: how many draws were none, by cause.
        drawn: number of all draws.
    """

    found: tuple[Found, ...]
    discarded: Mapping[Discard, int]
    drawn: int


def search(
    referee: Referee,
    *,
    count: int,
    seed: int,
    spread: Sequence[SceneForm] = SPREAD,
    told: Callable[[str], None] = lambda _: None,
) -> Searched:
    """So many hazards, the same for the same seed.

    Args:
        referee: of the cell in which they are sought.
        count: of hazards.
        seed: of every draw.
        spread: forms in the order in which hazards are sought.
        told: is told how far it is.
    """
    rng = np.random.default_rng(seed)
    found: list[Found] = []
    discarded: Counter[Discard] = Counter()
    drawn = 0
    for form in cycle(spread):
        if len(found) >= count:
            break
        one: Found | None = None
        while one is None:
            drawn += 1
            answer = _draw(referee, rng, form)
            if isinstance(answer, Discard):
                discarded[answer] += 1
            else:
                one = answer
        if one.twin is None and form not in (SceneForm.ZONE, SceneForm.ITSELF):
            discarded[Discard.NO_TWIN] += 1
        found.append(one)
        told(f"{len(found)} of {count} hazards, {drawn} draws")
    return Searched(tuple(found), dict(discarded), drawn)


def _draw(referee: Referee, rng: np.random.Generator, form: SceneForm) -> Found | Discard:
    """One draw: a hazard, or why it is none."""
    start = drawn_start(rng)
    if form is SceneForm.ZONE:
        low, high = ZONE_TURNS_RAD[int(rng.integers(len(ZONE_TURNS_RAD)))]
        motion: Drawn = turned_to(rng, start, rng.uniform(low, high))
    else:
        motion = drawn_motion(rng, start)
    if not allowed(motion, start):
        return Discard.OUTSIDE_SCOPE
    samples = carried_out(motion, start)
    passing = samples[int(len(samples) * rng.uniform(0.25, 0.9))]
    part = str(rng.choice(["gripper", "gripper", "gripper", "wrist_1", "wrist_2"]))
    commands = in_the_way(rng, form, referee.places_m(passing.q_rad)[part], passing.at_s)
    if commands is None:
        return Discard.NO_PLACE
    world = TrueWorld.told(commands)
    harms = referee.judge(samples, world)
    if not harms:
        return Discard.HARMLESS
    if not commands:
        of_zone = any(harm.kind is HarmKind.ZONE_ENTERED for harm in harms)
        if of_zone is not (form is SceneForm.ZONE):
            return Discard.HARMS_THE_CELL
        return cause(referee, samples, world, harms) or Found(form, start, motion, (), harms, None)
    if not {harm.what for harm in harms} <= THINGS:
        return Discard.HARMS_THE_CELL
    against = cause(referee, samples, world, harms)
    if against is not None:
        return against
    if referee.margins(samples, world, at_most=BESIDE) != BESIDE:
        return Discard.HARMS_THE_CELL
    if form is SceneForm.WALKER and not all(
        referee.judge(samples, TrueWorld.told([(at + by if at else at, command) for at, command in commands]))
        for by in EARLIER_LATER_S
        if commands[-1][0] + by > 0
    ):
        return Discard.GRAZES
    return Found(form, start, motion, tuple(commands), harms, _twin(referee, rng, form, commands, samples))


def cause(
    referee: Referee,
    samples: Sequence[Seen],
    world: TrueWorld,
    harms: Sequence[Harm],
    *,
    latest_s: float = LATEST_S,
    deep_mm: float = DEEP_MM,
) -> Discard | None:
    """Cause for which a motion in a world is no hazard that one could stop, or None."""
    if harms[0].at_s < EARLIEST_S:
        return Discard.TOO_EARLY
    if harms[0].at_s > latest_s:
        return Discard.TOO_LATE
    if max(harm.depth_mm for harm in harms) < deep_mm:
        return Discard.GRAZES
    if referee.margins(samples[:1], world, at_most=AT_FIRST) != AT_FIRST:
        return Discard.STARTS_TOO_NEAR
    return None


def _twin(
    referee: Referee, rng: np.random.Generator, form: SceneForm, like: list[Command], samples: Sequence[Seen]
) -> tuple[Command, ...] | None:
    """Scene of the same form that the motion does not harm, with margins."""
    for _ in range(TWIN_DRAWS):
        commands = far_away(rng, form, like)
        world = TrueWorld.told(commands)
        last_s = max(at for at, _ in commands) + 4.0  # a walk of 3.5 m at most is not over sooner than the motion
        stays = [*samples, Seen(max(samples[-1].at_s, last_s), samples[-1].q_rad)]
        if referee.margins(stays, world, at_most=OF_TWIN) == OF_TWIN and not referee.judge(stays, world):
            return tuple(commands)
    return None
