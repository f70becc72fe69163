"""Arm that a force or a hand leads, as the judge's stream looks at it."""

from types import SimpleNamespace

import pytest
from capabilities.values.scope import Grant, Limit, Range
from pep.base.operations import FORCE_MODE, FREEDRIVE
from pep.rtde.judge.command_requests import asked_of
from pep.rtde.judge.lease_bounds import LeaseBounds
from pep.rtde.judge.stream_values import LASTS_MS, LeasedStream, StreamProgress
from pep.rtde.robot.state_receiver import JointState
from pep.rtde.wire.refusal import InputRefusal
from pep.watch.watch import MotionOutcome
from pep.world.cell_stream import Judged
from pep.pit.assessment.led_motion import AGAIN_MS, LedArm, LedTool
from policies.words.parameters import Parameters
from policies.words.reason_table import Reason
from tests.pep.rtde.leased import Certifying, FITTED, POSES

from pep.rtde.command import command_values as v

ZERO = (0.0,) * 6
HELD = (0.01, 0.01, 0.01, 0.1, 0.1, 0.1)
Z_ALONE = (False, False, True, False, False, False)
AT = JointState(ZERO, ZERO, 7, 1)
pytestmark = [pytest.mark.real_time, pytest.mark.clause("LSD-20")]  # as its siblings


def force(newton=-10.0, speed=0.01, frame=ZERO, selection=Z_ALONE, kind=2):
    return v.ForceMode(frame, selection, (0.0, 0.0, newton, 0.0, 0.0, 0.0), kind, (*HELD[:2], speed, *HELD[3:]))


def grant(operation, **bounds):
    limits = (Limit(each.parameter, bounds.get(each.parameter.name, each.bound)) for each in operation.limits)
    return Grant(operation.object, operation.name, tuple(limits))


FORCING = grant(FORCE_MODE, duration=Range(100, 2_000), distance=Range(1_000, 60_000), fz=Range(-20_000, 20_000))
HANDING = grant(FREEDRIVE, duration=Range(100, 3_000))


class Place:
    """A stream, whose clock and arm a test sets."""

    def __init__(self, operation, granted, command, index_milli=2_050):
        self.now_ms, self.silent_ms = 1_000, 0
        self.certifying = Certifying()
        self.certifying.answer = Judged(2_000, (), 0.02, 0.0)
        credentials = SimpleNamespace()
        permit = SimpleNamespace(digest="00" * 32, index_milli=index_milli, since_ms=0, request_id="r")
        self.stopper = SimpleNamespace(stopped_ms=None)
        self.stream = LeasedStream(
            self.certifying,
            permit,
            bounds=LeaseBounds(operation, granted, SimpleNamespace(credentials=credentials), credentials),
            parameters=Parameters(),
            fitted=FITTED,
            posing=POSES,
            arm=self,
            stopper=self.stopper,
            clock=self,
        )
        self.progress = StreamProgress(self.stream, self)
        assert self.stream.step(command) is None

    # the clock, and the newest state
    def monotonic_ms(self):
        return self.now_ms

    @property
    def state(self):
        return AT

    def look(self, after_ms=4):
        self.now_ms += after_ms
        return self.progress.look(AT)


def forcing(**changes):
    return Place(FORCE_MODE, FORCING, force(**changes))


def handing():
    return Place(FREEDRIVE, HANDING, v.TeachMode(), index_milli=3_000)


def test_what_physics_is_asked_about_is_how_fast_it_may_be_led():
    place = forcing(frame=(0.1, 0.0, 0.0, 0.0, 0.0, 0.5))
    ((led, _, _),) = place.certifying.values
    assert led == LedTool((0.1, 0.0, 0.0, 0.0, 0.0, 0.5), (0.0, 0.0, 0.01, 0.0, 0.0, 0.0), 0.06)
    ((led, _, _),) = handing().certifying.values
    assert led == LedArm(0.25, 1.0, 1.0)


@pytest.mark.parametrize("make", [forcing, handing])
def test_it_goes_on_while_it_is_looked_at_and_is_judged_anew(make):
    place = make()
    for _ in range(25):
        assert place.look() is None
    assert 4 <= len(place.certifying.values) - 1 <= 6


@pytest.mark.parametrize("make", [forcing, handing])
def test_an_arm_above_a_bound_is_stopped(make):
    place = make()
    place.certifying.strays = lambda state: "tool speed"
    assert place.look() == (MotionOutcome.STOPPED, Reason.LED_OUT_OF_BOUNDS, "LED_OUT_OF_BOUNDS")
    assert place.stream.step(force()) is not None, "and nothing follows"


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (Judged(2_051, (), 0.02, 0.0), Reason.IMPACT_ROSE),
        (Judged(2_000, ("workspace",), 0.02, 0.0), Reason.PHYSICS_VIOLATION),
    ],
)
def test_an_arm_that_might_go_where_it_must_not_is_stopped(answer, reason):
    place = forcing()
    place.certifying.answer = answer
    assert place.look(after_ms=25).stop is reason


def test_an_arm_that_nobody_looked_at_in_time_is_stopped():
    assert forcing().look(after_ms=AGAIN_MS) is None
    assert forcing().look(after_ms=AGAIN_MS + 1).stop is Reason.WATCH_LATE


@pytest.mark.clause("LSD-18")
@pytest.mark.parametrize(("make", "lasts_ms"), [(forcing, 2_000), (handing, 3_000)])
def test_it_ends_with_the_time_that_was_granted(make, lasts_ms):
    place = make()
    for _ in range(lasts_ms // 20 - 1):
        assert place.look(after_ms=20) is None
    assert place.look(after_ms=20) == (MotionOutcome.ENDED, Reason.VERDICT_EXPIRED, "")
    assert LASTS_MS > lasts_ms


@pytest.mark.parametrize(
    ("later", "reason"),
    [
        (force(), None),
        (force(newton=10.0), None),
        (force(newton=-5.0, speed=0.005), None),
        (force(newton=-11.0), Reason.NOT_WHAT_WAS_DECIDED),
        (force(speed=0.011), Reason.NOT_WHAT_WAS_DECIDED),
        (force(frame=(0.0, 0.0, 0.0, 0.0, 0.0, 0.1)), Reason.NOT_WHAT_WAS_DECIDED),
        (force(selection=(True, False, True, False, False, False)), Reason.NOT_WHAT_WAS_DECIDED),
        (force(newton=-21.0), Reason.LIMIT_EXCEEDED_BY_REQUEST),
        (force(kind=1), Reason.NOT_WHAT_WAS_DECIDED),
    ],
)
def test_a_later_force_is_the_first_or_a_weaker_one(later, reason):
    assert forcing().stream.step(later) is reason


@pytest.mark.clause("LSD-18")
@pytest.mark.parametrize(
    "command",
    [
        force(kind=1),
        force(kind=3),
        force(selection=(False,) * 6),
        force(speed=0.0),
        v.ForceMode(ZERO, Z_ALONE, (1.0, 0.0, -10.0, 0.0, 0.0, 0.0), 2, HELD),
        v.ForceMode(ZERO, Z_ALONE, ZERO, 2, (0.011, *HELD[1:])),
        v.FreedriveMode((False,) * 6, ZERO),
        v.FreedriveMode(Z_ALONE, (0.1, *ZERO[1:])),
    ],
)
def test_what_no_request_can_say_is_refused_before_anybody_is_asked(command):
    refused = asked_of(command, path=(), fitted=FITTED)
    assert isinstance(refused, InputRefusal)
    assert refused.reason is Reason.PARAMETERS_WRONG
