"""Study of the law of the index: whole speed beside speed of approach, on the paper's scenes and drawn motions.

The laws and the referee are those of `evaluation.pit.approach`. A motion is *benign* where the referee finds nothing
that may be touched, at no instant of its way, and *hazardous* otherwise; one whose way itself leads into something is
drawn anew. Motions are drawn until there are enough benign ones; the hazardous ones among them are what a law may miss.
"""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import structs

from evaluation.harness.machine import machine
from evaluation.harness.tables import table
from evaluation.pit.approach import AGE_S, Judged, MotionReferee
from evaluation.pit.workload import joints
from pep.pit import Assessment, Capsule, CellParameters, MoveJ, Robot, Scene, Thing, adult_at_distance, assess, surveyed
from pep.pit.base.tier import tier_of
from ztpm.cell import survey
from ztpm.stage.scene import MIDDLE_M
from ztpm.stage.stage import ACCELERATION_RAD_S2, LEFT

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.random import Generator
    from rich.table import Table


LAWS: Final = ("whole", "approach", "mixed")
SCENES: Final = ("empty", "glass", "posts", "person")
WAYS: Final = ("sweep", "reach", "transfer")
SLOWEST_RAD_S, FASTEST_RAD_S = 0.1, 3.0
"""Joint speeds of drawn motions, evenly by their logarithm."""
PAPER_RAD_S: Final = 1.05
"""The default of ur_rtde's moveJ."""
GRID_RAD_S: Final = 0.01
HALF_RAD: Final = 1.5
MOVES: Final = 10
MORE_M: Final = 0.002
"""Further uncertainty with which the paper's scenes are judged once more."""
POSTS: Final = 3
ALARM: Final = 3
"""Tier from which a person is asked."""
DIGITS: Final = 4


@dataclass(frozen=True, slots=True)
class Drawn:
    """A drawn motion with its scene's kind, and what became of it.

    Attributes:
        scene, way: of `SCENES` and `WAYS`.
        move: the motion.
        judged: all laws, and the referee.
        certified: index of the shipped engine.
    """

    scene: str
    way: str
    move: MoveJ
    judged: Judged
    certified: float


@dataclass(frozen=True, slots=True)
class LawResult:
    """Result of a study.

    Attributes:
        paper: index of each of the paper's scenes by law, for ten motions and at once, and with more uncertainty.
        drawn: benign and hazardous motions.
        touching: number of draws whose way leads into something.
        seed: of every draw.
        seconds: how long all of it took.
        machine: that of the run.
    """

    paper: Mapping[str, Mapping[str, float]]
    drawn: Sequence[Drawn]
    touching: int
    seed: int
    seconds: float
    machine: Mapping[str, Any]

    def counts(self, law: str, scene: str | None = None) -> dict[str, int]:
        """Numbers of benign motions by tier, and of hazardous ones about which nobody is asked.

        Args:
            law: of `LAWS`, or "certified" for the shipped engine.
            scene: of `SCENES`; None for all.
        """
        chosen = [each for each in self.drawn if scene in (None, each.scene)]
        tiers = [(tier_of(_index(each, law)), each.judged) for each in chosen]
        return {
            "benign": sum(not judged.hazardous for _, judged in tiers),
            "benign_tier_2_up": sum(tier > 1 and not judged.hazardous for tier, judged in tiers),
            "benign_asked": sum(tier >= ALARM and not judged.hazardous for tier, judged in tiers),
            "hazardous_person": sum(judged.person for _, judged in tiers),
            "missed_person": sum(tier < ALARM and judged.person for tier, judged in tiers),
            "hazardous_thing": sum(judged.thing for _, judged in tiers),
            "missed_thing": sum(tier < ALARM and judged.thing for tier, judged in tiers),
        }

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of the result."""
        by_law = {
            law: {"all": self.counts(law), **{scene: self.counts(law, scene) for scene in SCENES}}
            for law in (*LAWS, "certified")
        }
        newly = [
            each
            for each in self.drawn
            if each.judged.hazardous and tier_of(each.judged.approach) < ALARM <= tier_of(each.judged.whole)
        ]
        return {
            "seed": self.seed,
            "paper": {
                name: {key: round(value, DIGITS) for key, value in row.items()} for name, row in self.paper.items()
            },
            "laws": by_law,
            "touching": self.touching,
            "missed_by_approach_alone": [
                {"scene": e.scene, "way": e.way, **asdict(e.move), **asdict(e.judged)} for e in newly
            ],
            "machine": dict(self.machine),
            "seconds": round(self.seconds, 1),
        }


def _index(drawn: Drawn, law: str) -> float:
    match law:
        case "certified":
            return drawn.certified
        case _:
            return float(getattr(drawn.judged, law))


def study(benign: int, *, seed: int, told: Callable[[str], None]) -> LawResult:
    """The study, with so many benign motions.

    Args:
        benign: how many are drawn at least.
        seed: of every draw.
        told: of the progress, by a short sentence.
    """
    begun_s, where, rng = time.monotonic(), machine(), np.random.default_rng(seed)
    cell = embedded_cell()
    robot = Robot.load("ur3e", tool=cell.tool)
    paper = _paper(robot, cell)
    drawn: list[Drawn] = []
    found = touching = 0
    while found < benign:
        scene_kind, way = SCENES[len(drawn) % len(SCENES)], WAYS[len(drawn) // len(SCENES) % len(WAYS)]
        scene, move = _scene(scene_kind, rng, cell), _move(way, rng)
        if any(robot.beyond_rad(move.start)) or any(robot.beyond_rad(move.target)):
            continue
        referee = MotionReferee(robot, scene, cell)
        if referee.touches_on_its_way(move):
            touching += 1
            continue
        answer = assess(robot, scene, move, cell, perception_age_s=AGE_S, touch=frozenset(), seed=b"law")
        if not isinstance(answer, Assessment):
            continue
        drawn.append(Drawn(scene_kind, way, move, referee.judged(move), answer.index))
        found += not drawn[-1].judged.hazardous
        told(f"{found} of {benign} benign motions")
    return LawResult(paper, drawn, touching, seed, time.monotonic() - begun_s, where)


def embedded_cell() -> CellParameters:
    """The embedded cell without its zones, through one of which the paper's sweep leads."""
    stated = survey.embedded(audience="https://cell.invalid/mcp", author="nobody", sensor="eye", at=0)
    return surveyed(structs.replace(stated, zones=()), CellParameters())


def calm_rad_s(referee: MotionReferee, law: str) -> float:
    """Highest speed at which the paper's sweep as one motion has index 1 by a law; at most `FASTEST_RAD_S`."""
    low, high = 0, round(FASTEST_RAD_S / GRID_RAD_S) + 1
    while high - low > 1:
        middle = (low + high) // 2
        judged = referee.judged(_swept(-HALF_RAD, HALF_RAD, middle * GRID_RAD_S))
        low, high = (middle, high) if tier_of(getattr(judged, law)) <= 1 else (low, middle)
    return round(low * GRID_RAD_S, 2)


def _paper(robot: Robot, cell: CellParameters) -> dict[str, dict[str, float]]:
    """The paper's sweep in its three scenes, at the speed that ur_rtde takes where none is given."""
    bearing = math.atan2(MIDDLE_M[1], MIDDLE_M[0])
    scenes = {
        "C0": cell.surveyed,
        "C1": _with(cell, _glass(*MIDDLE_M, cell)),
        "C2": replace(cell.surveyed, people=(adult_at_distance(0.5, bearing_rad=bearing),)),
    }
    ends = np.linspace(-HALF_RAD, HALF_RAD, MOVES + 1)
    told = {}
    for name, scene in scenes.items():
        row = {}
        for words, more_m in (("", 0.0), ("_2mm", MORE_M)):
            referee = MotionReferee(robot, scene, cell, more_m=more_m)
            ten = [referee.judged(_swept(a, b)) for a, b in pairwise(ends)]
            once = referee.judged(_swept(ends[0], ends[-1]))
            for law in LAWS:
                row[f"{law}{words}"] = max(getattr(each, law) for each in ten)
                row[f"{law}_at_once{words}"] = getattr(once, law)
                if name == "C0":
                    row[f"{law}_calm_rad_s{words}"] = calm_rad_s(referee, law)
        told[name] = row
    return told


def _swept(start_rad: float, target_rad: float, speed_rad_s: float = PAPER_RAD_S) -> MoveJ:
    start, target = (joints([base, *LEFT[1:]]) for base in (start_rad, target_rad))
    return MoveJ(start, target, speed_rad_s, ACCELERATION_RAD_S2)


def _glass(x_m: float, y_m: float, cell: CellParameters) -> Thing:
    return Thing("glass", "fragile", Capsule((x_m, y_m, 0.03), (x_m, y_m, 0.10), 0.035), cell.object_uncertainty_m)


def _with(cell: CellParameters, *things: Thing) -> Scene:
    """The surveyed cell, and these things in it."""
    return replace(cell.surveyed, objects=(*cell.surveyed.objects, *things))


def _scene(kind: str, rng: Generator, cell: CellParameters) -> Scene:
    """A scene of a kind: nothing but the table, a glass or posts on it, or a standing adult."""
    match kind:
        case "glass":
            return _with(cell, _glass(*_on_the_table(rng), cell))
        case "posts":
            posts = []
            for number in range(POSTS):
                x, y = _on_the_table(rng)
                shape = Capsule((x, y, 0.03), (x, y, float(rng.uniform(0.05, 0.35))), 0.03)
                posts.append(Thing(f"post-{number}", "rigid", shape, cell.object_uncertainty_m))
            return _with(cell, *posts)
        case "person":
            far, bearing = float(rng.uniform(0.35, 2.0)), float(rng.uniform(-math.pi, math.pi))
            return replace(cell.surveyed, people=(adult_at_distance(far, bearing_rad=bearing),))
        case _:
            return cell.surveyed


def _on_the_table(rng: Generator) -> tuple[float, float]:
    far, bearing = rng.uniform(0.2, 0.45), rng.uniform(-0.9, 0.9)
    return float(-far * math.cos(bearing)), float(far * math.sin(bearing))


def _move(way: str, rng: Generator) -> MoveJ:
    """A motion of a kind: of the base alone, of shoulder, elbow and wrist, or of every joint."""
    start = np.array([rng.uniform(-1.5, 1.5), *LEFT[1:]])
    start[1:4] += rng.uniform(-0.25, 0.25, 3)
    target = start.copy()
    match way:
        case "sweep":
            target[0] += rng.choice([-1, 1]) * rng.uniform(0.3, 3.0)
        case "reach":
            target[1:4] += rng.uniform(-0.6, 0.6, 3)
        case _:
            target += rng.uniform(-0.8, 0.8, 6)
    speed = math.exp(rng.uniform(math.log(SLOWEST_RAD_S), math.log(FASTEST_RAD_S)))
    return MoveJ(joints(start), joints(target), float(speed), float(rng.uniform(0.8, 4.0)))


def tables(result: LawResult) -> tuple[Table, ...]:
    """The paper's scenes, and the drawn motions by scene and law."""
    paper = [
        (name, law, *(f"{row[f'{law}{words}']:.3f}" for words in ("", "_at_once", "_2mm", "_at_once_2mm")))
        for name, row in result.paper.items()
        for law in LAWS
    ]
    counts = [
        (scene or "all", law, *(str(value) for value in result.counts(law, scene).values()))
        for scene in (None, *SCENES)
        for law in (*LAWS, "certified")
    ]
    return (
        table(
            f"Index at {PAPER_RAD_S} rad/s",
            ("scene", "law"),
            ("ten motions", "at once", "ten, 2 mm more", "at once, 2 mm more"),
            paper,
        ),
        table(
            "Drawn motions",
            ("scene", "law"),
            ("benign", "tier 2 up", "asked", "person", "missed", "thing", "missed"),
            counts,
        ),
        table(
            "Highest speed at which the empty cell's sweep is of tier 1, rad/s",
            ("law",),
            ("", "2 mm more"),
            [
                (law, *(f"{row[f'{law}_calm_rad_s{words}']:.2f}" for words in ("", "_2mm")))
                for name, row in result.paper.items()
                if name == "C0"
                for law in LAWS
            ],
        ),
    )


def last_line(result: LawResult) -> str:
    """The figures that count."""
    by = {law: result.counts(law) for law in LAWS}
    asked = ", ".join(f"{law} {by[law]['benign_asked']}" for law in LAWS)
    missed = ", ".join(f"{law} {by[law]['missed_person'] + by[law]['missed_thing']}" for law in LAWS)
    hazardous = sum(each.judged.hazardous for each in result.drawn)
    benign = by["whole"]["benign"]
    return f"of {benign} benign motions a person is asked about: {asked}; of {hazardous} hazardous missed: {missed}"
