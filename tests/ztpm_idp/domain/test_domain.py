"""Domain by itself: values in, events or a refusal out.

No store, no clock, no network, and none of them imported.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import pytest
from capabilities.keys.trust import TrustBundle
from capabilities.values.caps import DEFAULT
from hypothesis import given
from hypothesis import strategies as st
from policies.decision.load import load_shipped
from ztpm_idp.domain.codes import Refusal
from ztpm_idp.domain.core import decide
from ztpm_idp.domain.entries import entry_of
from ztpm_idp.domain.events import (
    AgentAttested,
    NonceConsumed,
    NonceGiven,
    PartyRegistered,
    RecordTaken,
    RevocationKind,
    Revoked,
)
from ztpm_idp.domain.ledger import FIRST_PREV, record_digest, seal
from ztpm_idp.domain.parties import (
    PersonRole,
    RegisteredAgent,
    RegisteredPep,
    RegisteredPerson,
    RegisteredSensor,
    Standing,
)
from ztpm_idp.domain.rules import Rules
from ztpm_idp.domain.state import HopRecord, Journal, Nonce, State

from capabilities.keys import keys
from capabilities.statements import attestation
from ztpm_idp.domain import commands as c

AT_MS = 1_800_000_000_000
DIGEST = bytes(range(32))
AGENT_KEY = keys.generate()
TRUST = TrustBundle(
    "http://127.0.0.1:8700/ztpm", 1, {1: keys.public_raw(keys.generate())},
    *(frozenset({keys.public_raw(keys.generate())}) for _ in range(4)),
)  # fmt: skip
RULES = Rules(
    TRUST.issuer, TRUST, DEFAULT, TRUST.all_keys, 3_600, 60, 4, 6, 10_000, 10_000, load_shipped("paper-default")
)


def person(name, *roles, standing=Standing.ACTIVE):
    raw = keys.public_raw(keys.generate())
    return RegisteredPerson(name, raw, keys.thumbprint(raw), standing, name.title(), frozenset(map(PersonRole, roles)))


def agent(name="mover", *, standing=Standing.REGISTERED, sponsor="bob", key=AGENT_KEY):
    raw = keys.public_raw(key)
    return RegisteredAgent(name, raw, keys.thumbprint(raw), standing, DIGEST, "m", "actuator", sponsor, None)


def state(*parties, **more):
    return State(parties={p.id: p for p in parties}, key_owners={p.key: p.id for p in parties}, **more)


ADMIN, SPONSOR = person("alice", "admin"), person("bob", "sponsor")
CELL = RegisteredPep("cell-1", bytes(32), "t" * 43, Standing.ACTIVE, frozenset({"http://127.0.0.1/mcp"}))
EYE = RegisteredSensor("eye", bytes(32), "s" * 43, Standing.ACTIVE, DIGEST, 20, "http://127.0.0.1/mcp")


def code(outcome):
    assert isinstance(outcome, Refusal), outcome
    return outcome.code


COMMANDS_OF_ADMINS = [
    c.RegisterPerson("X", "new", "New", DIGEST, frozenset({PersonRole.SPONSOR})),
    c.RegisterPep("X", "new", DIGEST, frozenset({"http://127.0.0.1/mcp"})),
    c.RegisterSensor("X", "new", DIGEST, DIGEST, 20, "http://127.0.0.1/mcp"),
    c.RegisterAgent("X", "new", DIGEST, DIGEST, "m", "r", "bob"),
]


@pytest.mark.parametrize("command", COMMANDS_OF_ADMINS, ids=lambda x: type(x).__name__)
def test_administrators_register(command):
    carol, dead = person("carol", "approver", "sponsor"), person("dora", "admin", standing=Standing.REVOKED)
    found = state(ADMIN, SPONSOR, carol, dead, CELL, agent())
    made = decide(RULES, found, replace(command, by="alice"), AT_MS)
    assert [type(event) for event in made] == [PartyRegistered]
    for who, expected in (
        ("carol", "NOT_PERMITTED"),
        ("cell-1", "NOT_PERMITTED"),
        ("mover", "NOT_PERMITTED"),
        ("dora", "CALLER_INACTIVE"),
    ):
        assert code(decide(RULES, found, replace(command, by=who), AT_MS)) == expected
    for who in ("nobody", "eye"):
        assert code(decide(RULES, state(EYE), replace(command, by=who), AT_MS)) == "CALLER_UNKNOWN"


@pytest.mark.parametrize("command", COMMANDS_OF_ADMINS, ids=lambda x: type(x).__name__)
def test_ids_and_keys_are_taken_once(command):
    command = replace(command, by="alice")
    assert code(decide(RULES, state(ADMIN, SPONSOR, agent("new")), command, AT_MS)) == "ALREADY_REGISTERED"
    owned = state(ADMIN, SPONSOR)
    assert code(decide(RULES, replace(owned, key_owners={DIGEST: "someone"}), command, AT_MS)) == "KEY_IN_USE"
    for own in RULES.own_keys:
        assert code(decide(RULES, owned, replace(command, key=own), AT_MS)) == "KEY_IN_USE"


def test_nonces_go_to_agents_that_live():
    ask = c.GiveNonce("mover", "n" * 32)
    assert decide(RULES, state(agent()), ask, AT_MS) == (NonceGiven("n" * 32, "mover", AT_MS),)
    assert code(decide(RULES, state(agent(standing=Standing.REVOKED)), ask, AT_MS)) == "CALLER_INACTIVE"
    assert code(decide(RULES, state(ADMIN), replace(ask, by="alice"), AT_MS)) == "NOT_PERMITTED"
    four = {str(n): Nonce(str(n), "mover", AT_MS, consumed=False) for n in range(4)}
    assert code(decide(RULES, state(agent(), nonces=four), ask, AT_MS)) == "TOO_MANY_NONCES"
    spent = {n: replace(nonce, consumed=True) for n, nonce in four.items()}
    assert isinstance(decide(RULES, state(agent(), nonces=spent), ask, AT_MS), tuple)


def evidence(**changes):
    stated = dict(
        agent="mover", key_thumbprint=keys.thumbprint(keys.public_raw(AGENT_KEY)), nonce="n" * 32, delegator="", request_digest=bytes(32),
        measurement=DIGEST, at=AT_MS // 1000, workload="",
    )  # fmt: skip
    return attestation.sign(attestation.Evidence(**(stated | changes)), AGENT_KEY)


@pytest.mark.parametrize(
    ("at_ms", "given_ms", "consumed", "owner", "good"),
    [
        (AT_MS, AT_MS, False, "mover", True),
        (AT_MS + 60_000, AT_MS, False, "mover", True),
        (AT_MS + 60_001, AT_MS, False, "mover", False),
        (AT_MS - 1, AT_MS, False, "mover", False),
        (AT_MS, AT_MS, True, "mover", False),
        (AT_MS, AT_MS, False, "helper", False),
    ],
)
def test_attestation_is_a_rule_about_one_nonce(at_ms, given_ms, consumed, owner, good):
    found = state(agent(), nonces={"n" * 32: Nonce("n" * 32, owner, given_ms, consumed)})
    outcome = decide(RULES, found, c.Attest("mover", "mover", evidence()), at_ms)
    if good:
        assert [type(event) for event in outcome] == [NonceConsumed, AgentAttested]
    else:
        assert code(outcome) == "ATTESTATION_INVALID"


def test_nobody_attests_another():
    found = state(
        agent(),
        agent("helper", key=keys.generate()),
        nonces={"n" * 32: Nonce("n" * 32, "mover", AT_MS, consumed=False)},
    )
    assert code(decide(RULES, found, c.Attest("helper", "mover", evidence()), AT_MS)) == "NOT_PERMITTED"


HOPS = {
    "b" * 32: HopRecord("b" * 32, "T" * 22, "a" * 32, "mover", "bob"),
    "a" * 32: HopRecord("a" * 32, "T" * 22, None, "planner", "bob"),
}


@pytest.mark.parametrize(
    ("by", "hops", "good"),
    [
        ("mover", HOPS, True),
        ("planner", HOPS, True),
        ("bob", HOPS, True),
        ("alice", {}, True),
        ("stranger", HOPS, False),
        ("eve", HOPS, False),
        ("bob", {}, False),
        ("mover", {}, False),
        ("mover", {"a" * 32: HOPS["a" * 32]}, False),
        ("cell-1", HOPS, False),
    ],
)
def test_a_hop_is_its_holders_its_ancestors_its_sponsors_and_the_administrators(by, hops, good):
    everybody = [ADMIN, SPONSOR, CELL, person("eve", "sponsor", "approver")]
    everybody += [agent(n, standing=Standing.ACTIVE, key=keys.generate()) for n in ("mover", "planner", "stranger")]
    outcome = decide(RULES, state(*everybody, hops=hops), c.Revoke(by, RevocationKind.HOP, "b" * 32, "r"), AT_MS)
    if good:
        assert outcome == (Revoked(RevocationKind.HOP, "b" * 32, "r", None),)
    else:
        assert code(outcome) == "NOT_PERMITTED"


def test_revoking_twice_is_one_event():
    outcome = decide(
        RULES, state(ADMIN, revoked_at_epoch=7), c.Revoke("alice", RevocationKind.TOKEN, "T" * 22, "r"), AT_MS
    )
    assert outcome == ()


def test_ending_a_party_names_it():
    killed = decide(RULES, state(ADMIN, SPONSOR), c.Revoke("alice", RevocationKind.SPONSOR, "bob", "r"), AT_MS)
    assert killed == (Revoked(RevocationKind.SPONSOR, "bob", "r", "bob"),)
    by_key = state(ADMIN, agent(), owner_of_thumbprint="mover")
    assert (
        decide(RULES, by_key, c.Revoke("alice", RevocationKind.KEY, agent().thumbprint, "r"), AT_MS)[0].party == "mover"
    )


def records(count):
    made, prev = [], FIRST_PREV
    for seq in range(1, count + 1):
        made.append(
            {"v": 1, "pep": "cell-1", "seq": seq, "prev": prev, "at_ms": 1, "kind": "decision", "body": {"n": seq}}
        )
        prev = record_digest(made[-1])
    return made


@given(st.integers(0, 6), st.integers(0, 6), st.integers(0, 6))
def test_any_window_of_the_true_journal_is_taken_exactly_once(taken, start, end):
    made = records(6)
    digests = {r["seq"]: record_digest(r) for r in made[:taken]}
    journal = Journal(taken, digests.get(taken, FIRST_PREV), digests)
    offered = tuple(made[start:end])
    outcome = decide(RULES, state(CELL, journal=journal), c.TakeRecords("cell-1", offered), AT_MS)
    if offered and start > taken:
        assert code(outcome) == "RECORD_GAP"
    else:
        assert (
            [event.seq for event in outcome] == list(range(taken + 1, end + 1))
            if end > taken and offered
            else outcome == ()
        )
        assert all(isinstance(event, RecordTaken) for event in outcome)


def test_entries_are_sealed_to_the_one_before():
    one = seal(seq=1, prev=FIRST_PREV, at_ms=1, actor="a", kind="k", body={})
    two = seal(seq=2, prev=one.digest, at_ms=1, actor="a", kind="k", body={})
    assert one.digest in two.line.decode()
    assert seal(seq=2, prev=FIRST_PREV, at_ms=1, actor="a", kind="k", body={}).digest != two.digest
    assert entry_of(NonceGiven("n", "a", 1)) is None


def test_decide_is_deterministic():
    command, found = c.GiveNonce("mover", "n" * 32), state(agent())
    assert decide(RULES, found, command, AT_MS) == decide(RULES, found, command, AT_MS)


def test_the_domain_loads_no_framework():
    code_ = (
        "import sys; import ztpm_idp.domain.core, ztpm_idp.domain.entries; "
        "print([m for m in ('fastapi', 'starlette', 'sqlalchemy', 'alembic', 'httpx2', 'uvicorn') if m in sys.modules])"
    )
    assert (
        subprocess.run([sys.executable, "-c", code_], capture_output=True, check=True, timeout=60).stdout.strip()
        == b"[]"
    )
