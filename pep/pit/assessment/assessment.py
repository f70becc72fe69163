"""Answer of the physics room: an index with its proof, and its causes."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from capabilities.values.units import Unit
from pep.pit.base.errors import UnprovenError
from pep.pit.base.tier import HIGHEST, TIE
from pep.pit.search.certify import Proof, proven
from policies.evidence.evidence import Contribution, ImpactReading

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from capabilities.values.scope import Tier
    from pep.pit.base.motion import Floats, Joints
    from pep.pit.scene.view import View
    from pep.pit.search.certify import Certified

ENGINE: Final = "numpy-1"
MILLI: Final = 1000  # index_milli
MICRO: Final = 1e6  # micrometres
LISTED: Final = 12  # contributions told: more would be noise to a person


def milli(index: float) -> int:
    """Thousandths, rounded up, with the same tie as tiers."""
    return min(math.ceil((index - TIE) * MILLI), int(HIGHEST) * MILLI)


def seen(view: View) -> tuple[Contribution, ...]:
    """Contribution of the view itself to the index."""
    if view.floor == 0:
        return ()
    return (Contribution("perception", milli(view.floor), "", view.perception, 0, 0, 0, view.source),)


def micro(metres: float) -> int:
    """Micrometres; 0 for an infinite distance."""
    return round(metres * MICRO) if math.isfinite(metres) else 0


class Certificate(ABC):
    """Ground of an answer, which each has: rows of a search, legs of a path, or the question itself."""

    @abstractmethod
    def proves(self, index: float) -> bool:
        """True where it shows that no part of the motion, from start to end, has a higher index."""


@dataclass(frozen=True, eq=False)
class Evident(Certificate):
    """The question itself tells its answer, which has no rows.

    Attributes:
        why: the motion leaves the arm where it stands, or goes beyond a joint's limit, or moves no joint at all but the
            gripper or an output.
    """

    why: Literal["still", "joint_limit", "gripper", "output"]

    def proves(self, index: float) -> bool:
        """As `Certificate.proves`; beyond a joint's limit nothing less than the highest index holds."""
        return self.why != "joint_limit" or index >= HIGHEST


@dataclass(frozen=True, eq=False)
class RowsCertificate(Certificate):
    """Rows of a search: a pair, an interval of the path in 1 / GRID, and the index proven there.

    For every pair that is no retreat the intervals tile the whole path, so a checker that recomputes each row confirms
    the index without any search. `pep.pit.proof.proof_document` writes the whole proof down, and `pep.pit.checker`
    checks it.

    Attributes:
        asked: the pairs that the search asked about.
        pair, low, high, index: the columns of the rows.
    """

    asked: NDArray[np.intp]

    pair: NDArray[np.intp]
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    index: Floats

    def proves(self, index: float) -> bool:
        """As `Certificate.proves`: all rows, which tile the path of each pair that was asked about."""
        return proven(self.asked, Proof(self.pair, self.low, self.high, self.index), index)

    @property
    def rows(self) -> tuple[tuple[int, int, int, float], ...]:
        """(pair, low, high, index) in the order of pair and interval."""
        order = np.lexsort((self.low, self.pair))
        columns = (
            self.pair[order].tolist(),
            self.low[order].tolist(),
            self.high[order].tolist(),
            self.index[order].tolist(),
        )
        return tuple(zip(*columns, strict=True))


class SearchCertificate(RowsCertificate):
    """Rows of a search on a straight path, put together once they are asked for."""

    def __init__(self, certified: Certified, asked: NDArray[np.intp]) -> None:
        """Nothing is put together yet."""
        vars(self).update(_certified=certified, asked=asked)

    _certified: Certified

    def proves(self, index: float) -> bool:
        """As `Certificate.proves`: all rows as the search left them, which are not put together for it."""
        return self._certified.proves(self.asked, index)

    @cached_property
    def _proof(self) -> Proof:
        return self._certified.proof

    @cached_property
    def pair(self) -> NDArray[np.intp]:
        """As `RowsCertificate.pair`."""
        return self._proof.pair

    @cached_property
    def low(self) -> NDArray[np.int64]:
        """As `RowsCertificate.low`."""
        return self._proof.low

    @cached_property
    def high(self) -> NDArray[np.int64]:
        """As `RowsCertificate.high`."""
        return self._proof.high

    @cached_property
    def index(self) -> Floats:
        """As `RowsCertificate.index`."""
        return self._proof.index


@dataclass(frozen=True, slots=True, eq=False)
class Assessment:
    """Possible impact of a command.

    Attributes:
        tier: of the index.
        index: proven upper bound, 0 to 4.
        clearance_m: clearance that decides the index, signed; infinite when no pair decides it.
        speed_m_s: proven bound on the surface speed of any part of the robot; of a path with the highest index, on the
            legs up to the one that has it.
        contributions: causes that raise the index, highest first.
        violations: kinds that no authority allows.
        lower_tier_speed: highest leading-axis speed (rad/s) at which the tier is proven to fall, or None.
        tcp_speed_m_s: proven bound on the speed of the tool centre point.
        contact_ratio: proven bound on speed by limit speed of any body region that could be met (PFL).
        start: joint angles from which the question was asked, rad; empty when it has nothing to do with the arm.
        certificate: the proof.
        perception: "fresh", "stale" or "missing".
        perception_age_s: of the view that was used, or None.
    """

    tier: Tier
    index: float
    clearance_m: float
    speed_m_s: float
    contributions: tuple[Contribution, ...]
    violations: tuple[str, ...]
    lower_tier_speed: float | None
    tcp_speed_m_s: float
    contact_ratio: float
    start: Joints | tuple[()]
    certificate: Certificate
    perception: str
    perception_age_s: float | None
    engine: str
    model_digest: str
    scene_digest: str

    def __post_init__(self) -> None:
        """There is no answer without a proof of it.

        Raises:
            UnprovenError: this is none.
        """
        if not self.certificate.proves(self.index):
            raise UnprovenError("the proof does not cover the motion")

    def reading(self) -> ImpactReading:
        """The same as integers, for the decision: index rounded up, speed rounded down."""
        lower = self.lower_tier_speed
        age = self.perception_age_s
        return ImpactReading(
            tier=self.tier,
            index_milli=milli(self.index),
            violations=tuple(str(word) for word in self.violations),
            contributions=self.contributions,
            lower_tier_speed=None if lower is None else math.floor(lower * Unit.MICRORADIAN_PER_SECOND.per_si),
            tcp_speed_um_s=math.ceil(self.tcp_speed_m_s * MICRO),
            contact_permille=math.ceil(self.contact_ratio * MILLI),
            start_urad=tuple(round(angle * Unit.MICRORADIAN.per_si) for angle in self.start),
            perception=self.perception,
            perception_age_ms=None if age is None else math.ceil(age * Unit.MILLISECOND.per_si),
            scene_digest=self.scene_digest,
            model_digest=self.model_digest,
            engine=self.engine,
        )
