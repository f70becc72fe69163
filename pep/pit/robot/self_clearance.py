"""Pairs of a foreign arm's capsules that are watched against each other, and checks of those that are not.

All capsules of links that are no neighbours are watched, those of the tool too. A person may name a pair that never
meets, or one that always overlaps because both reach over a short link between them; random configurations must bear
that out. A pair that never comes apart is refused unless it is named, for with it every motion would be one into
itself.
"""

from __future__ import annotations

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
    for pair, (nearest, farthest) in _gaps_m(robot).items():
        told = ", ".join(pair)
        match why.get(pair):
            case "never" if not nearest >= NEVER_M:
                raise ModelError("PHYSICS_FAULT", f"{told}: they come near each other")
            case "always" if not farthest < 0:
                raise ModelError("PHYSICS_FAULT", f"{told}: they do not always overlap")
            case None if farthest < 0:
                raise ModelError("PHYSICS_FAULT", f"{told}: they never come apart")
            case _:
                pass
    return robot


def proposed(robot: Robot) -> tuple[Apart, ...]:
    """Pairs of this arm that sampling would leave out, for a person to look through."""
    found = []
    for (inner, outer), (nearest, farthest) in _gaps_m(robot).items():
        if nearest >= NEVER_M:
            found.append(Apart(inner, outer, "never"))
        elif farthest < 0:
            found.append(Apart(inner, outer, "always"))
    return tuple(found)


def _gaps_m(robot: Robot) -> dict[tuple[str, str], tuple[float, float]]:
    """Least and largest gap over the samples of each pair of capsules of links that are no neighbours."""
    low, high = robot.position_ranges_rad
    rotation, origin = link_frames(robot, np.random.default_rng(SEED).uniform(low, high, (SAMPLES, JOINTS)))

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
