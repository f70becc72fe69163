"""Pairs of a foreign arm's capsules that are watched against each other, and checks of those that are not.

All capsules of links that are no neighbours are watched, those of the tool too. A person may name a pair that never
meets, or one that always overlaps because both reach over a short link between them; random configurations must bear
that out. Links with one link between them cannot meet where both joints between them turn all the way round, as the
arm's file states: one of them would stop the joint. Capsules around them pretend that they do. A pair that never comes
apart is refused unless it is named, for with it every motion would be one into itself.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.errors import ModelError
from pep.pit.geometry.clearance import segment_segment
from pep.pit.robot.kinematics import link_frames
from pep.pit.robot.model import JOINTS, LinkCapsule
from pep.pit.robot.outfit import Apart

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pep.pit.base.motion import Floats
    from pep.pit.robot.outfit import Outfit
    from pep.pit.robot.robot import Robot

NEIGHBOURS: Final = 1  # links so many joints apart touch at the joint
SAMPLES: Final = 4000  # ours: configurations, over the whole range of every joint
NEVER_M: Final = (
    0.003  # ours: what pairs that never meet keep in each; ten times the samples found 0.4 mm less on the UR3e
)
TURN_RAD: Final = 2.5 * math.pi  # ours: all the way round and on; half a turn either way ends at a stop
SEED: Final = 20230  # ours: the same answer on every start


def watched(capsules: Sequence[LinkCapsule], outfit: Outfit) -> dict[str, tuple[str, ...]]:
    """Watched pairs of a model: names of capsules nearer the base, and for each those farther out.

    Raises:
        ModelError: the outfit names a pair that there is not, or one twice.
    """
    on_tools = [LinkCapsule(c.name, JOINTS, c.a_m, c.b_m, c.radius_m) for t in outfit.tools for c in t.capsules]
    named = [(apart.inner, apart.outer) for apart in outfit.apart]
    pairs = [(inner.name, outer.name) for inner, outer in _no_neighbours([*capsules, *on_tools])]
    for inner, outer in named:
        if named.count((inner, outer)) > 1 or (inner, outer) not in pairs:
            raise ModelError("PHYSICS_FAULT", f"{inner}, {outer}: no pair of links that are no neighbours, or twice")
    kept: dict[str, tuple[str, ...]] = {}
    for inner, outer in pairs:
        if (inner, outer) not in named:
            kept[inner] = (*kept.get(inner, ()), outer)
    return kept


def checked(robot: Robot, outfit: Outfit) -> Robot:
    """The same model, after checks that its pairs are as the outfit says.

    Raises:
        ModelError: a pair that is said never to meet and does or comes near it, one that is said always to overlap and
            does not, or one that always overlaps and is not named.
    """
    why = {(apart.inner, apart.outer): apart.why for apart in outfit.apart}
    link = {capsule.name: capsule.link for capsule in robot.capsules}
    for pair, (nearest, farthest) in _gaps_m(robot).items():
        told = ", ".join(pair)
        match why.get(pair):
            case "never" if not nearest >= NEVER_M:
                raise ModelError("PHYSICS_FAULT", f"{told}: they come near each other")
            case "always" if not farthest < 0:
                raise ModelError("PHYSICS_FAULT", f"{told}: they do not always overlap")
            case "turns" if not _turns(robot, *(link[name] for name in pair)):
                raise ModelError("PHYSICS_FAULT", f"{told}: no two joints between them that turn all the way round")
            case None if farthest < 0:
                raise ModelError("PHYSICS_FAULT", f"{told}: they never come apart")
            case _:
                pass
    return robot


def spelled(outfit: Outfit, capsules: Sequence[LinkCapsule]) -> Outfit:
    """The outfit with the capsules' names in place of those of links that have several."""
    names = [capsule.name for capsule in capsules]

    def of(name: str) -> list[str]:
        return [name] if name in names else [each for each in names if each.rpartition(".")[0] == name] or [name]

    apart = [Apart(i, o, each.why) for each in outfit.apart for i in of(each.inner) for o in of(each.outer)]
    return replace(outfit, apart=tuple(apart))


def _turns(robot: Robot, inner: int, outer: int) -> bool:
    """True where two joints are between the links, and each turns through every angle and on."""
    low, high = robot.position_ranges_rad
    between = slice(inner, outer)
    return outer - inner == NEIGHBOURS + 1 and bool((high[between] - low[between] >= TURN_RAD).all())


def proposed(robot: Robot, *, samples: int = SAMPLES) -> tuple[Apart, ...]:
    """Pairs of this arm that sampling would leave out, for a person to look through."""
    found = []
    for (inner, outer), (nearest, farthest) in _gaps_m(robot, samples).items():
        if nearest >= NEVER_M:
            found.append(Apart(inner, outer, "never"))
        elif farthest < 0:
            found.append(Apart(inner, outer, "always"))
    return tuple(found)


def _gaps_m(robot: Robot, samples: int = SAMPLES) -> dict[tuple[str, str], tuple[float, float]]:
    """Least and largest gap over the samples of each pair of capsules of links that are no neighbours."""
    low, high = robot.position_ranges_rad
    rotation, origin = link_frames(robot, np.random.default_rng(SEED).uniform(low, high, (samples, JOINTS)))

    def ends(capsule: LinkCapsule) -> list[Floats]:
        link = capsule.link
        return [rotation[:, link] @ np.array(point) + origin[:, link] for point in (capsule.a_m, capsule.b_m)]

    placed = {capsule.name: ends(capsule) for capsule in robot.capsules}
    found = {}
    for inner, outer in _no_neighbours(robot.capsules):
        on_inner, on_outer = segment_segment(*placed[inner.name], *placed[outer.name])
        gap = np.linalg.norm(on_outer - on_inner, axis=1) - inner.radius_m - outer.radius_m
        found[inner.name, outer.name] = float(gap.min()), float(gap.max())
    return found


def _no_neighbours(capsules: Sequence[LinkCapsule]) -> Iterator[tuple[LinkCapsule, LinkCapsule]]:
    for inner in capsules:
        for outer in capsules:
            if outer.link - inner.link > NEIGHBOURS:
                yield inner, outer
