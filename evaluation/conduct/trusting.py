"""Trust under those who play with it: the impatient, the on-off attacker, the liars; and under the honest."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING, Final

from evaluation.conduct.agents import BEGIN, SPONSOR, Draft, reported
from evaluation.harness.campaign import Campaign, Outcome
from policies.conduct.decay import TICKS, decayed
from policies.conduct.report import Edge
from policies.conduct.trust import NOTHING_REPORTED, observe, score
from policies.words.parameters import Parameters

if TYPE_CHECKING:
    from collections.abc import Iterable

    from evaluation.harness.campaign import Settings
    from policies.conduct.report import Report
    from policies.conduct.trust import TrustState

PARAMETERS: Final = Parameters()
PRIOR: Final = PARAMETERS.trust_prior_permille
THETA: Final = PARAMETERS.trust_theta_permille
DAY: Final = 86_400
EDGE: Final = Edge(SPONSOR, "worker")
WORK: Final = Draft("move_joint", 2, (), None, 0)
"""A consequential act, done."""
WRONG: Final = Draft("move_joint", 2, (), None, 0, "NOT_GRANTED")
ATTEMPT: Final = Draft("delegate", 0, (), None, 0, "NOT_NARROWER")
SLIP: Final = Draft("move_joint", 2, (), None, 0, "LIMIT_EXCEEDED_BY_REQUEST")
EVERY_S: Final = 36
"""A hundred acts an hour."""
ON_OFF_AT_ONCE: Final = 9
ON_OFF_A_DAY: Final = 6
"""Wrongs that an on-off attacker can afford in a day.

Credit at its cap carries (s0 + cap) * (prior - theta) / theta = 8.6 at once, and as much times ln 2 within each
half-life, 5.9.
"""


def after(state: TrustState, reports: Iterable[Report]) -> TrustState:
    """The state after the reports, each received at once."""
    for report in reports:
        state = observe(state, report, PARAMETERS, now=report.at)
    return state


def told(draft: Draft, at: int, n: object, *, reporter: str = "pep") -> Report:
    """One report of the worker."""
    return reported(draft, at=at, n=n, reporter=reporter)


def permille(state: TrustState, at: int) -> int:
    """Trust in the worker's edge."""
    return score(state, EDGE, at, None, PARAMETERS)


def veteran(until: int, *, reporter: str = "pep") -> TrustState:
    """A day of work without fault, up to `until`."""
    acts = range(until - DAY, until, EVERY_S)
    return after(NOTHING_REPORTED, (told(WORK, at, f"work {at}", reporter=reporter) for at in acts))


def liars(count: int, lies: int, *, honest: TrustState = NOTHING_REPORTED) -> TrustState:
    """Trust state after so many reporters, each with so many false reports of one agent, all at one instant."""
    return after(
        honest,
        (told(ATTEMPT, BEGIN, f"lie {n}", reporter=f"liar {who}") for who in range(count) for n in range(lies)),
    )


def on_off(days: int) -> tuple[list[tuple[int, int]], list[int]]:
    """A greedy attacker: whenever its score afterwards still reaches theta it does a wrong, else it works.

    Returns:
        (seconds, permille) after each act, and the seconds of the wrongs; a day of honest work comes first.
    """
    state, curve, wrongs = veteran(BEGIN), [], []
    for n, at in enumerate(range(BEGIN, BEGIN + days * DAY, EVERY_S)):
        worse = observe(state, told(WRONG, at, n), PARAMETERS, now=at)
        if permille(worse, at) >= THETA:
            state = worse
            wrongs.append(at - BEGIN)
        else:
            state = observe(state, told(WORK, at, n), PARAMETERS, now=at)
        curve.append((at - BEGIN, permille(state, at)))
    return curve, wrongs


def _decay(settings: Settings) -> Outcome:
    """Integers against the real exponential."""
    draw, trials = random.Random(settings.seed), 2_000 if settings.quick else 200_000  # noqa: S311 - no secrets
    worst = 0.0
    for _ in range(trials):
        amount, ticks = draw.randrange(10**6, 4 * 10**10), draw.randrange(10 * TICKS)
        exact = amount * 2 ** (-ticks / TICKS)
        worst = max(worst, abs(decayed(amount, ticks) - exact) / amount)
    attempt = after(NOTHING_REPORTED, [told(ATTEMPT, BEGIN, 0)])
    days = next(day for day in range(100) if permille(attempt, BEGIN + day * DAY) == PRIOR)
    faults = () if worst < 1e-6 else (f"worst error {worst}",)
    return Outcome(trials, {"worst error": f"{worst:.1e}", "days to the prior after one attempt": days}, faults)


def _attempts(_: Settings) -> Outcome:
    """Number of attempts at more authority, and of wrongs, until trust falls below theta."""
    figures: dict[str, int | float | str] = {}
    faults = []
    for who, state in {"stranger": NOTHING_REPORTED, "veteran": veteran(BEGIN)}.items():
        counts = {}
        for name, draft in {"attempts": ATTEMPT, "wrongs": WRONG}.items():
            now, count = state, 0
            while permille(now, BEGIN) >= THETA:
                count += 1
                now = observe(now, told(draft, BEGIN, f"{name} {count}"), PARAMETERS, now=BEGIN)
            back = next(hour for hour in range(10_000) if permille(now, BEGIN + hour * 3_600) >= THETA)
            counts[name] = count
            figures |= {f"{who} {name}": count, f"{who} {name}, hours until theta again": back}
        if counts["attempts"] > 2 or counts["wrongs"] > ON_OFF_AT_ONCE:
            faults.append(f"{who}: {counts}")
    return Outcome(4, figures, tuple(faults))


def _on_off(settings: Settings) -> Outcome:
    days = 2 if settings.quick else 10
    _, wrongs = on_off(days)
    first = sum(at < EVERY_S * 20 for at in wrongs)
    later = sum(at >= DAY for at in wrongs) / (days - 1)
    bound = ON_OFF_AT_ONCE + ON_OFF_A_DAY * days
    faults = [] if first <= ON_OFF_AT_ONCE and len(wrongs) <= bound else [f"{len(wrongs)} wrongs, {first} at once"]
    figures: dict[str, int | float | str] = {
        "wrongs at once": first,
        "a day afterwards": round(later, 2),
        "of acts": f"{later * EVERY_S / DAY:.2%}",
    }
    return Outcome(days * DAY // EVERY_S, figures, tuple(faults))


def _liars(settings: Settings) -> Outcome:
    """False reports against an agent: the score never falls below the stated bound for so many liars."""
    lies = 50 if settings.quick else 2_000
    s0, cap = PARAMETERS.trust_prior_weight_milli, PARAMETERS.trust_bad_cap_milli
    figures: dict[str, int | float | str] = {}
    faults = []
    for count in (1, 2, 3):
        floor = PRIOR * s0 // (s0 + count * cap)
        found = permille(liars(count, lies, honest=veteran(BEGIN)), BEGIN)
        figures[f"{count} lying"] = found
        if found < floor:
            faults.append(f"{count} liars: {found} under {floor}")
    alone = liars(1, lies)
    hours = next(hour for hour in range(10_000) if permille(alone, BEGIN + hour * 3_600) >= THETA)
    return Outcome(6 * lies, figures | {"hours until theta again": hours}, tuple(faults))


def _whitewash(settings: Settings) -> Outcome:
    """False reports for an agent: another reporter's bad ones weigh as much as before."""
    lies = 50 if settings.quick else 2_000
    seen = after(NOTHING_REPORTED, (told(WRONG, BEGIN, n) for n in range(5)))
    praised = after(seen, (told(WORK, BEGIN, f"lie {n}", reporter="liar") for n in range(lies)))
    before, found = permille(seen, BEGIN), permille(praised, BEGIN)
    return Outcome(lies, {"before": before, "after": found}, () if found == before else (f"{before} to {found}",))


def _honest(settings: Settings) -> Outcome:
    """An honest agent that gets one number in fifty wrong keeps its trust, day and night."""
    draw, days = random.Random(settings.seed), 2 if settings.quick else 10  # noqa: S311 - draws, no secrets
    state, least = NOTHING_REPORTED, PRIOR
    for n, at in enumerate(range(BEGIN, BEGIN + days * DAY, EVERY_S)):
        state = observe(state, told(SLIP if draw.random() < 0.02 else WORK, at, n), PARAMETERS, now=at)
        least = min(least, permille(state, at))
    faults = () if least >= THETA else (f"fell to {least}",)
    return Outcome(days * DAY // EVERY_S, {"lowest permille": least}, faults)


CAMPAIGNS: Final = (
    Campaign("T-decay", "decay in integers against the real exponential", "within one millionth", _decay),
    Campaign(
        "T-attempts",
        "until trust is below theta",
        f"at most 2 attempts at more authority, {ON_OFF_AT_ONCE} wrongs",
        _attempts,
    ),
    Campaign(
        "T-on-off",
        "a veteran that does wrong whenever it can afford it",
        f"at most {ON_OFF_AT_ONCE} at once and {ON_OFF_A_DAY} a day",
        _on_off,
    ),
    Campaign("T-liars", "reporters that lie against an honest agent", "never below prior s0 / (s0 + n cap)", _liars),
    Campaign("T-whitewash", "a reporter that lies for a bad agent", "no change at all", _whitewash),
    Campaign("T-honest", "an honest agent, one slip in fifty acts", "never below theta", _honest),
)
