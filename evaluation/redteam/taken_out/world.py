"""Perception, physics, the watch and the slot of motions, taken out of a gateway."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Final

from capabilities.keys import jws
from capabilities.statements import observation, statement_form
from capabilities.values import strict_json
from capabilities.values.errors import CapabilityError
from capabilities.values.scope import Tier
from pep.base.ports import Assessed, Together
from pep.gate import gate
from pep.gate.observe_only import HIGHEST_MILLI
from pep.perception.sensor_frames import FrameFault, Frames, RejectedFrame, SensorFrame
from pep.rtde.judge.stream_values import LeasedStream
from pep.rtde.motion import motions
from pep.watch.watch import Watch
from pep.world.cell_stream import CellStream, Shown
from pep.world.world import CellPhysics
from policies.decision import combine, pdp
from policies.evidence.evidence import ImpactFault, ImpactReading
from policies.evidence.tiers import FRESH, base_tier
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capabilities.statements.observation import Observation
    from capabilities.values.caps import Caps
    from policies.evidence.evidence import Evidence
    from policies.evidence.model import Request

    Off = frozenset[str]


UNSEEN_MS: Final = 60_000
"""Longest time without a look at a motion that nothing watches."""


def unsigned(kind: str, text: str, keys: object, caps: Caps) -> dict[str, object]:
    """Claims of a statement, with any signature."""
    return strict_json.parse_object(jws.split(text, most_bytes=caps.statement_bytes).payload_raw)


UNSEALED = SimpleNamespace(**{**vars(statement_form), "open": unsigned})
"""The form of signed statements, with any signature taken."""


def sensor_provenance(off: Off) -> None:
    """Any frame of a sensor's name counts as that sensor's newest, with any signature and of any time."""

    def judge(self: Frames, text: bytes, arrived_ms: int) -> SensorFrame | RejectedFrame:
        try:
            seen: Observation = observation.open(text.decode("ascii"), (), self._caps)
        except (CapabilityError, UnicodeDecodeError):
            return RejectedFrame(FrameFault.MALFORMED, "")
        sensor = self._watching().get(seen.sensor)
        if sensor is None:
            return RejectedFrame(FrameFault.UNKNOWN_SENSOR, seen.sensor)
        return SensorFrame(seen, arrived_ms, sensor.transit_ms, sensor)

    honest = Frames.admit

    def admit(self: Frames, text: bytes) -> SensorFrame | RejectedFrame:
        verdict = honest(self, text)
        self._rejected.clear()
        return verdict

    observation.statement_form = UNSEALED  # type: ignore[assignment, attr-defined]
    Frames._judge = judge  # type: ignore[method-assign]
    Frames.admit = admit  # type: ignore[method-assign]
    Frames.reject = lambda self, fault, *, sensor="": RejectedFrame(fault, sensor)  # type: ignore[method-assign]
    Frames.contradiction = lambda self, frame: None  # type: ignore[method-assign]


def impact_gate(off: Off) -> None:
    """No tier but the registered one, no ceiling and no PITBound; nothing bounds what is sent or watches it."""

    def tier(evidence: Evidence, *, physical: bool) -> Tier | None:
        return base_tier(evidence)

    pdp.runtime_tier = tier  # type: ignore[attr-defined]
    pdp._bounded = lambda policy, bound, case: combine.PERMITS
    gate.authorised_milli = lambda decision, parameters: HIGHEST_MILLI  # type: ignore[attr-defined]
    if "physics" not in off:
        _assessed_anyway()
    unwatched()


def _assessed_anyway() -> None:
    """A motion begins where it was asked for, also where physics has no answer about it."""
    honest = CellPhysics.assess

    def assess(self: CellPhysics, request: Request, *, touch: frozenset[str]) -> Assessed:
        found = honest(self, request, touch=touch)
        if isinstance(found.impact, ImpactFault):
            self.remember(request)
        return found

    CellPhysics.assess = assess  # type: ignore[method-assign]


def unwatched() -> None:
    """The watch sees authority alone, and a stream's values are bounded by its grant alone."""
    Watch._world = lambda self, now, q_rad: None  # type: ignore[method-assign]
    Watch._lateness = lambda self, now, since_ms: None  # type: ignore[method-assign]
    Watch._speed = lambda self, now, speeds: None  # type: ignore[method-assign]
    motions.UNSEEN_MS = UNSEEN_MS  # type: ignore[misc]
    honest = CellStream.see

    def certified(self: LeasedStream, value: object, authorised_milli: int) -> Reason | None:
        return None if self._state() is not None else Reason.EVIDENCE_MISSING

    def see(self: CellStream, q_rad: Sequence[float]) -> Shown | ImpactFault:
        shown = honest(self, q_rad)
        return Shown(None, None) if isinstance(shown, ImpactFault) else shown

    LeasedStream._certified = certified  # type: ignore[method-assign]
    CellStream.see = see  # type: ignore[method-assign]


def computed_physics(off: Off) -> None:
    """Nothing is computed: the world adds to the registered tier only by being unseen, and no watch looks at it."""

    def assess(self: CellPhysics, request: Request, *, touch: frozenset[str]) -> Assessed:
        self.remember(request)
        look = self._frames.look()
        now_ms = self._clock.monotonic_ms()
        reading = look.reading(now_ms=now_ms, limit_ms=self._limit_ms)
        fresh = bool(reading.sensors) and all(one.state == FRESH for one in reading.sensors)
        return Assessed(_nothing(self, fresh=fresh, age_ms=look.age_ms(now_ms)), reading)

    CellPhysics.assess = assess  # type: ignore[method-assign]
    CellPhysics.together = lambda self, request, **rest: Together(0)  # type: ignore[method-assign]
    gate.authorised_milli = lambda decision, parameters: HIGHEST_MILLI  # type: ignore[attr-defined]
    unwatched()


def _nothing(physics: CellPhysics, *, fresh: bool, age_ms: int | None) -> ImpactReading:
    """Impact of an act of which nothing was computed."""
    here = [round(angle * 1e6) for angle in physics._state.read().q_rad]
    return ImpactReading(
        tier=Tier.NO_EFFECT,
        index_milli=0,
        violations=(),
        contributions=(),
        lower_tier_speed=None,
        tcp_speed_um_s=0,
        contact_permille=0,
        start_urad=tuple(here),
        perception=FRESH if fresh else "missing",
        perception_age_ms=age_ms,
        scene_digest="0" * 64,
        model_digest="0" * 64,
        engine="none",
    )


def sequence_coherence(off: Off) -> None:
    """A command need not wait for an unfinished one."""
    gate.takes_slot = lambda call, evidence, slot: slot.reserve(call.request.request_id) or True  # type: ignore[attr-defined]
