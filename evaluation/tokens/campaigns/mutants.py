"""Campaign A1: bytes that nobody issued, made from 22 shapes of tokens, put before the whole of `verify`.

None may be accepted, none may raise, none may take 50 ms, and memory may not grow by 64 MiB.
"""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Callable  # noqa: TC003 - a dataclass field: its annotation must resolve
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from capabilities.values.chain import Chain
from capabilities.values.errors import Fault
from evaluation.harness.campaign import missed
from evaluation.harness.work import keep, seeds_of, shares, together, total
from evaluation.tokens.campaigns.issuer import Issuer, verified
from evaluation.tokens.campaigns.mutation import KINDS, Pool, mutant, pool

COUNT: Final = 1_000_000
SLOWEST_MS: Final = 50.0
GROWTH_MIB: Final = 64.0
_AGAIN: Final = 50
"""Most further tries of a mutant that took too long: one that is slow by itself is slow every time."""
_CONTROL: Final = 10_000
"""Number of mutants after which the issued tokens are verified again."""


@dataclass(frozen=True, slots=True)
class Clocks:
    """Two monotonic clocks, ns: that of the room, and of the processor's work in this thread."""

    room_ns: Callable[[], int] = time.perf_counter_ns
    work_ns: Callable[[], int] = time.thread_time_ns


@dataclass(slots=True)
class MutantTally:
    """Tally of one run.

    Attributes:
        tried: mutants by kind.
        issued: draws that gave an issued token, which is no mutant.
        codes: faults by code.
        accepted, stray: mutants in hex; exceptions, each with its mutant.
        slow: mutants that took over `SLOWEST_MS` of the processor, or by the clock each time that they were tried.
        paused: mutants that took over it by the clock alone, and not each time: the processor was busy with other work.
        worst_ms, worst_cpu_ms: of one `verify`: by the clock, and of this thread.
        growth_mib: peak of memory less its size before the first mutant.
        lost: issued tokens that were refused afterwards.
    """

    tried: Counter[str] = field(default_factory=Counter)
    issued: int = 0
    codes: Counter[str] = field(default_factory=Counter)
    accepted: list[str] = field(default_factory=list)
    stray: list[str] = field(default_factory=list)
    slow: int = 0
    paused: int = 0
    worst_ms: float = 0.0
    worst_cpu_ms: float = 0.0
    growth_mib: float = 0.0
    lost: int = 0


@dataclass(frozen=True, slots=True)
class MutantFigures:
    """Figures of the campaign.

    Attributes:
        count: mutants that were wanted.
        tally: of all of them.
    """

    count: int
    tally: MutantTally

    @property
    def missed(self) -> tuple[str, ...]:
        """Misses of the bar; none when all wanted mutants meet it."""
        found = self.tally
        faults = {
            f"{sum(found.tried.values())} tried": not sum(found.tried.values()) == self.count > 0,
            f"{found.slow} over {SLOWEST_MS:g} ms": found.slow > 0,
            f"{found.lost} issued tokens refused": found.lost > 0,
            f"memory +{found.growth_mib:.0f} MiB": not found.growth_mib < GROWTH_MIB,
        }
        return missed(faults, {"accepted": found.accepted, "stray exceptions": found.stray})


# --- one process -----------------------------------------------------------------------------------------------------


def hunt(of: Pool, count: int, seed: int, ask: Callable[[bytes], Chain | Fault], clocks: Clocks) -> MutantTally:
    """Tally of the answers of `ask` to so many mutants, the kinds in turn.

    Args:
        of: the tokens.
        count: mutants, at least 1.
        seed: of every draw.
        ask: the whole of `verify`, for one token.
        clocks: that each answer is timed with.
    """
    chance = random.Random(seed)  # noqa: S311 - draws, no secrets
    found = MutantTally()
    found.lost += _control(of, ask)
    before_mib, peak_mib = _memory_mib("VmRSS"), _memory_mib("VmHWM")
    for number in range(count):
        kind = KINDS[number % len(KINDS)]
        while (made := mutant(kind, of, chance)) in of.issued:
            found.issued += 1
        found.tried[kind] += 1
        _judge(made, found, ask, clocks)
        if number % _CONTROL == _CONTROL - 1:
            found.lost += _control(of, ask)
    found.lost += _control(of, ask)
    # A peak from before the run is not ours; below it, the present size tells whether memory was kept.
    highest_mib = _memory_mib("VmHWM")
    found.growth_mib = (highest_mib if highest_mib > peak_mib else _memory_mib("VmRSS")) - before_mib
    return found


def _judge(made: bytes, found: MutantTally, ask: Callable[[bytes], Chain | Fault], clocks: Clocks) -> None:
    took_ms, cpu_ms = _timed(made, found, ask, clocks)
    if took_ms > SLOWEST_MS:
        aside = MutantTally()
        again = (_timed(made, aside, ask, clocks)[0] <= SLOWEST_MS for _ in range(_AGAIN))
        if cpu_ms <= SLOWEST_MS and any(again):
            found.paused += 1
        else:
            found.slow += 1
    found.worst_ms = max(found.worst_ms, took_ms)
    found.worst_cpu_ms = max(found.worst_cpu_ms, cpu_ms)


def _timed(
    made: bytes, found: MutantTally, ask: Callable[[bytes], Chain | Fault], clocks: Clocks
) -> tuple[float, float]:
    """Milliseconds by the clock and of this thread; the answer is counted."""
    cpu, began = clocks.work_ns(), clocks.room_ns()
    try:
        answer: object = ask(made)
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:  # noqa: BLE001 - a panic of the library is no Exception
        answer = error
    took, cpu = clocks.room_ns() - began, clocks.work_ns() - cpu
    if isinstance(answer, Fault):
        found.codes[str(answer.code)] += 1
    elif isinstance(answer, BaseException):
        keep(found.stray, f"{type(answer).__name__} {made.hex()}")
    else:
        keep(found.accepted, made.hex())
    return took / 1e6, cpu / 1e6


def _control(of: Pool, ask: Callable[[bytes], Chain | Fault]) -> int:
    """Number of issued tokens that are refused."""
    return sum(not isinstance(ask(token), Chain) for token in of.issued)


def _memory_mib(what: str) -> float:
    """Memory of this process from Linux's own account: now (`VmRSS`) or at its highest (`VmHWM`)."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(what):
            return int(line.split()[1]) / 1_024
    raise RuntimeError(f"no {what} in /proc/self/status")


# --- all of it -------------------------------------------------------------------------------------------------------


def _share(issuer_seed: str, count: int, seed: int) -> MutantTally:
    issuer = Issuer(issuer_seed)
    verifier = issuer.verifier()
    return hunt(pool(issuer), count, seed, lambda token: verified(verifier, token), Clocks())


def run(count: int = COUNT, seed: int = 1, *, processes: int = 2) -> MutantFigures:
    """The figures of the campaign.

    Args:
        count: mutants.
        seed: of every draw. Tokens have random parts of their own, so a failure is kept whole.
        processes: that share the work; with 1 it is done here.
    """
    drawn = zip(shares(count, processes), seeds_of(seed, processes), strict=True)
    return MutantFigures(count, total(together(_share, [(f"mutants {each}", share, each) for share, each in drawn])))
