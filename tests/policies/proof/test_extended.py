"""Sets that extend another one: what they keep still denies, proven by z3 and tried on random cases."""

import random
import time
from dataclasses import replace

import pytest
from policies.decision.extend import at_least_as_strict
from policies.evidence.tiers import runtime_tier
from policies.primitives.base import Case
from policies.proof.case_facts import what_it_says
from policies.proof.claims import EXTENDS
from policies.proof.prover import prove_one
from policies.proof.verdicts import is_known
from policies.words.parameters import MORE_IS_STRICTER, UNORDERED
from tests.model import triples
from tests.policies.proof.test_prove import needs_z3

from policies import PARAMETERS, ROWS, Effect, PolicyError, PolicySet, decide, load, load_shipped, proof

pytestmark = pytest.mark.long

SEVERITY = {Effect.PERMIT: 0, Effect.DEFER: 1, Effect.DENY: 2}
TOOLS, DEFAULT = load_shipped("tools"), load_shipped("paper-default")
HEAD = 'name = "plant"\nversion = 1\nextends = "paper-default"\n'
FORBIDS = """
[[policy]]
id = "guests"
subject = { agents = ["guest"], sponsors = "any" }
object = { ids = "any", operations = "any", without = ["stop"] }
predicate = { not = "AID-2" }
ep = ["e4", "e5"]
effect = "DENY"
obligation = ["record"]
pit_bound = "none"
"""


def standing(policies):
    return prove_one(EXTENDS, policies, harmless=proof.HARMLESS, clock=time.perf_counter)


@needs_z3
@pytest.mark.parametrize(
    "text",
    [
        "",
        "[parameters]\ntrust_theta_permille = 800\nsponsor_age_tier_2_s = 3600\nbehaviour_age_ms = 4000\n",
        '[[replace]]\nid = "impact"\npit_bound = 2\n',
        'remove = ["drift"]\nloosens = ["drift"]\n',
        'loosens = ["trust_theta_permille"]\n[parameters]\ntrust_theta_permille = 100\n',
        FORBIDS,
    ],
)
def test_nothing_that_is_kept_is_lost(text):
    result = standing(load(HEAD + text))
    assert (result.standing, result.claim.id) == (proof.Standing.PROVEN, "P8")


@needs_z3
@pytest.mark.parametrize("lost", ["authority", "impact", "guests"])
def test_a_set_that_loses_what_it_should_have_kept_is_shown_with_a_case(lost):
    """No such set loads; here it is made by hand."""
    whole = load(HEAD + FORBIDS)
    base = replace(whole, floor=None)
    kept = tuple(policy for policy in base.policies if policy.id != lost)
    if lost == "guests":
        # what forbids them says what another one asks of everybody
        kept = tuple(policy for policy in kept if policy.id != "authority")
        base = PolicySet("base", 1, tuple(p for p in base.policies if p.id != "authority"), base.parameters)
    result = standing(PolicySet("loses", 1, kept, whole.parameters, base))
    assert result.standing is proof.Standing.BROKEN
    (shown,) = result.counterexample
    told = shown.told
    assert decide(told.request, told.evidence, told.policies).effect is Effect.PERMIT
    assert decide(told.request, told.evidence, base).effect is not Effect.PERMIT


@needs_z3
def test_a_laxer_number_is_shown_with_a_case():
    lax = replace(DEFAULT.parameters, trust_theta_permille=100)
    own = load(HEAD + 'loosens = ["trust_theta_permille"]\n[parameters]\ntrust_theta_permille = 100\n')
    assert own.parameters == lax
    result = standing(PolicySet(own.name, 1, own.policies, lax, DEFAULT))
    assert result.standing is proof.Standing.BROKEN


def test_a_set_that_extends_none_is_not_asked():
    assert [claim.id for claim in proof.claims_of(DEFAULT)] == [claim.id for claim in proof.CLAIMS]
    assert [claim.id for claim in proof.claims_of(load(HEAD))][-1] == "P8"


def drawn(pick, base):
    """An extension that the loader takes, or None: numbers moved, parts replaced, by chance laxer."""
    numbers = pick([[], [pick([*PARAMETERS])], [pick([*PARAMETERS]), pick([*PARAMETERS])]])
    parts = []
    for name in dict.fromkeys(numbers):
        row, was = PARAMETERS[name], getattr(base.parameters, name)
        parts.append(f"{name} = {pick([row.low, max(row.low, was // 2), min(row.high, was * 2), row.high])}")
    policy = pick(base.policies)
    changed = pick(
        [
            "", "pit_bound = 2", "pit_bound = 4", 'ep = ["e4", "e5"]', 'ep = ["e5"]', 'effect = "DENY"',
            'predicate = { all = ["AID-1", "TEA-1"] }', 'predicate = { all = ["AID-1", "TEA-1", "TEA-2"] }',
            'object = { ids = "any", operations = "any" }', 'object = { ids = "any", operations = ["move_joint"] }',
            'subject = { agents = ["planner"], sponsors = "any" }',
        ]
    )  # fmt: skip
    replaced = f'[[replace]]\nid = "{policy.id}"\n{changed}\n' if changed else ""
    numbered = "[parameters]\n" + "\n".join(parts) + "\n" if parts else ""
    try:
        return load(f'name = "own"\nversion = 1\nextends = "{base.name}"\n{numbered}{replaced}')
    except PolicyError:
        return None


def cases(pick, base):
    """Random cases, half of them not denied by the base."""
    denied, others = [], []
    while len(others) < 60:
        request, evidence = triples.request(pick), replace(triples.evidence(pick), approval=None)
        effect = decide(request, evidence, base).effect
        (denied if effect is Effect.DENY else others).append((request, evidence, effect))
    return [*others, *denied[:60]]


def test_what_loads_without_loosening_is_nowhere_milder():
    """Thirty extensions that chance makes and the loader takes, on random cases each."""
    pick = random.Random(19).choice
    taken, refused, stricter_somewhere = 0, 0, 0
    tried = {base.name: cases(pick, base) for base in (TOOLS, DEFAULT)}
    while taken < 30:
        base = pick([TOOLS, DEFAULT])
        own = drawn(pick, base)
        if own is None:
            refused += 1
            continue
        taken += 1
        for request, evidence, before in tried[base.name]:
            after = decide(request, evidence, own).effect
            assert SEVERITY[after] >= SEVERITY[before], (own.parameters, own.policies, request, evidence)
            stricter_somewhere += SEVERITY[after] > SEVERITY[before]
    assert refused > 10
    assert stricter_somewhere > 10


def test_a_primitive_of_stricter_numbers_fails_wherever_the_laxer_one_does():
    """The law that the proof takes for granted of primitives without a formula."""
    pick, seen = random.Random(5).choice, 0
    for row in ROWS.values():
        if not row.parameters or is_known(row.make(**{p.name: p.default for p in row.parameters})):
            continue
        for _ in range(150):
            lax = {p.name: pick([p.default, p.high]) for p in row.parameters}
            if row.id in ("CII-5",):
                lax = dict.fromkeys(lax, pick([2, 4]))
            tight = {n: v if n in UNORDERED else (v + 1 if n in MORE_IS_STRICTER else v // 2) for n, v in lax.items()}
            one, other = row.make(**lax), row.make(**tight)
            assert at_least_as_strict(one, other)
            request, evidence = triples.request(pick), triples.evidence(pick)
            case = Case(request, evidence, True, runtime_tier(evidence, physical=True))
            before, after = what_it_says(one, case), what_it_says(other, case)
            assert not after.holds or before.holds, (row.id, lax, tight)
            assert not before.fails or after.fails or after.raises, (row.id, lax, tight)
            seen += before.holds and not after.holds
    assert seen > 0
