"""Successive values of a stream: the short reading of their changes comes to the long one's result."""

import math
import random
import struct

import pytest
from pep.rtde.command.command_table import encode
from pep.rtde.line.effects import AskJudge
from pep.rtde.line.rtde_line import LeasedLine
from pep.rtde.line.stream_update import Following
from pep.rtde.wire.codec import Recipe, encode_request
from pep.rtde.wire.messages import Values, WireError
from pep.rtde.wire.recipes import DOUBLE, INT, control_recipes
from pep.rtde.wire.variables import INPUTS
from policies.words.reason_table import Reason
from tests.pep.rtde.line.test_leased_line import Talk
from tests.pep.rtde.whole_commands import WholeCommands

from pep.rtde.command import command_values as v

pytestmark = pytest.mark.clause("RTDE-11")

Q = (0.1, -1.5, 1.4, -1.3, -1.2, 0.2)
SERVO = v.ServoJ(Q, 0.002, 0.1, 300.0)
SPEED = v.SpeedJ((0.0, 0.1, 0.0, -0.0, 0.2, 0.0), 1.4, 0.01)
BROKEN = 7.0
"""A number that the judge breaks on."""


class TheLongWay(LeasedLine):
    """Every package goes through the image."""

    def _next(self, received, at_ms):
        return None


class Judge(WholeCommands):
    """Takes values whose first number is small, and keeps them all."""

    def __init__(self):
        self.seen = []

    def judged(self, command):
        self.seen.append(repr(command))  # 0.0 is like -0.0, and spelt otherwise
        match command:
            case v.ServoJ(six) | v.SpeedJ(six):
                if six[1] == BROKEN:
                    raise ArithmeticError
                return None if six[0] < 1.0 else Reason.LIMIT_EXCEEDED_BY_REQUEST

    def ended(self):
        self.seen.append("ended")


class Side:
    """A line of one kind whose control script runs, and everything that came of it."""

    def __init__(self, line):
        self.talk = Talk(line=line).begun(control_recipes(0)).running()
        self.line, self.commands = self.talk.line, self.talk.line.commands
        self.judge, self.asked, self.told = Judge(), None, []

    def took(self, said):
        acts = self.line.take()
        self.asked = next((act.question for act in acts if isinstance(act, AskJudge)), self.asked)
        self.told.append((said, [type(act).__name__ for act in acts], self.commands.denied, self.judge.seen[:]))

    def says(self, *packages, at_ms=5):
        """In one piece."""
        self.took(self.line.said(b"".join(encode_request(p, 2) for p in packages), slider=1.0, at_ms=at_ms))

    def settles(self):
        self.took(self.line.settle())

    def permits(self):
        if self.asked is not None:
            self.commands.forward(self.asked, self.judge, at_ms=5)
            self.settles()

    def does(self, act, *given):
        getattr(self.commands, act)(*given)
        self.settles()


NAMES = control_recipes(0)
LAYOUTS = [Recipe(names, [INPUTS[name] for name in names]) for names in NAMES]


def package(recipe, values):
    """Of the client; what is not named is zero, as everything is in a client that has just begun."""
    layout = LAYOUTS[recipe]
    blank = {name: (0.0,) * 6 if name == "external_force_torque" else 0 for name in layout.names}
    return Values(recipe + 1, layout.pack({**blank, **{n: values[n] for n in layout.names if n in values}}))


def saying(command, recipe=None, **changes):
    """The package of a recipe, or of the shortest that has all of it."""
    said = {**encode(command, 0), **changes}
    if recipe is None:
        recipe = min((r for r, names in enumerate(NAMES) if set(said) <= set(names)), key=lambda r: len(NAMES[r]))
    return package(recipe, said)


class Deeds:
    """Acts of a program, its judge and the controller in turn: mostly a stream that goes on."""

    USUAL = (0.1, 0.2, -0.4, 0.0, -0.0)
    STRANGE = (5e-324, 1.5, BROKEN, math.nan, math.inf)

    def __init__(self, seed):
        self.random, self.command = random.Random(seed), SERVO

    def value(self):
        pick = self.random.choice
        six = [pick(self.USUAL) for _ in range(6)]
        more = {}
        if self.random.random() < 0.1:
            six[pick(range(6))] = pick(self.STRANGE)
        if self.random.random() < 0.1:
            more = {pick(DOUBLE[6:11]): pick((0.002, 0.1, 300.0, *self.STRANGE))}
        if self.random.random() < 0.1:
            self.command = pick((SERVO, SPEED))
        recipe = 1 if self.random.random() < 0.9 else None
        return saying(self.command, recipe, **dict(zip(DOUBLE, six, strict=False)), **more)

    def other(self):
        pick = self.random.choice
        return pick(
            (
                package(pick(range(23)), {INT[0]: pick((0, 11, 9, 1, 35, 26))}),
                package(pick(range(23)), {INT[0]: self.id, **dict.fromkeys(DOUBLE, pick(self.USUAL))}),
                saying(v.ServoStop(10.0)),
                saying(v.StopJ(2.0, asynchronous=False)),
                saying(v.SetWatchdog(10.0)),
                Values(pick(range(1, 24)), bytes(pick(range(90)))),
            )
        )

    @property
    def id(self):
        return 11 if self.command is SERVO else 9

    def next(self):
        """A few deeds that belong together."""
        pick, clear = self.random.choice, package(3, {INT[0]: 0})
        at = self.random.random()
        if at < 0.6:
            return [("says", *[self.value() for _ in range(pick((1, 1, 1, 2)))])]
        if at < 0.85:
            again = saying(self.command)
            return [("says", clear), ("robot", 0, 1, True), ("says", again), ("permits",), ("says", again)]
        return [
            pick(
                (
                    ("says", self.value(), self.other(), self.value()),
                    ("says", self.other()),
                    ("rewrites",),
                    ("refuses",),
                    ("stops",),
                    ("looks", pick((6, 100, 500))),
                    ("robot", pick((0, 9, 11, 16, 34)), pick((0, 1, 2)), pick((True, False))),
                    ("ends",),
                    ("begins",),
                    ("begins",),
                )
            )
        ]


def played(line, deeds):
    side = Side(line)
    side.says(saying(SERVO))
    side.permits()
    for at_ms, (what, *given) in enumerate(deeds, 6):
        match what:
            case "says":
                side.says(*given, at_ms=at_ms)
            case "permits":
                side.permits()
            case "rewrites":
                side.line.rewrite()
                side.settles()
            case "refuses" if side.asked is not None:
                side.does("deny", side.asked, Reason.NOT_GRANTED, "not so")
            case "stops" if side.asked is not None:
                side.does("stop", side.asked, Reason.IMPACT_ROSE, "too near")
            case "looks":
                side.commands.look(at_ms=at_ms + given[0])
                side.settles()
            case "robot":
                side.commands.robot(*given[:2], still=given[2])
                side.settles()
            case "ends":
                side.does("end", Reason.ROBOT_NOT_RUNNING)
            case "begins":
                side.does("begin", ())
    side.does("leave")
    side.says(saying(SERVO))
    return side


@pytest.mark.long
@pytest.mark.parametrize("count", [60, pytest.param(1_000, marks=pytest.mark.campaign)])
def test_the_short_way_comes_to_what_the_long_one_comes_to(count, monkeypatch):
    short, follow = [], LeasedLine._next
    monkeypatch.setattr(LeasedLine, "_next", lambda *given: short.append(follow(*given)) or short[-1])
    for seed in range(count):
        drawn, deeds = Deeds(seed), []
        for _ in range(40):
            deeds += drawn.next()
        ours, other = played(LeasedLine, deeds), played(TheLongWay, deeds)
        assert ours.told == other.told, seed
        assert ours.commands._client.merged({}).values == pytest.approx(
            other.commands._client.merged({}).values, nan_ok=True
        )
    assert sum(said is not None for said in short) > 6 * count


@pytest.mark.parametrize("command", [SERVO, SPEED])
def test_values_that_follow_go_the_short_way(command, monkeypatch):
    side = Side(LeasedLine)
    side.says(saying(command))
    side.permits()
    side.says(saying(command))
    calls = []
    monkeypatch.setattr("pep.rtde.line.command_registers.changes", lambda *_: calls.append(1))
    for q in (0.11, 0.12, -0.0):
        side.says(saying(command, **{DOUBLE[0]: q}))
        assert struct.pack(">d", q) in side.told[-1][0].to_robot
    assert not calls
    assert len(side.judge.seen) == 4


def first(command=SERVO, **changes):
    """Following of a command, where its package has these changes."""
    layout = LAYOUTS[1]
    own = Recipe(layout.names[:12], layout.types[:12])
    said = saying(command, 1, **changes)
    return Following.of(said, layout, frame=b"head" + bytes(own.size), own=own, command=command, offset=0)


def test_nothing_follows_what_a_package_does_not_say():
    assert first() is not None
    assert first(**{DOUBLE[0]: 0.3}) is None
    assert first(**{INT[0]: 9}) is None
    assert first(v.ServoL(Q, 0.002, 0.1, 300.0)) is None
    assert (
        Following.of(package(3, {INT[0]: 11}), LAYOUTS[3], frame=b"", own=LAYOUTS[3], command=SERVO, offset=0) is None
    )


@pytest.mark.parametrize(
    "other",
    [
        package(0, encode(SERVO, 0)),
        Values(2, saying(SERVO, 1).packed[:-1]),
        Values(None, saying(SERVO, 1).packed),
        saying(SERVO, 1, **{DOUBLE[10]: 400.0}),
        saying(SERVO, 1, **{INT[0]: 9}),
        saying(SERVO, 1, **{DOUBLE[5]: math.nan}),
        saying(SERVO, 1, **{DOUBLE[0]: math.inf}),
    ],
)
def test_another_package_does_not_follow(other):
    following, said = first(), encode_request(saying(SERVO, 1, **{DOUBLE[2]: -3.0}), 2)
    assert following.read(said) is not None
    for content in (encode_request(other, 2), said[:-1], said[1:], said + said, b""):
        assert following.read(content) is None


def test_a_value_after_half_of_one_is_not_read_by_itself():
    side = Side(LeasedLine)
    side.says(saying(SERVO))
    side.permits()
    side.says(saying(SERVO))
    half, whole = (encode_request(saying(SERVO, **{DOUBLE[0]: q}), 2) for q in (0.11, 0.12))
    side.took(side.line.said(half[:9], slider=1.0, at_ms=5))
    seen = side.judge.seen[:]
    with pytest.raises(WireError):
        side.line.said(whole, slider=1.0, at_ms=5)
    assert side.judge.seen == seen


def test_a_torn_value_goes_the_long_way():
    side = Side(LeasedLine)
    side.says(saying(SERVO))
    side.permits()
    side.says(saying(SERVO))
    later = [encode_request(saying(SERVO, **{DOUBLE[0]: q}), 2) for q in (0.11, 0.12)]
    for piece in (later[0][:9], later[0][9:] + later[1][:30], later[1][30:]):
        side.took(side.line.said(piece, slider=1.0, at_ms=5))
    wrote = [told[0].to_robot for told in side.told[-3:]]
    assert wrote[0] == b""
    assert [struct.pack(">d", q) in content for q, content in zip((0.11, 0.12), wrote[1:], strict=True)] == [True, True]
