"""A result as plain JSON values, and as lines that a person reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capabilities.values.chain import Chain
from policies.evidence.case_json import to_plain

if TYPE_CHECKING:
    from collections.abc import Iterator

    from policies.proof.prover import CounterexampleCase, Result


def result_to_plain(result: Result) -> dict[str, object]:
    """Plain JSON of a result. Each case of a counterexample has the form of `policies.evidence.case_json`."""
    return {
        "id": result.claim.id,
        "says": result.claim.says,
        "standing": str(result.standing),
        "seconds": round(result.seconds, 3),
        "about_nothing": result.about_nothing,
        "assumed": list(result.assumed),
        "counterexample": [_shown_to_plain(shown) for shown in result.counterexample],
    }


def _shown_to_plain(shown: CounterexampleCase) -> dict[str, object]:
    told = shown.told
    return {
        "departures": [{"what": what, "value": _plain(value)} for what, value in shown.departures],
        "case": to_plain(told.request, told.evidence),
        "policies": {
            "digest": told.policies.digest,
            "policies": [policy.id for policy in told.policies.policies],
        },
        "decision": {
            "effect": str(told.decision.effect),
            "reason": str(told.decision.reason),
            "primitive": told.decision.primitive,
            "tier": None if told.decision.tier is None else int(told.decision.tier),
            "approval": None if told.decision.approval is None else told.decision.approval.ask_id,
        },
    }


def _plain(value: object) -> object:
    return value if isinstance(value, bool | int | str) else str(value)


def lines(result: Result) -> Iterator[str]:
    """Text of a counterexample: each request, its strange evidence, and its decision."""
    for number, shown in enumerate(result.counterexample):
        request, decision = shown.told.request, shown.told.decision
        points = "+".join(sorted(str(point) for point in request.points))
        yield f"{request.object}/{request.operation} at {points}, {_caller(shown)}"
        if not shown.departures:
            yield "  on evidence in which nothing is strange" if number == 0 else "  on the same evidence"
        for what, value in shown.departures:
            yield f"  {what}: {_word(value)}"
        if number and result.claim.compares == "a policy":
            yield f"  with one more policy: {_added(result)}"
        tier = "no tier known" if decision.tier is None else f"tier {int(decision.tier)}"
        yield f"  -> {decision.effect} {decision.reason}, {tier}"


def _caller(shown: CounterexampleCase) -> str:
    chain = shown.told.evidence.chain
    if not isinstance(chain, Chain):
        return "by nobody who is known"
    return f"by {chain.leaf.agent} for {chain.sponsor.subject}"


def _word(value: object) -> str:
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)


def _added(result: Result) -> str:
    before, after = (shown.told.policies.policies for shown in result.counterexample)
    return ", ".join(repr(policy.predicate) for policy in after if policy not in before)
