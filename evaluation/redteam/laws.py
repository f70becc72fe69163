"""Motions of the red team by each law of the index: hazards that it misses, and work that it questions.

Only joint moves in a scene that stands still are looked at, with everything in view that is truly there; what a law
makes of a deceived sensor is no question of the law.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.statements import observation as wire
from evaluation.harness.tables import table
from evaluation.pit.approach import AGE_S, MotionReferee
from evaluation.pit.law import ALARM, LAWS
from evaluation.redteam.acts.arm import MoveJoint
from pep.pit import Assessment, CellParameters, MoveJ, Robot, assess, surveyed
from pep.pit.base.tier import tier_of
from pep.pit.scene.observation import scene_observed
from ursim.sensor.sensor_scene import Seen
from ztpm.cell import survey

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from rich.table import Table

    from evaluation.redteam.scenario import Scenario
    from pep.pit.scene.scene import Scene

CONTACTS: Final = frozenset({"person_contact", "fragile_contact", "rigid_contact"})
"""Harms about which the laws differ; zones, workspace and the arm itself are of other clauses."""
THINGS: Final = CONTACTS - {"person_contact"}
NOW_S: Final = 0.0


@dataclass(frozen=True, slots=True)
class LawTally:
    """Scenarios of the red team by one law.

    Attributes:
        hazardous: number of hazardous scenarios.
        missed: those of them about which nobody is asked (tier 2 and less).
        benign: number of benign scenarios.
        asked: those of them about which a person is asked.
    """

    hazardous: int
    missed: int
    benign: int
    asked: int


def tally(of: Sequence[Scenario]) -> Mapping[str, LawTally]:
    """Scenarios that the laws can be asked about, by law."""
    cell = _embedded()
    robot = Robot.load("ur3e", tool=cell.tool)
    indices: dict[str, list[tuple[bool, float]]] = {law: [] for law in LAWS}
    for scenario in of:
        moves = list(_moves(scenario))
        if not moves:
            continue
        referee = MotionReferee(robot, _scene(scenario, cell), cell)
        judged = [referee.judged(move) for move in moves]
        for law in LAWS:
            indices[law].append((scenario.hazardous, max(float(getattr(one, law)) for one in judged)))
    return {law: _tallied(rows) for law, rows in indices.items()}


@dataclass(frozen=True, slots=True)
class ViolationTally:
    """Scenarios whose joint moves the shipped engine asks about, by what nobody can authorise.

    Attributes:
        hazardous: number of hazardous scenarios whose harm is a contact with a thing.
        authorisable: ids of those of them in which no move is a violation.
        benign: number of benign scenarios.
        refused: ids of those of them in which a move is one.
    """

    hazardous: int
    authorisable: tuple[str, ...]
    benign: int
    refused: tuple[str, ...]

    def told(self) -> str:
        """Count of the hazards that nobody can authorise, with the ids of the others."""
        left = ", ".join(self.authorisable) or "none"
        return (
            f"of {self.hazardous} ways into a thing {self.hazardous - len(self.authorisable)} are violations, "
            f"not {left}; of {self.benign} benign ones {len(self.refused)} are"
        )


def violations(of: Sequence[Scenario]) -> ViolationTally:
    """Scenarios as of `tally`, without those that harm a person, by the violations of their moves."""
    cell = _embedded()
    robot = Robot.load("ur3e", tool=cell.tool)
    asked: list[tuple[Scenario, bool]] = []
    for scenario in of:
        moves = list(_moves(scenario))
        if not moves or (scenario.hazardous and scenario.harm not in THINGS):
            continue
        scene = _scene(scenario, cell)
        answers = [
            assess(robot, scene, move, cell, perception_age_s=AGE_S, touch=frozenset(), seed=scenario.id.encode())
            for move in moves
        ]
        asked.append((scenario, any(isinstance(answer, Assessment) and answer.violations for answer in answers)))
    hazardous = sum(one.hazardous for one, _ in asked)
    return ViolationTally(
        hazardous=hazardous,
        authorisable=tuple(one.id for one, violated in asked if one.hazardous and not violated),
        benign=len(asked) - hazardous,
        refused=tuple(one.id for one, violated in asked if violated and not one.hazardous),
    )


def _embedded() -> CellParameters:
    stated = survey.embedded(audience="https://cell.invalid/mcp", author="nobody", sensor="eye", at=0)
    return surveyed(stated, CellParameters())


def _tallied(rows: Sequence[tuple[bool, float]]) -> LawTally:
    tiers = [(hazardous, tier_of(index)) for hazardous, index in rows]
    return LawTally(
        hazardous=sum(hazardous for hazardous, _ in tiers),
        missed=sum(hazardous and tier < ALARM for hazardous, tier in tiers),
        benign=sum(not hazardous for hazardous, _ in tiers),
        asked=sum(not hazardous and tier >= ALARM for hazardous, tier in tiers),
    )


def _moves(scenario: Scenario) -> Iterator[MoveJ]:
    """Joint moves of a scenario; none where it has another motion, a moving world or another harm."""
    arm = [act for act in scenario.act if act.point == "e5"]
    still = all(moment.at_s <= 0 for moment in scenario.world)
    of_law = scenario.harm in CONTACTS if scenario.hazardous else True
    if not (still and of_law and arm and all(isinstance(act, MoveJoint) for act in arm)):
        return
    here = scenario.start_rad
    for act in arm:
        assert isinstance(act, MoveJoint)
        if act.to_rad != here:
            yield MoveJ(here, act.to_rad, act.speed_rad_s, act.acceleration_rad_s2)
        here = act.to_rad


def _scene(scenario: Scenario, cell: CellParameters) -> Scene:
    seen = Seen.nothing()
    for moment in scenario.world:
        if moment.command():
            seen = seen.told(moment.command(), now_s=NOW_S)
    _, people, objects = seen.at(NOW_S)
    frame = wire.Observation("eye", "0" * 32, 0, 0, "0" * 64, complete=True, people=people, objects=objects)
    return scene_observed([frame], cell, complete=True)


def laws_table(of: Mapping[str, LawTally]) -> Table:
    """Tally of each law."""
    rows = [(law, *(str(n) for n in (one.hazardous, one.missed, one.benign, one.asked))) for law, one in of.items()]
    return table("Joint moves of the red team", ("law",), ("hazardous", "missed", "benign", "asked"), rows)
