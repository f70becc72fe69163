"""Bad evidence permits nothing: every primitive against every kind of badness, in the places where that primitive looks.

A cell is a primitive and a kind. Each draw begins with a case that this primitive permits, makes one place bad, and must not be permitted
any more. Where a primitive looks at no value that could be bad in that way, the bad value stands in the place of the whole reading.
"""

import os
import random
import unicodedata
from dataclasses import replace

import pytest
from capabilities.values.errors import Fault, FaultCode
from policies.primitives.base import Holds
from tests.policies import world
from tests.policies.primitives.test_primitives import primitive, set_of

from policies import NOT_COLLECTED, ROWS, Effect, ImpactFault, decide

DRAWS = int(os.environ.get("ZTPM_BAD_DRAWS", "20"))
HOPS, SCOPE = "evidence.chain.hops", "evidence.chain.hops.1.scope"
ITEMS = "evidence.context.items"

READINGS = {
    **{f"AID-{n}": ["evidence.chain"] for n in range(1, 6)},
    **dict.fromkeys(("CATP-2", "CATP-4"), ["evidence.chain"]),
    **dict.fromkeys(("CII-2", "CII-3", "CII-5"), ["evidence.context"]),
    **dict.fromkeys(("TEA-1", "TEA-2"), ["evidence.chain", "evidence.request_fault"]),
    **dict.fromkeys(("CATP-1", "CATP-3"), ["evidence.trust"]),
    **dict.fromkeys(("ABG-1", "ABG-2", "ABG-3", "ABG-4"), ["evidence.behaviour", "evidence.chain"]),
    "CII-1": ["evidence.instruction"],
    "CII-4": ["evidence.perception"],
    "CII-6": ["evidence.message"],
    "TEA-3": ["evidence.tool"],
    "TEA-4": ["evidence.impact", "evidence.tool", "evidence.chain"],
    "TEA-5": ["evidence.robot"],
    "TEA-6": ["evidence.sequence", "evidence.chain"],
}  # fmt: skip
"""The readings without which a primitive says no."""

NUMBERS = {
    "AID-1": [f"{HOPS}.1.attestation.at"],
    "AID-2": ["evidence.chain.sponsor.authenticated_at"],
    "AID-3": ["evidence.chain.view_age_ms"],
    "AID-5": [f"{SCOPE}.not_after"],
    "CII-1": ["evidence.instruction.signed_at"],
    "CII-3": [f"{ITEMS}.0.manifest_age_s"],
    "CII-6": ["evidence.message.age_s"],
    "TEA-4": ["evidence.impact.index_milli"],
    "TEA-5": ["evidence.robot.payload_g", "evidence.robot.robot_mode", "evidence.robot.safety_mode"],
    "TEA-6": ["evidence.sequence.drift_urad", "evidence.sequence.alternations"],
    "CATP-1": ["evidence.trust.edges.0.score_permille", "evidence.trust.edges.1.score_permille"],
    "CATP-3": ["evidence.trust.score_permille"],
    "CATP-4": [f"{HOPS}.0.attestation.at", f"{HOPS}.1.attestation.at"],
    **dict.fromkeys(("ABG-1", "ABG-2", "ABG-3", "ABG-4"), ["evidence.behaviour.age_ms"]),
}
"""Bounded numbers that it looks at."""

TIMES = {name: paths for name, paths in NUMBERS.items() if name in {"AID-1", "AID-2", "CII-1", "CATP-4"}}
"""Those of them that are instants."""
AGES = {name: paths for name, paths in NUMBERS.items() if name in {"AID-3", "CII-3", "CII-6"} or name[:3] == "ABG"}
"""Those of them that are ages."""

TEXTS = {
    "AID-5": ["request.audience"],
    "CII-1": ["evidence.instruction.bound_digest"],
    "CII-4": ["evidence.perception.sensors.0.state", "evidence.perception.sensors.1.state"],
    "CII-5": ["evidence.context.arguments.0.name", "evidence.context.arguments.1.name"],
    "TEA-3": ["evidence.tool.actual_digest", "evidence.tool.approved_digest"],
    "TEA-4": ["evidence.impact.perception"],
    "CATP-1": ["evidence.trust.edges.0.delegate", "evidence.trust.edges.1.delegator"],
    **dict.fromkeys(("ABG-1", "ABG-2", "ABG-3", "ABG-4"), ["evidence.behaviour.agent"]),
}
"""Texts that it compares."""

FRAMES = {
    "TEA-5": ("evidence.robot.frames_match", False),
    "TEA-4": ("evidence.impact", ImpactFault("PHYSICS_FAULT", "another frame")),
    "CII-4": ("evidence.perception.sensors.0.state", "invalid"),
}
"""Reading that a wrong frame leads to, by primitive."""

EMPTIES = {
    "CII-1": ("evidence.instruction.intent_digest", ""),
    "CII-2": (ITEMS, ()),
    "CII-3": (ITEMS, ()),
    "CII-4": ("evidence.perception.sensors", ()),
    "CII-5": ("evidence.context.arguments", ()),
    "CATP-1": ("evidence.trust.edges", ()),
    "TEA-3": ("evidence.tool.approved_digest", ""),
    "AID-2": ("evidence.chain.sponsor.subject", ""),
    "AID-5": (f"{SCOPE}.audiences", frozenset()),
}

STALE = Fault(FaultCode.REVOCATION_VIEW_STALE, "TOK-9")
MIB = 1 << 20


def permitted(name):
    """A request and evidence that the primitive alone, with the impact gate, permits; and the set."""
    request, evidence = world.asked()
    return {"request": request, "evidence": evidence}, set_of(primitive(name, {}), physical=True), ROWS[name].points


def old(value, path, chance):
    by = chance.randint(10_000_000, 1_000_000_000)
    return value + by if path in sum(AGES.values(), []) else value - by


def texts(change):
    """Makes a text bad; any other place gets the bad text itself."""
    return lambda value, _path, chance: change(value if isinstance(value, str) else "caf\u00e9", chance)


def number(make):
    return lambda value, _path, chance: make(value if type(value) is int else 7, chance)


def homoglyph(text, chance):
    alike = {"a": "\u0430", "e": "\u0435", "o": "\u043e", "c": "\u0441", "p": "\u0440", "d": "\u0501", "s": "\u0455"}
    places = [n for n, letter in enumerate(text) if letter in alike]
    n = chance.choice(places) if places else None
    return text + "\u0430" if n is None else text[:n] + alike[text[n]] + text[n + 1 :]


def fixed(*values):
    return lambda _value, _path, chance: chance.choice(values)


KINDS = {
    "missing": (READINGS, fixed(NOT_COLLECTED)),
    "stale": ({**TIMES, **AGES}, old),
    "future": ({**TIMES, **AGES}, lambda value, path, chance: old(value, path, chance) * -1),
    "wrong type": (READINGS, fixed("x", b"x", 1, True, (), [], {}, object(), 1j)),
    "NaN": (NUMBERS, fixed(float("nan"))),
    "+inf": (NUMBERS, fixed(float("inf"))),
    "-inf": (NUMBERS, fixed(float("-inf"))),
    "subnormal": (NUMBERS, fixed(5e-324, 2.2e-308, 1e-310)),
    "-0.0": (NUMBERS, fixed(-0.0)),
    "negative": (NUMBERS, number(lambda value, chance: -chance.randint(10, 2**31))),
    "2^31": (NUMBERS, fixed(2**31)),
    "2^53+1": (NUMBERS, fixed(2**53 + 1)),
    "2^63": (NUMBERS, fixed(2**63)),
    "unit x 10^3": (NUMBERS, number(lambda value, chance: value * 1_000 or 1_000_000)),
    "degree as radian": (NUMBERS, number(lambda value, chance: value * 57.29577951308232 or 57.29577951308232)),
    "wrong frame": ({name: [path] for name, (path, _) in FRAMES.items()}, None),
    "empty": ({name: [path] for name, (path, _) in EMPTIES.items()}, None),
    "1 MiB": (TEXTS, texts(lambda text, chance: text + chance.choice("xyz") * MIB)),
    "duplicate key": (READINGS, fixed((("state", "fresh"), ("state", "fresh")), [("at", 1), ("at", 2)])),
    "NFD": (TEXTS, texts(lambda text, chance: unicodedata.normalize("NFD", text + chance.choice("\u00e9\u00fc\u00f1")))),
    "bidi": (TEXTS, texts(lambda text, chance: chance.choice("\u202e\u2066\u200f") + text)),
    "confusable": (TEXTS, texts(homoglyph)),
}  # fmt: skip


def place_of(name, kind, chance):
    """Place in this draw, and whether it is one of that kind of value."""
    own = KINDS[kind][0].get(name)
    return (chance.choice(own), True) if own else (chance.choice(READINGS[name]), False)


def value_at(both, path):
    first, *steps = path.split(".")
    value = both[first]
    for step in steps:
        value = value[int(step)] if isinstance(value, tuple) else getattr(value, step)
    return value


def bad_value(name, kind, path, own, value, chance):
    if kind in {"wrong frame", "empty"}:
        table = FRAMES if kind == "wrong frame" else EMPTIES
        return table[name][1] if own else ("" if kind == "empty" else chance.choice(["tool0", "base", "flange"]))
    if kind in {"stale", "future"} and not own:
        # what is out of time is marked as a fault, or is not collected at all
        return STALE if path == "evidence.chain" else NOT_COLLECTED
    return KINDS[kind][1](value, path, chance)


def draw(name, kind, chance):
    """The decision on a case in which one place is bad, and what was made of it."""
    both, policies, points = permitted(name)
    both["request"] = replace(both["request"], points=both["request"].points | points)
    assert decide(both["request"], both["evidence"], policies).effect is Effect.PERMIT
    path, own = place_of(name, kind, chance)
    bad = bad_value(name, kind, path, own, value_at(both, path), chance)
    first, *steps = path.split(".")
    both[first] = world.put(both[first], steps, bad)
    return decide(both["request"], both["evidence"], policies), (path, bad)


def test_the_matrix_is_of_25_primitives_and_22_kinds():
    assert set(READINGS) == set(ROWS)
    assert len(KINDS) == 22


def test_the_matrix_sees_a_decision_that_does_not_look_at_shapes(monkeypatch):
    monkeypatch.setattr("policies.evidence.shape.fault", lambda request, evidence: None)
    chance = random.Random(1)
    permitted_draws = sum(draw("TEA-6", "-0.0", chance)[0].effect is Effect.PERMIT for _ in range(20))
    assert permitted_draws == 20


def test_the_matrix_sees_a_primitive_that_does_not_look(monkeypatch):
    kind = ROWS["CII-6"].decides
    monkeypatch.setattr(kind, "_reading", lambda self, message: Holds())
    chance = random.Random(1)
    assert any(draw("CII-6", "stale", chance)[0].effect is Effect.PERMIT for _ in range(20))


@pytest.mark.parametrize("name", ROWS)
def test_bad_evidence_is_not_permitted(name):
    for kind in KINDS:
        chance = random.Random(f"{name} {kind}")
        for _ in range(DRAWS):
            decision, (path, bad) = draw(name, kind, chance)
            assert decision.effect is not Effect.PERMIT, (kind, path, repr(bad)[:80])
            assert decision.reason, kind
