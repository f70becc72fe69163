"""Proofs about policy sets: for every request and all evidence, or a counterexample that `decide` confirms.

Scope and abstraction of the proofs: docs/policies.md, "Proof". z3 is needed to prove, and is imported when a proof
begins; everything else here, and `policies`, runs without it.

    facts       facts of a decision, some fifty truths and numbers
    case_facts  the facts of a real case              concrete_cases  a real case with given facts
    verdicts    answers of primitives on facts        outcome         decision of a set on facts
    laws        truths about the facts of any case    claims          the claims, over outcomes
    search      looks for cases, with z3              confirmation    the claims again, over real decisions
    prover      all of it together                    result_text     results as JSON values and lines
"""

from policies.proof.claims import CLAIMS, EXTENDS, Claim, claims_of
from policies.proof.prover import HARMLESS, CounterexampleCase, Result, Standing, prove
from policies.proof.result_text import lines, result_to_plain

__all__ = [
    "CLAIMS",
    "EXTENDS",
    "HARMLESS",
    "Claim",
    "CounterexampleCase",
    "Result",
    "Standing",
    "claims_of",
    "lines",
    "prove",
    "result_to_plain",
]
