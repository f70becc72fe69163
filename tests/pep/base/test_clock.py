"""A wall clock that is set back revives no proof, no token and no replay, now or after a restart."""

import asyncio
import contextlib
import json

import pytest
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.errors import FaultCode
from hypothesis import given
from hypothesis import strategies as st
from pep.base.clock import MARK_PERIOD_S, HeldClock, SystemClock, TimeMark
from pep.base.errors import PepError, PepFault
from tests.pep.kit import ManualClock, Rig

from pep.base import clock as clocks

SKEW = CAPS.skew_s
NOON = 1_800_000_000.0


class World:
    def __init__(self, tmp):
        self.path = tmp / "time.json"
        self.machine = ManualClock(NOON)
        self.start()

    def start(self, *, mono=None):
        """As a process starts: nothing in memory, the monotonic clock perhaps from zero."""
        if mono is not None:
            self.machine.mono = mono
        self.clock = HeldClock(self.machine, mark=TimeMark(self.path), skew_s=SKEW)

    @property
    def wall(self):
        return self.clock.wall_s()


@pytest.fixture
def world(tmp_path):
    return World(tmp_path)


def test_a_clock_that_goes_right_is_followed(world):
    for _ in range(100):
        world.machine.advance(997)
        assert world.wall == world.machine.wall_s()
        assert world.clock.held_s == 0
    world.machine.wall += 3_600  # set forward: what is over stays over
    assert world.wall == world.machine.wall_s()


def test_small_corrections_are_followed_back_but_they_do_not_add_up(world):
    top = world.wall
    world.machine.wall -= 3
    assert world.wall == top - 3
    world.machine.wall -= 3
    assert world.wall == pytest.approx(top - SKEW)
    for _ in range(10):
        world.machine.wall -= 3
    assert world.wall == pytest.approx(top - SKEW)


def test_a_time_that_is_held_goes_on(world):
    """It does not stand still: what is alive now must end when it would have ended."""
    top = world.wall
    world.machine.wall -= 86_400
    assert world.wall == pytest.approx(top - SKEW)
    world.machine.advance(60_000)
    assert world.wall == pytest.approx(top - SKEW + 60)
    assert world.clock.held_s == pytest.approx(86_400 - SKEW)


def test_it_is_followed_again_once_it_is_right_again(world):
    world.wall
    world.machine.wall -= 3_600
    world.wall
    world.machine.wall += 3_600
    assert world.wall == world.machine.wall_s()
    assert world.clock.held_s == 0


@given(st.lists(st.tuples(st.integers(0, 5_000), st.integers(-100_000, 100_000)), max_size=40))
def test_it_never_goes_back_by_more_than_the_skew(tmp_path_factory, steps):
    """Against a slow twin: the greatest of all that was returned, carried on by the monotonic clock, less the skew."""
    machine = ManualClock(NOON)
    clock = HeldClock(machine, mark=TimeMark(tmp_path_factory.mktemp("t") / "time.json"), skew_s=SKEW)
    returned = []
    for passed_ms, step_ms in steps:
        machine.mono += passed_ms
        machine.wall += passed_ms / 1000 + step_ms / 1000
        now = clock.wall_s()
        assert now >= machine.wall - 1e-3
        for wall, mono in returned:
            assert now >= wall + (machine.mono - mono) / 1000 - SKEW - 1e-3
        returned.append((now, machine.mono))


# --- over restarts ----------------------------------------------------------------------------------------------------------


def test_a_restart_after_the_clock_was_set_back(world):
    world.machine.advance(10_000)
    top = world.wall
    world.clock.keep()
    world.machine.wall -= 86_400
    world.start(mono=5)
    assert world.wall == pytest.approx(top, abs=0.002)
    world.machine.advance(1_000)
    assert world.wall == pytest.approx(top + 1, abs=0.002)


def test_what_a_crash_loses_of_the_mark_is_inside_the_skew(world):
    assert MARK_PERIOD_S < SKEW
    world.clock.keep()
    world.machine.advance(int(MARK_PERIOD_S * 1000))
    top = world.wall  # judged by, and never written
    world.machine.wall -= 86_400
    world.start(mono=0)
    assert top - SKEW <= world.wall <= top


def test_again_and_again(world):
    top = world.wall
    for _ in range(20):
        world.clock.keep()
        world.machine.wall -= 1_000
        world.start(mono=0)
    assert world.wall >= top - 0.1, "restarts do not add up"


def test_the_first_start_and_an_honest_restart_hold_nothing(world):
    assert world.clock.held_s == 0
    world.clock.keep()
    world.machine.advance(500)
    world.start(mono=0)
    assert world.clock.held_s == 0
    assert world.wall == world.machine.wall_s()


@pytest.mark.parametrize(
    "content", [b"", b"{", b"{}", b"[]", b"5", b'{"wall_ms": "5"}', b'{"wall_ms": 1.5}', b'{"wall_ms": true}', b'{"wall_ms": NaN}', b"[" * 300]
)  # fmt: skip
def test_a_mark_that_cannot_be_read_is_not_taken_for_none(world, content):
    world.path.write_bytes(content)
    with pytest.raises(PepError) as caught:
        world.start()
    assert caught.value.code is PepFault.STATE_UNREADABLE


def test_a_mark_is_replaced_whole(world, monkeypatch):
    world.clock.keep()
    before = world.path.read_bytes()

    def full(_):
        raise OSError("disk full")

    monkeypatch.setattr("os.fsync", full)
    world.machine.advance(5_000)
    with pytest.raises(OSError, match="disk full"):
        world.clock.keep()
    monkeypatch.undo()
    assert world.path.read_bytes() == before
    world.clock.keep()
    assert json.loads(world.path.read_bytes()) == {"wall_ms": int((NOON + 5) * 1000)}


def test_keeping_goes_on_and_tells(world, monkeypatch):
    monkeypatch.setattr(clocks, "MARK_PERIOD_S", 0.002)
    failed, told = [], []

    async def go():
        task = asyncio.create_task(world.clock.run(failed=failed.append, set_back=told.append))
        async with asyncio.timeout(20):
            while not world.path.exists():
                await asyncio.sleep(0.001)
            world.machine.wall -= 100
            while not told:
                await asyncio.sleep(0.001)
            world.machine.wall += 100
            stamp = lambda: json.loads(world.path.read_bytes())["wall_ms"]
            world.machine.advance(1_000)
            while stamp() < (NOON + 1) * 1000:
                await asyncio.sleep(0.001)
            while world.clock.held_s or len(told) < 1:
                await asyncio.sleep(0.001)
            monkeypatch.setattr(TimeMark, "write", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
            while len(failed) < 2:
                await asyncio.sleep(0.001)
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task

    asyncio.run(go())
    assert told == [pytest.approx(100 - SKEW)], "once for each time"


def test_it_is_the_machines_clock_otherwise(tmp_path):
    machine = SystemClock()
    clock = HeldClock(machine, mark=TimeMark(tmp_path / "time.json"), skew_s=SKEW)
    assert abs(clock.wall_s() - machine.wall_s()) < 1
    assert abs(clock.monotonic_ms() - machine.monotonic_ms()) < 1_000


# --- what it is for ---------------------------------------------------------------------------------------------------------


class Judged:
    """A PEP's authority on a held clock over a machine's clock that a test sets, and one agent."""

    def __init__(self, tmp):
        self.tmp, self.machine = tmp, ManualClock()
        self.restart()
        self.holder = self.rig.agent()

    def restart(self):
        clock = HeldClock(self.machine, mark=TimeMark(self.tmp / "time.json"), skew_s=SKEW)
        if hasattr(self, "rig"):
            self.rig.journal.close()
            made, trust = self.rig.made, self.rig.trust
        self.rig = Rig(self.tmp, clock=clock)
        if hasattr(self, "holder"):
            self.rig.made, self.rig.trust = made, trust
            self.rig.build()

    def proof(self):
        """A request as an agent with a right clock makes it now."""
        from pep.request.authority import PresentedRequest
        from tests.pep.kit import AUDIENCE

        text = self.holder.proof(b"{}", at=self.machine.wall_s())
        return PresentedRequest(self.holder.text, text, "POST", AUDIENCE, b"{}")

    def fault(self, presented):
        found = self.rig.authority.check(presented, lease_ms=30_000).fault
        return None if found is None else found.code

    def pass_by(self, seconds):
        """So long passes by, and the PEP judges something meanwhile."""
        self.machine.advance(int(seconds * 1000))
        self.rig.clock.wall_s()


@pytest.fixture
def judged(tmp_path):
    return Judged(tmp_path)


def test_an_old_proof_stays_old_when_the_clock_is_set_back(judged):
    unused = judged.proof()
    judged.pass_by(CAPS.proof_age_s + 20)
    assert judged.fault(unused) is FaultCode.PROOF_STALE
    judged.machine.wall -= CAPS.proof_age_s + 20
    assert judged.fault(unused) is FaultCode.PROOF_STALE


@pytest.mark.parametrize("back_s", [1, 5, 6, 30, 60, 3_600])
def test_a_used_proof_is_never_used_again_however_the_clock_is_set(judged, back_s):
    """Every second for two minutes it is refused: as replayed while it is remembered, and then as stale."""
    used = judged.proof()
    assert judged.fault(used) is None
    judged.machine.wall -= back_s
    for _ in range(120):
        assert judged.fault(used) in {FaultCode.REPLAYED, FaultCode.PROOF_STALE}
        judged.machine.advance(1_000)


def test_a_proof_from_a_fast_agents_future_is_never_used_again_either(judged):
    """The worst case of memory: accepted at the skew's end, and then the clock falls by its most."""
    judged.machine.wall += SKEW
    used = judged.proof()
    judged.machine.wall -= SKEW
    judged.restart()
    assert judged.fault(used) is None
    judged.machine.wall -= SKEW
    for _ in range(240):
        assert judged.fault(used) in {FaultCode.REPLAYED, FaultCode.PROOF_STALE}
        judged.machine.advance(500)


def test_an_expired_token_stays_expired_when_the_clock_is_set_back_over_a_restart_too(judged):
    judged.pass_by(7_200)
    assert judged.fault(judged.proof()) is FaultCode.EXPIRED
    judged.rig.clock.keep()
    judged.machine.wall -= 7_200
    assert judged.fault(judged.proof()) is FaultCode.EXPIRED
    judged.restart()
    assert judged.fault(judged.proof()) is FaultCode.EXPIRED


def test_a_token_ends_on_time_while_the_time_is_held(judged):
    assert judged.fault(judged.proof()) is None
    expires = judged.rig.clock.wall_s() + 7_200
    judged.machine.wall -= 86_400
    while judged.rig.clock.wall_s() < expires:
        judged.machine.advance(600_000)
    assert judged.fault(judged.proof()) is FaultCode.EXPIRED
