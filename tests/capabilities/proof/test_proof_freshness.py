"""[PRF-6] to [PRF-9]: over set-back clocks and restarts no proof counts twice, and fresh ones count once."""

from __future__ import annotations

from fractions import Fraction

import pytest
from capabilities.proof.freshness import Memory, before_start, earliest_iat_s, retention_ms, stale
from capabilities.values.caps import DEFAULT, Caps
from capabilities.values.errors import Fault, FaultCode
from hypothesis import given
from hypothesis import strategies as st

from capabilities.proof import freshness

pytestmark = pytest.mark.clause("PRF-7", "PRF-8")

NOW = 1_800_000_000
AGE, SKEW = DEFAULT.proof_age_s, DEFAULT.skew_s


def code(fault: Fault | None) -> tuple[FaultCode, str] | None:
    return None if fault is None else (fault.code, fault.clause)


@pytest.mark.clause("PRF-6")
@pytest.mark.parametrize("age", [-SKEW, -SKEW + 0.001, 0, 1, AGE - 0.001, AGE])
def test_a_fresh_proof(age):
    assert stale(NOW, at=NOW + age, caps=DEFAULT) is None


@pytest.mark.clause("PRF-6")
@pytest.mark.parametrize(
    "age", [-SKEW - 0.001, -SKEW - 1, AGE + 0.001, AGE + 1, 1e300, -1e300, float("nan"), float("inf"), float("-inf")]
)
def test_a_stale_proof(age):
    assert code(stale(NOW, at=NOW + age, caps=DEFAULT)) == (FaultCode.PROOF_STALE, "PRF-6")


@pytest.mark.clause("PRF-8")
@pytest.mark.parametrize(
    ("started", "memory", "earliest"),
    [
        (NOW, Memory.KEPT, NOW + 1),
        (NOW + 0.001, Memory.KEPT, NOW + 1),
        (NOW + 0.999, Memory.KEPT, NOW + 1),
        (NOW, Memory.LOST, NOW + 1 + 2 * SKEW),
        (NOW + 0.5, Memory.LOST, NOW + 1 + 2 * SKEW),
    ],
)
def test_the_first_second_after_the_start(started, memory, earliest):
    assert earliest_iat_s(started, memory=memory, caps=DEFAULT) == earliest
    assert before_start(earliest, earliest_s=earliest) is None
    assert code(before_start(earliest - 1, earliest_s=earliest)) == (FaultCode.PROOF_STALE, "PRF-8")
    assert code(before_start(earliest, earliest_s=float("nan"))) == (FaultCode.PROOF_STALE, "PRF-8")


@pytest.mark.clause("PRF-7")
def test_how_long_an_id_is_kept():
    assert retention_ms(DEFAULT) == 41_000
    assert retention_ms(Caps(proof_age_s=60, skew_s=2)) == 65_000


class Verifier:
    """Verifier as the clauses tell it, in exact time.

    It has a true clock in milliseconds, and a judged one that may be set back by the skew.
    """

    def __init__(self, caps: Caps) -> None:
        self.caps = caps
        self.true_ms = 0
        self.ahead_ms = 0  # of the judged clock
        self.highest_ahead_ms = 0
        self.kept: dict[int, int] = {}
        self.record_from_ms = -(10**9)  # since when the durable record is whole
        self.earliest_s: float = float("-inf")

    @property
    def judged_ms(self) -> int:
        return NOW * 1000 + self.true_ms + self.ahead_ms

    def advance(self, ms: int) -> None:
        self.true_ms += ms

    def set_clock(self, by_ms: int) -> None:
        """Forward at will; back by no more than the skew behind the highest time, carried on ([PRF-9])."""
        self.ahead_ms = max(self.ahead_ms + by_ms, self.highest_ahead_ms - self.caps.skew_s * 1000)
        self.highest_ahead_ms = max(self.highest_ahead_ms, self.ahead_ms)

    def restart(self, memory: Memory) -> None:
        """A record that was lost a moment ago is not whole yet: then the memory counts as lost again."""
        if self.true_ms - self.record_from_ms < retention_ms(self.caps):
            memory = Memory.LOST
        if memory is Memory.LOST:
            self.record_from_ms = self.true_ms
        self.earliest_s = earliest_iat_s(float(Fraction(self.judged_ms, 1000)), memory=memory, caps=self.caps)
        self.kept = {} if memory is Memory.LOST else {n: self.true_ms + retention_ms(self.caps) for n in self.kept}

    def accepts(self, number: int, iat: int) -> bool:
        at = float(Fraction(self.judged_ms, 1000))
        if stale(iat, at=at, caps=self.caps) or before_start(iat, earliest_s=self.earliest_s):
            return False
        self.kept = {n: until for n, until in self.kept.items() if until >= self.true_ms}
        if number in self.kept:
            return False
        self.kept[number] = self.true_ms + retention_ms(self.caps)
        return True


MOVES = st.one_of(
    st.tuples(st.just("advance"), st.integers(0, 50_000)),
    st.tuples(st.just("set"), st.sampled_from([-60_000, -5_000, -4_999, -1_000, -1, 1, 1_000, 5_000, 20_000])),
    st.tuples(st.just("restart"), st.sampled_from(Memory)),
    st.tuples(st.just("make"), st.integers(-35, 7)),
    st.tuples(st.just("present"), st.integers(0, 5)),
)


@pytest.mark.long
@pytest.mark.clause("PRF-7", "PRF-8", "PRF-9")
@given(st.lists(MOVES, min_size=4, max_size=40))
def test_no_proof_is_accepted_twice(moves):
    """At the end every proof is presented at every boundary of the next 90 s as well."""
    verifier, made, accepted = Verifier(DEFAULT), [], []

    def present(number: int) -> None:
        if verifier.accepts(number, made[number]):
            accepted.append(number)

    for what, value in moves:
        match what:
            case "advance":
                verifier.advance(value)
            case "set":
                verifier.set_clock(value)
            case "restart":
                verifier.restart(value)
            case "make":
                made.append(verifier.judged_ms // 1000 + value)
                present(len(made) - 1)
            case _:
                if made:
                    present(value % len(made))
    for _ in range(90):
        for number in range(len(made)):
            present(number)
        verifier.advance(1_000)
    assert len(accepted) == len(set(accepted))


def test_the_worst_case_is_reached_so_nothing_of_the_bound_is_spare_but_the_second():
    """A proof from the end of the skew, and a clock set back by the skew.

    It is acceptable again up to 40 s later but for the memory.
    """
    verifier = Verifier(DEFAULT)
    iat = NOW + SKEW
    assert verifier.accepts(0, iat)
    verifier.set_clock(-SKEW * 1000)
    verifier.advance(40_000)
    assert stale(iat, at=verifier.judged_ms / 1000, caps=DEFAULT) is None
    assert not verifier.accepts(0, iat)
    verifier.advance(1_000)
    assert stale(iat, at=verifier.judged_ms / 1000, caps=DEFAULT) is not None


def test_a_verifier_that_lost_its_memory_needs_twice_the_skew():
    """The proof was accepted from the end of the skew by a process whose time was ahead by the skew."""
    verifier = Verifier(DEFAULT)
    verifier.set_clock(SKEW * 1000)
    iat = NOW + 2 * SKEW
    assert verifier.accepts(0, iat)
    verifier.set_clock(-SKEW * 1000)
    verifier.restart(Memory.LOST)
    verifier.advance(SKEW * 1000)
    assert stale(iat, at=verifier.judged_ms / 1000, caps=DEFAULT) is None
    assert not verifier.accepts(0, iat)
    assert verifier.earliest_s == iat + 1


@pytest.mark.clause("PRF-7", "PRF-8", "PRF-9")
def test_an_honest_proof_is_accepted_once_after_every_kind_of_start():
    for memory, wait_s in ((Memory.KEPT, 1), (Memory.LOST, 1 + 2 * SKEW)):
        verifier = Verifier(DEFAULT)
        verifier.restart(memory)
        verifier.advance(wait_s * 1000)
        assert verifier.accepts(0, verifier.judged_ms // 1000)


@pytest.mark.clause(reason="time is an argument in this house")
def test_the_module_reads_no_clock():
    assert "time" not in vars(freshness)
    assert "random" not in vars(freshness)
