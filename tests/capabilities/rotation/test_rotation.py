"""Keys over time: every step of the ring, and one whole rotation of each role as verifiers live through it."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from capabilities.keys.trust import TrustBundle
from capabilities.keys.windows import KEYS_OF_A_ROLE, Role
from capabilities.rotation.rotation import KeyRecord, KeyRing, KeyState, RotationFault, RotationRefused
from capabilities.rotation.rotation_json import ring_from_json, ring_to_json
from capabilities.rotation.succession import check_bundle, ring_follows, succeed
from capabilities.token.delegate import delegate
from capabilities.token.mint import mint
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Attestation, Chain, EvidenceKind
from capabilities.values.errors import BadKeyError, Fault, FaultCode
from hypothesis import given
from hypothesis import strategies as st
from tests.capabilities.keys.test_keys import curve_of
from tests.capabilities.world import (
    ISSUER,
    NOW,
    SCOPE,
    SLOWER,
    SPONSOR,
    TOKEN_ID,
    check,
    grant_to,
    key_of,
    raw_of,
)

from capabilities.keys import keys
from capabilities.rotation import rotation
from capabilities.statements import trust as trust_bundle

pytestmark = pytest.mark.clause("TRB-6")

OVERLAP = DEFAULT.lifetime_s + DEFAULT.skew_s
FIRST = {role: raw_of(f"first {role}") for role in Role}
RING = rotation.begin(ISSUER, FIRST, at=NOW)


def stepped(ring: KeyRing | RotationRefused) -> KeyRing:
    assert isinstance(ring, KeyRing), ring
    return ring


def rotated(ring: KeyRing, role: Role, name: str, at: int) -> KeyRing:
    """Prepared and activated in one breath."""
    ring = stepped(rotation.prepare(ring, role, raw_of(name), at=at))
    return stepped(rotation.activate(ring, ring.records[-1].id, at=at))


def why(answer: KeyRing | RotationRefused) -> RotationFault:
    assert isinstance(answer, RotationRefused), answer
    return answer.why


# --- steps -----------------------------------------------------------------------------------------------------------------


def test_a_new_ring_signs_in_every_role():
    assert (RING.version, [record.id for record in RING.records]) == (
        1,
        ["root-1", "attester-1", "feed-1", "registry-1", "ledger-1"],
    )
    for role in Role:
        assert RING.active(role).key == FIRST[role]
    bundle = RING.bundle(DEFAULT)
    assert bundle.roots == {1: FIRST[Role.ROOT]}
    assert (bundle.version, bundle.issued_at, bundle.valid_until) == (1, NOW, NOW + rotation.BUNDLE_LIFETIME_S)


@pytest.mark.parametrize("role", Role)
def test_a_key_goes_through_its_life(role):
    ring = stepped(rotation.prepare(RING, role, raw_of("second"), at=NOW + 10))
    second = ring.records[-1]
    assert (second.state, second.number, ring.active(role).key) == (KeyState.PREPARED, 2, FIRST[role])
    assert ring.bundle(DEFAULT).of_role(role) == {FIRST[role], raw_of("second")}, "trusted before it signs"

    ring = stepped(rotation.activate(ring, second.id, at=NOW + 20))
    first = ring.records[[r.key for r in ring.records].index(FIRST[role])]
    assert (first.state, ring.active(role).key) == (KeyState.RETIRED, raw_of("second"))
    assert ring.bundle(DEFAULT).windows[FIRST[role]].not_after == NOW + 20 + OVERLAP
    assert ring.bundle(DEFAULT).windows[raw_of("second")].not_after == NOW + 20 + rotation.BUNDLE_LIFETIME_S

    tainted = stepped(rotation.taint(ring, first.id, at=NOW + 30))
    assert tainted.find(first.id).state is KeyState.TAINTED
    assert tainted.bundle(DEFAULT).windows[FIRST[role]].tainted_at == NOW + 30

    for before in (ring, tainted):
        revoked = stepped(rotation.revoke(before, first.id, at=NOW + 40))
        assert revoked.find(first.id).state is KeyState.REVOKED
        assert revoked.bundle(DEFAULT).of_role(role) == {raw_of("second")}
        assert FIRST[role] in revoked.all_keys
    assert [r.version for r in (ring, tainted, revoked)] == [3, 4, 5]

    later = stepped(rotation.renew(ring, at=NOW + 20 + OVERLAP - 1))
    assert FIRST[role] in later.bundle(DEFAULT).of_role(role)
    later = stepped(rotation.renew(ring, at=NOW + 20 + OVERLAP))
    assert later.bundle(DEFAULT).of_role(role) == {raw_of("second")}, "the overlap is over"


def ring_with(state: KeyState) -> tuple[KeyRing, str]:
    """A ring with an attester of the state."""
    ring = stepped(rotation.prepare(RING, Role.ATTESTER, raw_of("second"), at=NOW + 1))
    if state is KeyState.PREPARED:
        return ring, "attester-2"
    ring = stepped(rotation.activate(ring, "attester-2", at=NOW + 2))
    if state is KeyState.ACTIVE:
        return ring, "attester-2"
    if state is KeyState.TAINTED:
        ring = stepped(rotation.taint(ring, "attester-1", at=NOW + 3))
    if state is KeyState.REVOKED:
        ring = stepped(rotation.revoke(ring, "attester-1", at=NOW + 3))
    return ring, "attester-1"


VERBS = {"activate": rotation.activate, "taint": rotation.taint, "revoke": rotation.revoke}
ALLOWED = {
    ("activate", KeyState.PREPARED): KeyState.ACTIVE,
    ("taint", KeyState.RETIRED): KeyState.TAINTED,
    ("revoke", KeyState.PREPARED): KeyState.REVOKED,
    ("revoke", KeyState.RETIRED): KeyState.REVOKED,
    ("revoke", KeyState.TAINTED): KeyState.REVOKED,
}


@pytest.mark.parametrize("state", KeyState)
@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_in_every_state(verb, state):
    ring, id_ = ring_with(state)
    assert ring.find(id_).state is state
    answer = VERBS[verb](ring, id_, at=NOW + 9)
    if (verb, state) in ALLOWED:
        assert stepped(answer).find(id_).state is ALLOWED[verb, state]
        assert answer.version == ring.version + 1
    elif state is KeyState.ACTIVE and verb != "activate":
        assert why(answer) is RotationFault.STILL_ACTIVE
    else:
        assert why(answer) is RotationFault.WRONG_STATE
    assert why(VERBS[verb](ring, "attester-9", at=NOW + 9)) is RotationFault.KEY_UNKNOWN
    if (verb, state) in ALLOWED:
        assert why(VERBS[verb](ring, id_, at=ring.issued_at - 1)) is RotationFault.CLOCK_BACKWARDS


def test_no_key_comes_back():
    ring, _ = ring_with(KeyState.REVOKED)
    for raw in (FIRST[Role.ATTESTER], raw_of("second"), FIRST[Role.FEED]):
        for role in Role:
            assert why(rotation.prepare(ring, role, raw, at=NOW + 9)) is RotationFault.KEY_IN_USE
    with pytest.raises(BadKeyError):
        rotation.prepare(ring, Role.ROOT, bytes(32), at=NOW + 9)


def test_one_prepared_key_at_a_time_and_not_too_many():
    ring, _ = ring_with(KeyState.PREPARED)
    assert why(rotation.prepare(ring, Role.ATTESTER, raw_of("third"), at=NOW + 9)) is RotationFault.ALREADY_PREPARED
    assert why(rotation.prepare(ring, Role.ROOT, raw_of("third"), at=NOW)) is RotationFault.CLOCK_BACKWARDS
    ring = RING
    for n in range(KEYS_OF_A_ROLE - 1):
        ring = rotated(ring, Role.ROOT, f"root {n}", NOW + n)
    assert len(ring.bundle(DEFAULT).roots) == KEYS_OF_A_ROLE
    assert why(rotation.prepare(ring, Role.ROOT, raw_of("more"), at=NOW + 99)) is RotationFault.TOO_MANY_KEYS
    ring = stepped(rotation.revoke(ring, "root-1", at=NOW + 99))
    assert (
        stepped(rotation.prepare(ring, Role.ROOT, raw_of("more"), at=NOW + 99)).records[-1].number == KEYS_OF_A_ROLE + 1
    )


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["prepare", "renew", *VERBS]),
            st.sampled_from(Role),
            st.integers(1, 4),
            st.integers(0, 50_000),
        ),
        max_size=25,
    )
)
def test_any_steps_leave_a_ring_that_can_be(steps):
    """Any steps in any order keep one signer a role, no way back, and growing versions and times."""
    ring, at, prepared = RING, NOW, 0
    for verb, role, number, wait in steps:
        at += wait
        before = ring
        if verb == "prepare":
            prepared += 1
            answer = rotation.prepare(ring, role, raw_of(f"new {prepared}"), at=at)
        elif verb == "renew":
            answer = rotation.renew(ring, at=at)
        else:
            answer = VERBS[verb](ring, f"{rotation.ID_STEM[role]}-{number}", at=at)
        if isinstance(answer, RotationRefused):
            continue
        ring = answer
        assert ring_from_json(ring_to_json(ring)) == ring
        bundle = ring.bundle(DEFAULT)
        assert TrustBundle.from_json(bundle.to_json()) == bundle
        assert (ring.version, bundle.version) == (before.version + 1, ring.version)
        for record in ring.records:
            live = record.key in bundle.all_keys
            assert live or record.state in {KeyState.RETIRED, KeyState.TAINTED, KeyState.REVOKED}
            assert not (live and record.state is KeyState.REVOKED)
            earlier = before.find(record.id)
            assert earlier is None or list(KeyState).index(record.state) >= list(KeyState).index(earlier.state)
        # What is published follows what was published, signed by the key that signed then.
        signer = {raw_of(f"new {n}"): key_of(f"new {n}") for n in range(prepared + 1)} | {
            FIRST[Role.REGISTRY]: key_of(f"first {Role.REGISTRY}")
        }
        text = trust_bundle.sign(bundle, signer[before.active(Role.REGISTRY).key])
        old = before.bundle(DEFAULT)
        if at < old.valid_until and before.active(Role.REGISTRY).key in bundle.registry:
            assert succeed(old, text, at=at, caps=DEFAULT) == bundle


# --- as JSON ---------------------------------------------------------------------------------------------------------------


def test_a_ring_comes_back_in_one_spelling():
    ring, _ = ring_with(KeyState.REVOKED)
    ring = stepped(rotation.prepare(ring, Role.ROOT, keys.public_raw(curve_of("root")), at=NOW + 9))
    assert ring_from_json(ring_to_json(ring)) == ring
    assert ring_to_json(ring_from_json(ring_to_json(ring))) == ring_to_json(ring)


def test_a_ring_that_cannot_be_is_refused():
    ring, _ = ring_with(KeyState.TAINTED)
    good = json.loads(ring_to_json(ring))
    first = good["keys"][0]
    changes = [
        {"extra": 1}, {"issuer": "x"}, {"version": 0}, {"version": True}, {"issued_at": -1}, {"issued_at": NOW},
        {"keys": []}, {"keys": {}}, {"keys": good["keys"] * 2}, {"keys": good["keys"][1:]},
        *({"keys": [{**first, **change}, *good["keys"][1:]]} for change in (
            {"role": "agents"}, {"number": -1}, {"number": 2**32}, {"key": ""}, {"key": good["keys"][1]["key"]},
            {"prepared_at": None}, {"activated_at": None}, {"activated_at": NOW - 1}, {"retired_at": NOW},
            {"tainted_at": NOW}, {"revoked_at": NOW}, {"prepared_at": NOW + 10**6}, {"more": 1},
            {"activated_at": None, "revoked_at": NOW}, {"role": "attesters"}, {"role": "attesters", "number": 9},
        )),
    ]  # fmt: skip
    for change in changes:
        with pytest.raises(BadKeyError):
            ring_from_json(json.dumps({**good, **change}).encode())
    for raw in (b"", b"[]", b"{}", b"\xff", ring_to_json(ring)[:-1]):
        with pytest.raises(BadKeyError):
            ring_from_json(raw)


@pytest.mark.parametrize(
    "steps",
    [
        {"retired_at": 9},
        {"tainted_at": 9},
        {"activated_at": 6, "tainted_at": 9},
        {"activated_at": 6, "revoked_at": 9},
        {"activated_at": 4},
        {"activated_at": 8, "retired_at": 7},
        {"activated_at": 6, "retired_at": 9, "revoked_at": 8},
    ],
)
def test_a_key_takes_its_steps_in_order(steps):
    with pytest.raises(BadKeyError) as caught:
        KeyRecord(Role.ROOT, 1, raw_of("x"), 5, **steps)
    assert caught.value.code is FaultCode.KEY_MALFORMED


# --- a whole rotation ------------------------------------------------------------------------------------------------------


def lent(ring: KeyRing, root: str, attester: str, at: int) -> bytes:
    """alice -> orchestrator -> robotic, with the keys that sign at `at`."""
    assert (ring.active(Role.ROOT).key, ring.active(Role.ATTESTER).key) == (raw_of(root), raw_of(attester))
    proven = Attestation(EvidenceKind.KEY, b"\2" * 32, at)
    scope = replace(SCOPE, not_before=at, not_after=at + DEFAULT.key_evidence_lifetime_s)
    token = mint(
        root=key_of(root), root_key_id=ring.active(Role.ROOT).number, token_id=TOKEN_ID,
        sponsor=replace(SPONSOR, authenticated_at=at), hop=grant_to("orchestrator", "alice", attestation=proven),
        scope=scope, caps=DEFAULT,
    )  # fmt: skip
    bundle = ring.bundle(DEFAULT)
    chain = check(token, at=at, trust=bundle)
    assert isinstance(chain, Chain), chain
    return delegate(
        token, chain=chain, attester=key_of(attester), trust=bundle, caps=DEFAULT,
        hop=grant_to("robotic", "orchestrator", attestation=proven),
        restriction=replace(SLOWER, not_after=None),
    )  # fmt: skip


def presented(token: bytes, ring: KeyRing, signed_at: int, attester: str, at: int) -> Chain | Fault:
    """Answer of a verifier with the ring's bundle: steps 1 to 9, then the keys of the moment."""
    bundle = ring.bundle(DEFAULT)
    chain = check(token, at=at, trust=bundle)
    if isinstance(chain, Fault):
        return chain
    return bundle.refusal(chain.root_key_id, signed_at, [(raw_of(attester), signed_at)], at=at) or chain


ROOT_1, ATTESTER_1 = f"first {Role.ROOT}", f"first {Role.ATTESTER}"


@pytest.mark.parametrize("role", [Role.ROOT, Role.ATTESTER])
def test_a_rotation_from_end_to_end(role):
    """Valid tokens pass during the overlap, and none after it.

    After a taint only older tokens pass; after a revocation none does.
    """
    stem = rotation.ID_STEM[role]
    minute, names = 60, {Role.ROOT: ROOT_1, Role.ATTESTER: ATTESTER_1}
    old = lent(RING, ROOT_1, ATTESTER_1, NOW)

    prepared = stepped(rotation.prepare(RING, role, raw_of("second"), at=NOW + minute))
    assert isinstance(presented(old, prepared, NOW, ATTESTER_1, NOW + 2 * minute), Chain)

    active = stepped(rotation.activate(prepared, f"{stem}-2", at=NOW + 3 * minute))
    names[role] = "second"
    new = lent(active, names[Role.ROOT], names[Role.ATTESTER], NOW + 4 * minute)
    now = NOW + 5 * minute
    for ring in (prepared, active):  # a verifier that has the older bundle still knows the new key
        assert isinstance(presented(old, ring, NOW, ATTESTER_1, now), Chain)
        assert isinstance(presented(new, ring, NOW + 4 * minute, names[Role.ATTESTER], now), Chain)
    code = {Role.ROOT: FaultCode.UNKNOWN_ROOT_KEY, Role.ATTESTER: FaultCode.HOP_NOT_ATTESTED}[role]
    assert presented(new, RING, NOW + 4 * minute, names[Role.ATTESTER], now).code is code, (
        "unprepared, it is a stranger"
    )

    # Signed by the retired key, though it should not have been: accepted until the taint, and what is newer never after it.
    stray_at = NOW + 6 * minute
    stray = lent(prepared, ROOT_1, ATTESTER_1, stray_at)
    tainted = stepped(rotation.taint(active, f"{stem}-1", at=stray_at))
    now = NOW + 7 * minute
    assert isinstance(presented(stray, active, stray_at, ATTESTER_1, now), Chain)
    assert presented(stray, tainted, stray_at, ATTESTER_1, now).code is code
    assert isinstance(presented(old, tainted, NOW, ATTESTER_1, now), Chain)
    assert isinstance(presented(new, tainted, NOW + 4 * minute, names[Role.ATTESTER], now), Chain)

    revoked = stepped(rotation.revoke(tainted, f"{stem}-1", at=now))
    assert presented(old, revoked, NOW, ATTESTER_1, now).code is code
    assert isinstance(presented(new, revoked, NOW + 4 * minute, names[Role.ATTESTER], now), Chain)

    # The overlap is over: a verifier that kept the bundle of the activation refuses by its windows alone.
    last = NOW + 3 * minute + OVERLAP
    bundle = active.bundle(DEFAULT)
    signed = (1 if role is Role.ROOT else bundle_root(bundle), last - 60, [(raw_of(ATTESTER_1), last - 60)])
    assert bundle.refusal(*signed, at=last - 1) is None
    assert bundle.refusal(*signed, at=last).code is code


def bundle_root(bundle: TrustBundle) -> int:
    return next(iter(bundle.roots))


def test_the_longest_token_outlives_no_overlap():
    """A token of the longest life, signed in the old key's last second, ends before its key does."""
    active = rotated(RING, Role.ROOT, "second", NOW + 100)
    assert NOW + 99 + DEFAULT.lifetime_s < active.bundle(DEFAULT).windows[FIRST[Role.ROOT]].not_after


def test_verifiers_follow_step_by_step_and_never_back():
    """Each bundle reaches a verifier signed by the registry key of its time; every earlier one is then a replay."""
    signer = {FIRST[Role.REGISTRY]: key_of(f"first {Role.REGISTRY}"), raw_of("second"): key_of("second")}
    rings = [RING]
    for step in (
        lambda r: rotation.prepare(r, Role.REGISTRY, raw_of("second"), at=NOW + 1),
        lambda r: rotation.activate(r, "registry-2", at=NOW + 2),
        lambda r: rotation.taint(r, "registry-1", at=NOW + 3),
        lambda r: rotation.revoke(r, "registry-1", at=NOW + 4),
    ):
        rings.append(stepped(step(rings[-1])))
    held, at = RING.bundle(DEFAULT), NOW + 10
    seen = check_bundle(held, None, at=at, caps=DEFAULT)
    for before, ring in zip(rings, rings[1:], strict=False):
        text = trust_bundle.sign(ring.bundle(DEFAULT), signer[ring.active(Role.REGISTRY).key])
        held = succeed(held, text, at=at, caps=DEFAULT)
        assert held == ring.bundle(DEFAULT)
        seen = check_bundle(held, seen, at=at, caps=DEFAULT)
        old = before.bundle(DEFAULT)
        again = trust_bundle.sign(old, signer[ring.active(Role.REGISTRY).key])
        assert isinstance(succeed(held, again, at=at, caps=DEFAULT), Fault)
        assert check_bundle(old, seen, at=at, caps=DEFAULT).code is FaultCode.REPLAYED
    thief = trust_bundle.sign(replace(held, version=99, issued_at=NOW + 9), signer[FIRST[Role.REGISTRY]])
    assert succeed(held, thief, at=at, caps=DEFAULT).code is FaultCode.STATEMENT_UNTRUSTED


def test_a_ring_follows_by_steps_alone():
    ring = rotation.prepare(RING, Role.ROOT, raw_of("second"), at=NOW + 1)
    longer = rotation.activate(ring, "root-2", at=NOW + 2)
    for held, newer in (
        (RING, RING),
        (RING, ring),
        (RING, longer),
        (ring, rotation.revoke(longer, "root-1", at=NOW + 3)),
    ):
        assert ring_follows(held, newer) is None
    assert ring_follows(longer, ring).code is FaultCode.REPLAYED
    assert ring_follows(ring, replace(ring, issued_at=NOW + 9)).code is FaultCode.REPLAYED
    assert ring_follows(ring, replace(RING, version=9)).code is FaultCode.KEY_WRONG_ROLE
    assert ring_follows(ring, replace(ring, version=9, issuer=ISSUER + "/x")).code is FaultCode.STATEMENT_UNTRUSTED
    undone = tuple(replace(r, prepared_at=r.prepared_at - 1) for r in ring.records)
    assert ring_follows(ring, replace(ring, version=9, records=undone)).code is FaultCode.REPLAYED
