"""`PermittedControl`: the interface of ur_rtde, every name of it sorted by hand, and no motion without a permit."""

import threading

import pytest
from pep.base.errors import ActuationRefusedError
from pep.base.operations import MOVE_JOINT, MOVE_LINEAR, MOVE_PATH, SPEED_JOINT, digest_of
from pep.request.permit import Permit
from pep.rtde.motion.control_interface import READING, STOPPING, UNWATCHED_HZ
from pep.rtde.motion.permitted_control import CONFIGURATION, MOTION, PROGRAM_STOPS, PermittedControl
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE, ManualClock

Q = [0.1, -1.2, 1.0, -1.1, -1.57, 0.0]


class Raw:
    """Remembers what reached it."""

    def __init__(self):
        self.calls = []

    def __getattr__(self, name):
        def call(*arguments, **options):
            self.calls.append((name, arguments))
            return True

        return call


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def raw():
    return Raw()


def guarded(raw, clock, *, raise_refusals=True, deceleration=6.0):
    return PermittedControl(
        raw, audience=AUDIENCE, clock=clock, raise_refusals=raise_refusals, stop_deceleration_rad_s2=deceleration
    )


@pytest.fixture
def control(raw, clock):
    return guarded(raw, clock)


def permit(clock, numbers=(*Q, 0.5, 1.4), **changes):
    fields = {
        "request_id": "r",
        "digest": digest_of(MOVE_JOINT, numbers, audience=AUDIENCE),
        "since_ms": clock.mono,
        "deadline_ms": clock.mono + 50,
        "clock": clock,
        "standing": lambda: None,
    }
    return Permit(**{**fields, **changes})


def refused(call, reason, raw):
    with pytest.raises(ActuationRefusedError) as raised:
        call()
    assert raised.value.reason is reason
    assert raw.calls == []


def test_every_name_of_the_interface_is_sorted_once():
    interface = pytest.importorskip("rtde_control").RTDEControlInterface
    names = {name for name in vars(interface) if not name.startswith("_") and callable(getattr(interface, name))}
    names -= {"Flags", "Feature"}
    ours = [*MOTION, *CONFIGURATION, *READING, *STOPPING, "moveJ", "moveL", "speedJ", "disconnect"]
    assert len(ours) == len(set(ours))
    assert set(ours) == names


def test_with_its_permit_exactly_these_numbers_are_sent(control, raw, clock):
    assert control.moveJ(Q, 0.5, 1.4, True, permit=permit(clock)) is True
    assert raw.calls == [("moveJ", (Q, 0.5, 1.4, True))]


def test_without_permit(control, raw):
    refused(lambda: control.moveJ(Q, 0.5, 1.4, True), Reason.NOT_WHAT_WAS_DECIDED, raw)


@pytest.mark.parametrize("index", range(8))
def test_one_unit_off_in_any_number_is_something_else(control, raw, clock, index):
    numbers = [*Q, 0.5, 1.4]
    numbers[index] = round(numbers[index] + 1e-6, 6)
    right = permit(clock)
    refused(lambda: control.moveJ(numbers[:6], *numbers[6:], True, permit=right), Reason.NOT_WHAT_WAS_DECIDED, raw)


def test_less_than_one_unit_off_is_something_else(control, raw, clock):
    wrong = [Q[0] + 1e-9, *Q[1:]]
    refused(lambda: control.moveJ(wrong, 0.5, 1.4, True, permit=permit(clock)), Reason.NOT_WHAT_WAS_DECIDED, raw)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_not_finite(control, raw, clock, value):
    right = permit(clock)
    refused(lambda: control.moveJ([value, *Q[1:]], 0.5, 1.4, True, permit=right), Reason.NOT_WHAT_WAS_DECIDED, raw)


def test_too_late(control, raw, clock):
    right = permit(clock)
    clock.advance(51)
    refused(lambda: control.moveJ(Q, 0.5, 1.4, True, permit=right), Reason.VERDICT_EXPIRED, raw)


def test_a_spoilt_permit_stays_spoilt(control, raw, clock):
    right = permit(clock)
    refused(lambda: control.moveJ([0.0] * 6, 0.5, 1.4, True, permit=right), Reason.NOT_WHAT_WAS_DECIDED, raw)
    refused(lambda: control.moveJ(Q, 0.5, 1.4, True, permit=right), Reason.NOT_WHAT_WAS_DECIDED, raw)


def test_twice(control, raw, clock):
    right = permit(clock)
    control.moveJ(Q, 0.5, 1.4, True, permit=right)
    raw.calls.clear()
    refused(lambda: control.moveJ(Q, 0.5, 1.4, True, permit=right), Reason.NOT_WHAT_WAS_DECIDED, raw)


def test_a_stop_voids_what_was_asked_for_before(control, raw, clock):
    right = permit(clock)
    clock.advance(1)
    control.stopJ()
    raw.calls.clear()
    refused(lambda: control.moveJ(Q, 0.5, 1.4, True, permit=right), Reason.VERDICT_EXPIRED, raw)
    clock.advance(1)
    assert control.moveJ(Q, 0.5, 1.4, True, permit=permit(clock))


def test_a_path_or_a_waiting_move_is_refused(control, raw, clock):
    right = permit(clock)
    refused(lambda: control.moveJ(Q, 0.5, 1.4, permit=right), Reason.PARAMETERS_WRONG, raw)
    refused(
        lambda: control.moveJ([[*Q, 0.5, 1.4, 0.0]], 0.5, 1.4, True, permit=right), Reason.NOT_WHAT_WAS_DECIDED, raw
    )


POSE = [-0.3, -0.13, 0.3, 0.1, 3.1, 0.05]
LINE = (*POSE, 0.1, 0.5)


def line_permit(clock):
    return permit(clock, digest=digest_of(MOVE_LINEAR, LINE, audience=AUDIENCE))


def test_a_line_needs_its_permit_and_is_sent_as_it_was_decided(control, raw, clock):
    refused(lambda: control.moveL(POSE, 0.1, 0.5, True), Reason.NOT_WHAT_WAS_DECIDED, raw)
    refused(lambda: control.moveL(POSE, 0.1, 0.5, permit=line_permit(clock)), Reason.PARAMETERS_WRONG, raw)
    assert control.moveL(POSE, 0.1, 0.5, True, permit=line_permit(clock)) is True
    assert raw.calls == [("moveL", (POSE, 0.1, 0.5, True))]


@pytest.mark.parametrize("index", range(8))
@pytest.mark.parametrize("by", [1e-6, 1e-9, float("nan")])
def test_one_unit_off_in_any_number_of_a_line_is_something_else(control, raw, clock, index, by):
    numbers = [*LINE]
    numbers[index] += by
    refused(
        lambda: control.moveL(numbers[:6], *numbers[6:], True, permit=line_permit(clock)),
        Reason.NOT_WHAT_WAS_DECIDED,
        raw,
    )


def test_the_permit_of_a_line_is_none_of_a_joint_move_with_the_same_numbers(control, raw, clock):
    refused(lambda: control.moveJ(POSE, 0.1, 0.5, True, permit=line_permit(clock)), Reason.NOT_WHAT_WAS_DECIDED, raw)


def test_a_stop_while_a_line_is_handed_over_is_given_again(raw, clock):
    class Late(Raw):
        def moveL(self, *_):
            control.note_stop()
            return True

    late = Late()
    control = guarded(late, clock)
    control.moveL(POSE, 0.1, 0.5, True, permit=line_permit(clock))
    assert late.calls == [("stopJ", (6.0, False))]


def test_a_line_ends_what_was_left_of_a_path(control, raw, clock):
    numbers = (*(q for _ in range(4) for q in Q), 0.5, 1.4)
    way = permit(clock, digest=digest_of(MOVE_PATH, numbers, audience=AUDIENCE))
    control.move_path([Q, Q], 0.5, 1.4, permit=way)
    control.moveL(POSE, 0.1, 0.5, True, permit=line_permit(clock))
    assert not control.next_leg()


@pytest.mark.parametrize("name", [*MOTION, *CONFIGURATION])
def test_everything_else_that_moves_or_configures_is_refused(control, raw, name):
    refused(lambda: getattr(control, name)([0.0] * 6), Reason.NOT_GRANTED, raw)


@pytest.mark.parametrize("name", STOPPING)
def test_every_stop_passes(control, raw, clock, name):
    getattr(control, name)()
    assert raw.calls[0][0] == name
    assert control.stopped_ms == clock.mono


@pytest.mark.parametrize(
    ("asked", "sent"), [((), 6.0), ((0.1,), 6.0), ((float("nan"),), 6.0), ((9.0,), 9.0), ((float("inf"),), 40.0)]
)
def test_a_weak_stop_is_made_as_strong_as_the_cells(control, raw, asked, sent):
    control.stopJ(*asked)
    assert raw.calls == [("stopJ", (sent, False))]


@pytest.mark.parametrize(("name", "rest"), [("stopL", (False,)), ("speedStop", ()), ("servoStop", ())])
@pytest.mark.parametrize(("deceleration", "asked", "sent"), [(6.0, 0.1, 10.0), (12.0, 0.1, 12.0), (6.0, 20.0, 20.0)])
def test_no_other_stop_is_weaker_either(raw, clock, name, rest, deceleration, asked, sent):
    control = guarded(raw, clock, deceleration=deceleration)
    getattr(control, name)(asked)
    getattr(control, name)(a=asked)
    assert raw.calls == [(name, (sent, *rest))] * 2


@pytest.mark.parametrize("deceleration", [0.0, -1.0, 40.1, float("nan")])
def test_a_deceleration_that_no_stop_can_have(raw, clock, deceleration):
    with pytest.raises(ValueError, match="deceleration"):
        guarded(raw, clock, deceleration=deceleration)


def test_a_stop_does_not_wait_for_a_command_that_hangs(raw, clock):
    hanging, enough = threading.Event(), threading.Event()

    class Hangs(Raw):
        def moveJ(self, *_):
            hanging.set()
            enough.wait(10)
            return True

    control = guarded(Hangs(), clock)
    moving = threading.Thread(target=lambda: control.moveJ(Q, 0.5, 1.4, True, permit=permit(clock)))
    moving.start()
    hanging.wait(10)
    control.stopJ()
    assert moving.is_alive()
    enough.set()
    moving.join()


@pytest.mark.parametrize("name", ["somethingNew", "_control_raw", "FLAG_UPLOAD_SCRIPT"])
def test_an_unknown_name_is_refused(control, name):
    with pytest.raises(AttributeError):
        getattr(control, name)


def test_as_ur_rtde_would_a_refusal_returns_false(raw, clock):
    control = guarded(raw, clock, raise_refusals=False)
    assert control.moveJ(Q, 0.5, 1.4, True) is False
    assert control.moveL(Q) is False
    assert control.servoJ(Q) is False
    assert raw.calls == []


def test_a_controller_that_does_not_take_the_command(clock):
    class Deaf(Raw):
        def moveJ(self, *_):
            return False

    deaf = Deaf()
    with pytest.raises(ActuationRefusedError) as raised:
        guarded(deaf, clock).moveJ(Q, 0.5, 1.4, True, permit=permit(clock))
    assert raised.value.reason is Reason.EFFECT_FAILED
    assert deaf.calls == [("stopJ", (6.0, False))]  # it may have been heard all the same


@pytest.mark.parametrize("fails", [False, True])
def test_a_stop_that_overtakes_a_command_is_given_again_behind_it(clock, fails):
    handing, enough = threading.Event(), threading.Event()

    class Slow(Raw):
        def moveJ(self, *_):
            handing.set()
            enough.wait(10)
            self.calls.append(("moveJ", ()))
            if fails:
                raise RuntimeError("connection lost")
            return True

    slow = Slow()
    control = guarded(slow, clock)
    ends = []

    def move():
        try:
            ends.append(control.moveJ(Q, 0.5, 1.4, True, permit=permit(clock)))
        except RuntimeError as error:
            ends.append(str(error))

    moving = threading.Thread(target=move)
    moving.start()
    assert handing.wait(10)
    control.stopJ()
    enough.set()
    moving.join(10)
    assert [name for name, _ in slow.calls] == ["stopJ", "moveJ", "stopJ"]
    assert ends == ["connection lost" if fails else True]


QD = [0.3, -0.2, 0.0, 0.0, 0.0, 0.1]
WATCHED = ("setWatchdog", (1 / 0.3,))
SPEED = ("speedJ", (QD, 1.5, 0.0))


def speed_permit(clock, *, qd=QD, acceleration=1.5, duration=0.5, **changes):
    numbers = (*qd, acceleration, duration)
    return permit(clock, digest=digest_of(SPEED_JOINT, numbers, audience=AUDIENCE), **changes)


def streaming(control, raw, clock):
    assert control.speedJ(QD, 1.5, 0.5, permit=speed_permit(clock)) is True
    assert raw.calls == [WATCHED, SPEED]
    raw.calls.clear()


def test_a_stream_is_watched_by_the_controller_before_it_begins_and_no_more_after_its_end(control, raw, clock):
    streaming(control, raw, clock)
    assert control.hold_speed()
    clock.advance(499)
    assert control.hold_speed()
    assert raw.calls == [SPEED, SPEED]
    clock.advance(1)
    assert not control.hold_speed()
    raw.calls.clear()
    control.end_speed()
    assert raw.calls == [("speedStop", (6.0,)), ("setWatchdog", (UNWATCHED_HZ,))]
    assert not control.hold_speed()


def test_a_stream_without_its_permit(control, raw, clock):
    refused(lambda: control.speedJ(QD, 1.5, 0.5), Reason.NOT_WHAT_WAS_DECIDED, raw)
    spoilt = permit(clock)
    with pytest.raises(ActuationRefusedError) as raised:
        control.speedJ(QD, 1.5, 0.5, permit=spoilt)
    assert raised.value.reason is Reason.NOT_WHAT_WAS_DECIDED
    assert raw.calls == [WATCHED, ("setWatchdog", (UNWATCHED_HZ,))]
    assert not control.hold_speed()


@pytest.mark.parametrize("index", range(8))
def test_one_unit_off_in_any_number_of_a_stream_is_something_else(control, raw, clock, index):
    numbers = [*QD, 1.5, 0.5]
    numbers[index] = round(numbers[index] + (1e-3 if index == 7 else 1e-6), 6)
    with pytest.raises(ActuationRefusedError) as raised:
        control.speedJ(numbers[:6], *numbers[6:], permit=speed_permit(clock))
    assert raised.value.reason is Reason.NOT_WHAT_WAS_DECIDED
    assert "speedJ" not in [name for name, _ in raw.calls]


def test_a_stop_before_the_stream(control, raw, clock):
    right = speed_permit(clock)
    control.stopJ()
    with pytest.raises(ActuationRefusedError) as raised:
        control.speedJ(QD, 1.5, 0.5, permit=right)
    assert raised.value.reason is Reason.VERDICT_EXPIRED
    assert "speedJ" not in [name for name, _ in raw.calls]


@pytest.mark.parametrize("name", STOPPING)
def test_every_stop_ends_a_stream_and_none_meets_its_thread(control, raw, clock, name):
    streaming(control, raw, clock)
    getattr(control, name)()
    ends = name if name in PROGRAM_STOPS else "speedStop"
    assert [n for n, _ in raw.calls] == [ends]
    assert name in PROGRAM_STOPS or raw.calls[0][1][0] >= 6.0
    assert not control.hold_speed()
    raw.calls.clear()
    if name not in PROGRAM_STOPS:
        control.stopJ(9.0)
        assert raw.calls == [("stopJ", (9.0, False))]  # the stream has ended: stops are as they were


@pytest.mark.parametrize(("asked", "sent"), [(0.1, 6.0), (float("nan"), 6.0), (9.0, 9.0), (1e9, 40.0)])
def test_a_stop_of_a_stream_is_as_hard_as_the_cells(control, raw, clock, asked, sent):
    streaming(control, raw, clock)
    control.stopJ(asked)
    assert raw.calls == [("speedStop", (sent,))]


def test_nothing_else_moves_the_arm_during_a_stream(control, raw, clock):
    streaming(control, raw, clock)
    refused(lambda: control.moveJ(Q, 0.5, 1.4, True, permit=permit(clock)), Reason.BUSY, raw)
    other = [0.1] * 6
    right = speed_permit(clock, qd=other)
    refused(lambda: control.speedJ(other, 1.5, 0.5, permit=right), Reason.BUSY, raw)


def test_a_stream_is_prolonged_by_a_permit_for_the_same_speeds_from_its_arrival(control, raw, clock):
    streaming(control, raw, clock)
    clock.advance(300)
    again = speed_permit(clock)
    clock.advance(40)
    assert control.speedJ(QD, 1.5, 0.5, permit=again)
    assert raw.calls == [SPEED]
    assert control.speed_left_ms == 460  # 500 from its arrival, which is 40 ago
    shorter = speed_permit(clock, duration=0.05)
    assert control.speedJ(QD, 1.5, 0.05, permit=shorter)
    assert control.speed_left_ms == 460


def test_a_controller_that_does_not_watch_gets_no_stream(clock):
    class Unwatched(Raw):
        def setWatchdog(self, hz):
            return False

    raw = Unwatched()
    with pytest.raises(ActuationRefusedError) as raised:
        guarded(raw, clock).speedJ(QD, 1.5, 0.5, permit=speed_permit(clock))
    assert raised.value.reason is Reason.EFFECT_FAILED
    assert raw.calls == []


def test_a_stream_that_the_controller_does_not_take_is_stopped(clock):
    class Deaf(Raw):
        taken = False

        def speedJ(self, *arguments):
            self.calls.append(("speedJ", arguments))
            return self.taken

    deaf = Deaf()
    control = guarded(deaf, clock)
    with pytest.raises(ActuationRefusedError) as raised:
        control.speedJ(QD, 1.5, 0.5, permit=speed_permit(clock))
    assert raised.value.reason is Reason.EFFECT_FAILED
    assert deaf.calls[-1] == ("speedStop", (6.0,))
    deaf.taken = True
    control.end_speed()
    assert control.speedJ(QD, 1.5, 0.5, permit=speed_permit(clock))
    deaf.taken = False
    with pytest.raises(ActuationRefusedError) as raised:
        control.hold_speed()
    assert raised.value.reason is Reason.EFFECT_FAILED
    assert deaf.calls[-1] == ("speedStop", (6.0,))


def test_a_stop_that_overtakes_a_send_is_given_again_behind_it(clock):
    handing, enough = threading.Event(), threading.Event()

    class Slow(Raw):
        def speedJ(self, *_):
            handing.set()
            enough.wait(10)
            self.calls.append(("speedJ", ()))
            return True

    slow = Slow()
    control = guarded(slow, clock)
    sending = threading.Thread(target=lambda: control.speedJ(QD, 1.5, 0.5, permit=speed_permit(clock)))
    sending.start()
    assert handing.wait(10)
    control.stopJ()
    enough.set()
    sending.join(10)
    assert [name for name, _ in slow.calls] == ["setWatchdog", "speedStop", "speedJ", "speedStop"]
    assert not control.hold_speed()
