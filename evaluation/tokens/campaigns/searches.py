"""Campaigns A1, A2 and A5, and the proof of the lattice, as rows of the registry."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING, Final

from evaluation.harness.campaign import Campaign, Outcome, Skipped
from evaluation.tokens.campaigns import attenuation, encodings, injection, mutants

if TYPE_CHECKING:
    from evaluation.harness.campaign import Settings

QUICK_MUTANTS: Final = 5_000
QUICK_PAIRS: Final = 4_000
QUICK_EVERY: Final = 97
"""Step through the spellings of a quick run; a prime, so that no byte or value is always left out."""


def _mutants(settings: Settings) -> Outcome:
    found = mutants.run(QUICK_MUTANTS if settings.quick else mutants.COUNT, settings.seed)
    tally = found.tally
    figures = {
        "accepted": len(tally.accepted),
        "stray exceptions": len(tally.stray),
        "over 50 ms": tally.slow,
        "worst_ms": round(tally.worst_ms, 1),
        "worst_processor_ms": round(tally.worst_cpu_ms, 1),
        "pauses": tally.paused,
        "memory_mib": round(tally.growth_mib, 1),
    }
    return Outcome(sum(tally.tried.values()), figures, found.missed)


def _encodings(settings: Settings) -> Outcome:
    found = encodings.run(settings.seed, every=QUICK_EVERY if settings.quick else 1)
    figures = {"accepted": len(found.accepted), "stray exceptions": len(found.stray)}
    return Outcome(sum(found.tried.values()), figures, found.missed)


def _attenuation(settings: Settings) -> Outcome:
    found = attenuation.run(QUICK_PAIRS if settings.quick else attenuation.COUNT, settings.seed)
    texts = injection.run(settings.seed)
    tally = found.tally
    figures = {
        "widened": len(tally.widened),
        "texts injected": len(texts.injected),
        "opinions parted": len(tally.parted),
        "forged hops judged wrong": len(tally.wrong),
        "chains": sum(tally.chains.values()),
        "answers of Biscuit": tally.by_biscuit,
        "answers of the issuer": tally.by_issuing,
        "forged hops": sum(tally.forged.values()),
        "hostile texts": sum(texts.carried.values()) + sum(texts.refused.values()),
        "fewest pairs of a dimension": min(tally.pairs.values(), default=0),
    }
    return Outcome(sum(tally.pairs.values()), figures, (*found.missed, *texts.missed))


def _lattice(settings: Settings) -> Outcome | Skipped:
    if importlib.util.find_spec("z3") is None:
        return Skipped("z3-solver is not installed")
    from evaluation.tokens.campaigns import lattice

    claims = lattice.BOUNDS[:1] if settings.quick else (*lattice.BOUNDS, *lattice.WORDS, *lattice.SCOPES)
    laws = [lattice.prove_one(claim) for claim in claims]
    missed = tuple(f"{law}: {verdict}" for law, verdict, _ in laws if verdict != lattice.PROVEN)
    return Outcome(len(laws), {"not proven": len(missed)}, missed)


MUTANTS: Final = Campaign("A1", "mutants of 22 shapes of tokens", "0 accepted, 0 stray, none over 50 ms", _mutants)
ENCODINGS: Final = Campaign("A2", "every other spelling of two tokens", "0 accepted", _encodings)
ATTENUATION: Final = Campaign(
    "A5", "chains and requests at their boundaries; hostile texts", "0 widened, 0 injected", _attenuation
)
LATTICE: Final = Campaign("Z3", "laws of the scope algebra over all integers and texts", "every one proven", _lattice)
