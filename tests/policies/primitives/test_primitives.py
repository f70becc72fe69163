"""Every primitive against its case file, and through `decide` with a policy of that primitive alone."""

import tomllib
from dataclasses import replace

import pytest
from capabilities.values.scope import Tier
from policies.decision.combine import Check
from policies.primitives.base import Defers, Fails, Holds
from policies.words.reason_table import REASONS
from tests.policies import world

from policies import (
    ROWS,
    Effect,
    Object,
    Obligation,
    ObligationKind,
    Parameters,
    Policy,
    PolicySet,
    Reason,
    Subject,
    decide,
)
from policies.evidence import shape

FILES = sorted(world.VECTORS.glob("*/*.toml"))
CASES = [
    pytest.param(document["primitive"], case, id=f"{document['primitive']}: {case['says']}")
    for document in (tomllib.loads(path.read_text("utf-8")) for path in FILES)
    for case in document["case"]
]
VERDICTS = {"holds": Holds, "fails": Fails, "defers": Defers}
KINDS = {
    "permit", "deny", "inside", "outside", "missing", "stale", "future", "non-finite", "unit", "type", "empty", "oversized",
    "confusable",
}  # fmt: skip
KEYS = {"says", "kind", "given", "raw", "parameters", "verdict", "reason", "by", "detail", "also", "place"}


def primitive(name, overrides):
    values = {row.name: row.default for row in ROWS[name].parameters}
    assert set(overrides) <= set(values)
    return ROWS[name].make(**{**values, **overrides})


def policy(identity, predicate, points, pit_bound):
    return Policy(
        id=identity,
        subject=Subject(),
        object=Object(),
        predicate=predicate,
        points=points,
        effect=Effect.PERMIT,
        obligations=frozenset({Obligation(ObligationKind.RECORD)}),
        pit_bound=pit_bound,
    )


def set_of(one, *, physical):
    """A set that asks for `one`, and for the impact gate where the case is of a physical act."""
    policies = []
    if one.id != "TEA-4":
        policies.append(policy("one", Check(one), ROWS[one.id].points, None))
    if physical:
        policies.append(policy("gate", Check(ROWS["TEA-4"].make()), ROWS["TEA-4"].points, Tier.SAFETY_CRITICAL))
    return PolicySet("test", 1, tuple(policies), Parameters())


@pytest.mark.parametrize(("name", "spec"), CASES)
def test_case(name, spec):
    one = primitive(name, spec.get("parameters", {}))
    if spec["verdict"] == "malformed":
        assert shape.fault(*world.asked(spec.get("given"), spec["raw"])) == spec["place"]
        return
    assert shape.fault(*world.asked(spec.get("given"))) is None
    verdict = one.judge(world.case(spec.get("given")))
    assert type(verdict) is VERDICTS[spec["verdict"]]
    if spec["verdict"] == "holds":
        assert set(spec) <= {"says", "kind", "given", "parameters", "verdict"}
        return
    first = verdict.findings[0]
    assert (first.reason, first.primitive) == (Reason(spec["reason"]), spec.get("by", name))
    assert first.detail["remedy"] == REASONS[first.reason].remedy
    for key, value in spec.get("detail", {}).items():
        assert first.detail[key] == value, key
    for finding, also in zip(verdict.findings[1:], spec.get("also", []), strict=True):
        assert (finding.reason, finding.primitive) == (Reason(also["reason"]), name)
        assert {"remedy": REASONS[finding.reason].remedy, **also}.items() <= {
            **finding.detail,
            "reason": finding.reason,
        }.items()


@pytest.mark.parametrize(("name", "spec"), CASES)
def test_case_through_the_pdp(name, spec):
    """The finding of a primitive reaches the decision, and nothing that fails or defers is permitted."""
    given = spec.get("given", {})
    request, evidence = world.asked(given, spec.get("raw"))
    # it is asked where it has evidence, too, and at e4 and e5 for the impact
    points = ROWS[name].points if "request.points" not in given else frozenset()
    request = replace(request, points=request.points | points)
    decision = decide(
        request, evidence, set_of(primitive(name, spec.get("parameters", {})), physical=given.get("physical", True))
    )
    if spec["verdict"] == "malformed":
        assert (decision.effect, decision.reason) == (Effect.DENY, Reason.EVIDENCE_MALFORMED)
        assert decision.findings[0].detail["place"] == spec["place"]
        return
    if spec["verdict"] == "holds":
        assert not [f for f in decision.findings if f.primitive == name and name != "TEA-4"]
        return
    severity = {"defers": {Effect.DEFER, Effect.DENY}, "fails": {Effect.DENY}}[spec["verdict"]]
    assert decision.effect in severity
    assert (spec.get("by", name), Reason(spec["reason"])) in {(f.primitive, f.reason) for f in decision.findings}


def test_every_primitive_has_enough_cases():
    """At least: one that holds, one that fails, missing evidence."""
    for path in FILES:
        document = tomllib.loads(path.read_text("utf-8"))
        cases = document["case"]
        assert (path.stem, path.parent.name) == (
            document["primitive"],
            ROWS[path.stem].decides.__module__.rpartition(".")[2],
        )
        assert len({case["says"] for case in cases}) == len(cases)
        assert {"holds", "fails"} <= {case["verdict"] for case in cases}
        assert any(case.get("reason") == "EVIDENCE_MISSING" for case in cases), path
        assert all(set(case) <= KEYS for case in cases)
        without = document.get("without", {})
        kinds = {case["kind"] for case in cases if "kind" in case}
        assert kinds | set(without) == KINDS, path
        assert not kinds & set(without), path


def test_every_reason_of_a_primitive_leads_in_a_case_or_belongs_to_verification():
    """A reason that only a primitive makes has a case in that primitive's own file."""
    made = {r for r in Reason if list(Reason).index(r) >= list(Reason).index(Reason.EVIDENCE_MISSING)}
    for path in FILES:
        cases = tomllib.loads(path.read_text("utf-8"))["case"]
        led = {Reason(case["reason"]) for case in cases if "reason" in case and case.get("by", path.stem) == path.stem}
        own = set(ROWS[path.stem].reasons) & made - {Reason.BUSY, Reason.PERCEPTION_MISSING}
        assert own <= led, path


def plain(value):
    """True where TOML can say the value: it has no null."""
    members = value.values() if isinstance(value, dict) else [value]
    return all(member is not None for member in members)


def test_whatever_a_primitive_says_of_a_reason_is_compared_in_a_case():
    """A word that the holder may rely on stands in a case, and missing evidence is named in each."""
    for path in FILES:
        document = tomllib.loads(path.read_text("utf-8"))
        name, told, compared = document["primitive"], set(), set()
        for spec in (case for case in document["case"] if case["verdict"] in {"fails", "defers"}):
            first = primitive(name, spec.get("parameters", {})).judge(world.case(spec.get("given"))).findings[0]
            if first.primitive == name:
                words = {word for word, value in first.detail.items() if plain(value)} - {"remedy", "clause"}
                told |= {(first.reason, word) for word in words}
                compared |= {(first.reason, word) for word in spec.get("detail", {})}
                assert "evidence" not in words or "evidence" in spec.get("detail", {}), (name, spec["says"])
        assert told <= compared, path
