"""An assessment's whole proof as one canonical text, which a checker that trusts nothing of us recomputes.

The form is docs/physics.md, "The certificate" (PHY-30 to PHY-33): the question with everything that the answer depends
on, the answer, and the rows. The rows are the coarsest that prove the answer: a pair that stays far off needs one for
the whole path, so the text is small and quickly checked.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, assert_never

import numpy as np
import rfc8785

from pep.pit.certify import DEPTH, FIRST_CUT_MOST, ROWS_MOST, VIOLATION_RESOLUTION_M, cut
from pep.pit.departure import joint_limits
from pep.pit.errors import ProofError
from pep.pit.motion import MoveJ, SpeedJ, profile_of
from pep.pit.pairs import VIOLABLE, Kind, pairs_of
from pep.pit.parameters import FINER, Demands
from pep.pit.path import GRID, Path
from pep.pit.question import as_run, view_around
from pep.pit.separation import stopping
from pep.pit.tier import TIE
from pep.pit.touching import gentle_rows

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from pep.pit.assessment import Assessment
    from pep.pit.cell import CellParameters
    from pep.pit.motion import Floats, Motion, Profile
    from pep.pit.pairs import Pairs
    from pep.pit.path import Leaves
    from pep.pit.robot import Robot
    from pep.pit.scene import Scene
    from pep.pit.separation import Stopping
    from pep.pit.view import View

VERSION: Final = "ztpm-pit-proof/1"
NO_FORM: Final = "only straight joint motions have a certificate that can be written down"
DIGITS: Final = "0123456789abcdefghijklmn"  # PHY-32: of an interval's depth
DEEPEST: Final = DEPTH + FIRST_CUT_MOST.bit_length() - 1  # halvings of the whole path that the search can have made
CELL_NUMBERS: Final = (
    "stop_deceleration_rad_s2",
    "stop_delay_s",
    "watch_age_limit_s",
    "reaction_s",
    "person_speed_m_s",
    "intrusion_tracked_m",
    "intrusion_untracked_m",
    "person_uncertainty_m",
    "warn_band_m",
    "penetration_band_m",
    "harm_ratio_body",
    "harm_ratio_head",
    "contact_area_m2",
    "robot_uncertainty_m",
    "fragile_band_m",
    "rigid_band_m",
    "self_overlap_m",
    "contact_speed_m_s",
    "contact_near_m",
    "contact_depth_m",
    "tcp_speed_limit_m_s",
    "elbow_speed_limit_m_s",
    "momentum_limit_kg_m_s",
    "perception_age_limit_s",
    "unknown_floor",
    "retreat_joint_speed_rad_s",
    "retreat_speed_m_s",
    "retreat_tolerance_m",
)
"""The cell's numbers on which a path's index depends; what stands in the cell is in the scene."""


def document(
    answer: Assessment,
    *,
    robot: Robot,
    scene: Scene | None,
    motion: Motion,
    cell: CellParameters,
    perception_age_s: float | None,
    touch: frozenset[str],
) -> bytes:
    """The proof document of an answer: canonical JSON (RFC 8785) that `pep.pit.checker.verify` verifies.

    Nothing of it is kept or computed before it is asked for: this costs about as much as the assessment did.

    Args:
        answer: what `assess` said.
        robot: the others are what `assess` was asked, unchanged.
        scene: likewise.
        motion: likewise.
        cell: likewise.
        perception_age_s: likewise.
        touch: likewise.

    Raises:
        ProofError: a motion that is no straight joint motion; an answer to another question; a row that cannot be
            proven to the answer's index.
        PitError: a question that no answer could have been given to.
    """
    if not isinstance(motion, MoveJ | SpeedJ):
        raise ProofError("PARAMETERS_WRONG", NO_FORM)
    view = view_around(robot, scene, perception_age_s, motion.start, cell)
    same = (answer.model_digest, answer.scene_digest, answer.start, answer.perception_age_s, answer.perception)
    if same != (robot.model_digest, view.scene.digest, motion.start, view.age_s, view.perception):
        raise ProofError("PARAMETERS_WRONG", "the answer to another question")
    question = _question(robot, view, motion, cell, touch)
    run = as_run(motion, cell)
    profile = profile_of(run)
    limits = joint_limits(robot, np.array(run.start), np.array(run.target))
    proof, torque = _NOTHING, 0.0
    if profile is not None and not limits.broken:
        path = Path(robot, run)
        demands = Demands(path, cell)
        torque = next(each.ratio for each in demands.ratios(profile) if each.name == "torque")
        proof = _Rows(path, profile, view, cell, touch=touch).proof(answer)
    claim = {
        "index": _hex(answer.index),
        "tier": int(answer.tier),
        "violations": sorted(str(each) for each in answer.violations),
        "torque": _hex(torque),
        "model": answer.model_digest,
        "scene": answer.scene_digest,
    }
    content: dict[str, Any] = {"v": VERSION, "question": question, "answer": claim, "proof": proof}
    return rfc8785.dumps(content | {"digest": hashlib.sha256(rfc8785.dumps(content)).hexdigest()})


def question_digest(
    *,
    robot: Robot,
    scene: Scene | None,
    motion: Motion,
    cell: CellParameters,
    perception_age_s: float | None,
    touch: frozenset[str],
) -> str:
    """SHA-256 (hex) of the question in its canonical form: `Verified.question` of a proof about it.

    Raises:
        ProofError: a motion that is no straight joint motion.
        PitError: a scene that must not be reasoned about.
    """
    if not isinstance(motion, MoveJ | SpeedJ):
        raise ProofError("PARAMETERS_WRONG", NO_FORM)
    view = view_around(robot, scene, perception_age_s, motion.start, cell)
    return hashlib.sha256(rfc8785.dumps(_question(robot, view, motion, cell, touch))).hexdigest()


_NOTHING: Final[dict[str, Any]] = {"cover": [], "cut": 1, "retreating": [], "meant": [], "met": []}


def _hex(number: float) -> str:
    """The exact spelling of a number."""
    return float(number).hex()


def _six(angles: Iterable[float]) -> list[str]:
    return [_hex(angle) for angle in angles]


def _question(
    robot: Robot, view: View, motion: MoveJ | SpeedJ, cell: CellParameters, touch: frozenset[str]
) -> dict[str, Any]:
    numbers: dict[str, Any] = {name: _hex(getattr(cell, name)) for name in CELL_NUMBERS}
    numbers["payload_kg"] = None if cell.payload_kg is None else _hex(cell.payload_kg)
    numbers["contacts"] = sorted([contact.object, contact.by] for contact in cell.contacts)
    return {
        "model": robot.content,
        "scene": view.scene.content,
        "cell": numbers,
        "age_s": None if view.age_s is None else _hex(view.age_s),
        "touch": sorted(touch),
        "motion": _motion(motion),
    }


def _motion(motion: MoveJ | SpeedJ) -> dict[str, Any]:
    match motion:
        case MoveJ(start, target, speed, acceleration):
            return {
                "form": "move_j",
                "start": _six(start),
                "target": _six(target),
                "speed_rad_s": _hex(speed),
                "acceleration_rad_s2": _hex(acceleration),
            }
        case SpeedJ(start, speeds, acceleration, duration):
            return {
                "form": "speed_j",
                "start": _six(start),
                "qd_rad_s": _six(speeds),
                "acceleration_rad_s2": _hex(acceleration),
                "duration_s": _hex(duration),
            }
        case _:
            assert_never(motion)


@dataclass(frozen=True, slots=True)
class _Order:
    """The pairs in the order of the certificate (PHY-31): which of ours stands at each place, and the other way."""

    ours: list[int]
    place: dict[int, int]


def _order(robot: Robot, pairs: Pairs) -> _Order:
    """Self pairs by the names of both capsules; all others as they are."""
    own = np.flatnonzero(pairs.kind == pairs.code_of(Kind.SELF)).tolist()
    names = [(inner.name, robot.bodies[body].name) for body, inner in robot.self_pairs]
    ours = list(range(len(pairs)))
    if own:
        ours[own[0] : own[-1] + 1] = [own[k] for k in sorted(range(len(own)), key=names.__getitem__)]
    return _Order(ours, {pair: at for at, pair in enumerate(ours)})


class _Rows:
    """The coarsest rows that prove an answer: from the whole path on, what does not suffice is halved."""

    def __init__(
        self, path: Path, profile: Profile, view: View, cell: CellParameters, *, touch: frozenset[str]
    ) -> None:
        """The pairs as the assessment had them."""
        robot = path.robot
        self.path, self.profile, self.cell, self.robot = path, profile, cell, robot
        self.stop: Stopping = stopping(cell, perception_age_s=view.stopping_age_s, joint_speed_rad_s=profile.peak_rad_s)
        bare = pairs_of(robot, view.scene, cell, grown_m=view.grown_m, touch=touch)
        gentle = gentle_rows(path, bare, profile, cell, check_time=lambda: None)
        self.meant = np.zeros(len(bare), dtype=bool)
        self.meant[gentle] = True
        self.pairs = bare.meant(gentle)

    def proof(self, answer: Assessment) -> dict[str, Any]:
        """The `proof` member of the document."""
        asked = np.zeros(len(self.pairs), dtype=bool)
        asked[answer.certificate.pair] = True
        order = _order(self.robot, self.pairs)
        covers = [""] * len(self.pairs)
        for pair, depths in self._covers(np.flatnonzero(asked), answer).items():
            covers[order.place[pair]] = depths
        low, _ = cut(self.path)
        return {
            "cover": covers,
            "cut": FINER * len(low),
            "retreating": sorted(order.place[pair] for pair in np.flatnonzero(~asked).tolist()),
            "meant": sorted(order.place[pair] for pair in np.flatnonzero(self.meant).tolist()),
            "met": self._met(answer, order),
        }

    def _covers(self, rows: NDArray[np.intp], answer: Assessment) -> dict[int, str]:
        """Per pair the depths of its intervals, one digit each, from the path's start to its end."""
        found: dict[int, list[tuple[int, str]]] = {pair: [] for pair in rows.tolist()}
        zero = np.zeros(len(rows), dtype=np.int64)
        leaves = self.path.examine(self.pairs, zero, zero + GRID, rows)
        examined = 0
        for depth in range(DEEPEST + 1):
            examined += len(leaves)
            if examined > ROWS_MOST or self._attained(leaves) > answer.index + TIE:
                break
            enough = self._suffices(leaves, answer)
            done = leaves.take(enough)
            for low, pair in zip(done.low.tolist(), done.pair.tolist(), strict=True):
                found[pair].append((low, DIGITS[depth]))
            if enough.all():
                return {pair: "".join(digit for _, digit in sorted(each)) for pair, each in found.items()}
            leaves = self.path.halve(self.pairs, leaves.take(~enough))
        raise ProofError("PHYSICS_FAULT", "a row that does not prove the answer's index")

    def _attained(self, leaves: Leaves) -> float:
        """The highest index that the middles of these rows attain: no claim below it can be proven."""
        speed: Floats = leaves.rush_mid * self.profile.rate(leaves.mid / GRID)
        return float(self.pairs.index(leaves.pair, leaves.clear_mid_m, speed, self.stop).max(initial=0.0))

    def _suffices(self, leaves: Leaves, answer: Assessment) -> NDArray[np.bool_]:
        """Rows that prove the index, exclude a violation that was not met, and prove a meant contact gentle."""
        pair = leaves.pair
        rate = self.profile.highest_rate(leaves.low / GRID, leaves.high / GRID)
        speed: Floats = leaves.rush * rate
        enough = self.pairs.index(pair, leaves.clear_m, speed, self.stop) <= answer.index + TIE
        excluded = [self.pairs.code_of(kind) for kind in VIOLABLE if str(kind) not in answer.violations]
        open_kind = np.isin(self.pairs.kind[pair], excluded)
        enough &= ~open_kind | (leaves.clear_m >= self.pairs.violated_below[pair] - VIOLATION_RESOLUTION_M)
        cell = self.cell
        slow = (speed <= cell.contact_speed_m_s) & (leaves.clear_m >= -cell.contact_depth_m)
        enough &= ~self.meant[pair] | slow | (leaves.clear_m >= cell.contact_near_m)
        return np.asarray(enough)

    def _met(self, answer: Assessment, order: _Order) -> list[list[int]]:
        """Per violated kind, in the order of their names, a pair and a configuration (in 1 / GRID) where it is met.

        Whatever the search met lies at a middle or an end of a leaf, or at an end of the path.
        """
        rows = answer.certificate
        met: list[list[int]] = []
        for kind in sorted(k for k in VIOLABLE if str(k) in answer.violations):
            mine = np.flatnonzero(self.pairs.kind[rows.pair] == self.pairs.code_of(kind))
            leaves = self.path.examine(self.pairs, rows.low[mine], rows.high[mine], rows.pair[mine])
            depth = leaves.clear_mid_m - self.pairs.violated_below[leaves.pair]
            deepest = int(depth.argmin())
            at, pair, found = int(leaves.mid[deepest]), int(leaves.pair[deepest]), float(depth[deepest])
            if found >= 0:
                at, pair, found = self._met_at_an_end(rows.low[mine], rows.high[mine], np.unique(rows.pair[mine]))
            if found >= 0:
                raise ProofError("PHYSICS_FAULT", f"no configuration shows the violation {kind}")
            met.append([order.place[pair], at])
        return met

    def _met_at_an_end(
        self, low: NDArray[np.int64], high: NDArray[np.int64], pairs: NDArray[np.intp]
    ) -> tuple[int, int, float]:
        """The deepest of these pairs at the leaves' ends: (key, pair, depth below its bound in metre)."""
        best = (0, int(pairs[0]), 0.0)
        for key in np.unique(np.concatenate([low, high])).tolist():
            depth = self.path.clearance_at(self.pairs, key, pairs) - self.pairs.violated_below[pairs]
            deepest = int(depth.argmin())
            if depth[deepest] < best[2]:
                best = (key, int(pairs[deepest]), float(depth[deepest]))
        return best
