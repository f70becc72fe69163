"""Proofs about policy sets: for every request and all evidence, or a counterexample that `decide` confirms.

What is proven, under which abstraction, and what is not: docs/policies.md, "Proof". z3 is needed to prove, and is
imported when a proof begins; everything else here, and `policies`, runs without it.

    facts      what a decision depends on, some fifty truths and numbers
    observe    the facts of a real case               concrete   a real case with given facts
    verdicts   what primitives say of facts           outcome    what a set decides on facts
    laws       what is true of the facts of any case  claims     the seven claims, over outcomes
    search     looks for cases, with z3               shown      the claims again, over real decisions
    prover     all of it together                      telling  results as JSON values and lines
"""

from policies.proof.claims import CLAIMS, Claim
from policies.proof.prover import HARMLESS, CounterexampleCase, Result, Standing, prove
from policies.proof.result_text import lines, result_to_plain

__all__ = [
    "CLAIMS",
    "HARMLESS",
    "Claim",
    "CounterexampleCase",
    "Result",
    "Standing",
    "lines",
    "prove",
    "result_to_plain",
]
