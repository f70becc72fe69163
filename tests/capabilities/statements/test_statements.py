"""Signed statements: one kind, one key, one spelling, every member of its form."""

from __future__ import annotations

import copy
import dataclasses
import json

import pytest
from capabilities.statements.claims import BODY_BYTES
from capabilities.values.arguments import argument
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import CapabilityError, FaultCode, StatementError
from capabilities.values.scope import Tier
from capabilities.values.units import INT_LIMIT, DeclaredUnit, ListOf, Quantity, Sort, Unit
from msgspec import structs
from tests.capabilities.keys.test_keys import curve_of
from tests.capabilities.world import (
    CELL,
    ISSUER,
    NOW,
    OTHER_CELL,
    SCOPE,
    TRUST,
    chain_of,
    chain_of_four,
    key_of,
    raw_of,
)

from capabilities.keys import jws, keys
from capabilities.statements import (
    attestation,
    cell,
    checkpoint,
    conduct,
    mark,
    observation,
    registry,
    release,
    revocation,
    statement_form,
    ticket,
)
from capabilities.statements.context import admission, intent, manifest, memory, message, response
from capabilities.statements.people import answers, ask, clearing, envelope, latch, mandate, opening, stop, vote
from capabilities.statements import (
    trust as trust_bundle,
)
from capabilities.values import strict_json

HEX = "ab" * 32
SIGNER = key_of("signer")
TRUSTED = frozenset({raw_of("signer"), raw_of("other")})

EVIDENCE = attestation.Evidence(
    "robotic", keys.thumbprint(raw_of("signer")), "n" * 22, "orchestrator", b"\1" * 32, b"\2" * 32, NOW, ""
)
INDEX = revocation.RevocationIndex(
    ISSUER,
    9,
    2,
    NOW * 1_000,
    "n" * 22,
    4,
    (revocation.RevocationEntry(3, "agent", "robotic"), revocation.RevocationEntry(9, "audience", CELL)),
)
SNAPSHOT = registry.RegistrySnapshot(
    ISSUER,
    4,
    CELL,
    NOW * 1_000,
    (registry.ToolEntry("move_joint", HEX, "move_joint", Tier.REVERSIBLE),),
    (registry.SensorEntry("camera-1", raw_of("camera"), HEX, 100),),
    (registry.TrustEntry("robotic", 800),),
    (registry.PartyEntry("alice", raw_of("alice")),),
    (registry.PartyEntry("pep-1", raw_of("camera")),),
)
CORNERS = [[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]]
FRAME = observation.Observation(
    "camera-1",
    "0f" * 16,
    7,
    NOW * 1_000,
    HEX,
    True,
    (
        observation.ObservedPerson(
            "p1",
            (
                ("head", observation.Sphere((500_000, 0, 1_700_000), 120_000)),
                ("torso", observation.Capsule((0, 0, 0), (0, 0, 9), 5)),
            ),
        ),
        observation.ObservedPerson("p2", (("head", observation.Sphere((0, 0, 1_700_000), 120_000)),), 3_600_000),
    ),
    (
        observation.ObservedObject("vase", "fragile", observation.Box((1, 2, 3), (4, 5, 6), (1_000_000, 0, 0, 0))),
        observation.ObservedObject(
            "wedge", "rigid", observation.Convex(((0, 0, 0), (10**8, 0, 0), (0, -7, 0), (0, 0, 9)), 0), 250
        ),
    ),
)
ASKED = ask.Ask(
    ask_id="0a" * 16,
    nonce="0b" * 16,
    pep="cell-1",
    audience=CELL,
    issuer=ISSUER,
    sponsor="alice",
    token_id="g" * 22,
    agent="robotic",
    agent_key=keys.thumbprint(raw_of("robotic")),
    object="ur3e",
    operation="move_joint",
    values=(Quantity("q0", Unit.MICRORADIAN, -600_000), Quantity("speed", Unit.MICRORADIAN_PER_SECOND, 500_000)),
    request_digest=HEX,
    start_urad=(0, -1, 2, 3, 4, 5),
    model_digest=HEX,
    policy_digest=HEX,
    scene_digest=HEX,
    tier=Tier.HIGH_CONSEQUENCE,
    index_milli=2_900,
    reasons=("TIER_NEEDS_APPROVAL",),
    contributors=(
        ask.Contributor("person", "wrist_3", "person-1/torso", 2_900, 410_000, 90_000, "camera-1"),
        ask.Contributor("rigid", "gripper", "table", 1_100, 90_000, 90_000),
    ),
    perception="fresh",
    perception_age_ms=40,
    approvers=1,
    opening_id="",
    asked_at=NOW,
    expires_at=NOW + 60,
)
VOTED = vote.Vote("0a" * 16, "0b" * 16, HEX, "approve", "alice", False, 1, NOW + 120, NOW)
OPENED = opening.Opening("0c" * 16, "bob", CELL, "robotic", "ur3e", "move_joint", "maintenance", 1, NOW, NOW + 600)
ENVELOPED = envelope.Envelope(
    envelope_id="0f" * 16,
    approver="carol",
    audience=CELL,
    sponsor="alice",
    agent="robotic",
    agent_key=keys.thumbprint(raw_of("robotic")),
    object="ur3e",
    operation="move_joint",
    model_digest=HEX,
    policy_digest=HEX,
    reasons=("TIER_NEEDS_APPROVAL",),
    tier=Tier.HIGH_CONSEQUENCE,
    index_milli=2_900,
    speed_um_s=250_000,
    box=(envelope.Side("q0", -600_000, 600_000),),
    start_urad=tuple(envelope.Side(f"q{n}", -n, n) for n in range(6)),
    seen=(envelope.Seen("person", "person-1/torso"), envelope.Seen("self", "")),
    uses=10,
    not_before=NOW,
    not_after=NOW + 600,
)
LATCHED = latch.Latch(
    latch_id="1a" * 16,
    issuer=ISSUER,
    pep="cell-pep",
    audience=CELL,
    robot="ur3e",
    cause=latch.LatchCause.WATCH,
    reason="PERSON_NEAR",
    tier=Tier.SAFETY_CRITICAL,
    approvers=2,
    request_id="1b" * 16,
    at=NOW,
    retreat=(latch.Retreat((latch.Turn(1, -200_000),), (0, -200_000, 0, 0, 0, 0), 100_000, Tier.CONSEQUENTIAL, 1_900),),
)
CLEARED = clearing.Clearing("1a" * 16, HEX, CELL, "ur3e", latch.LatchCause.WATCH, "carol", NOW + 120, NOW)
SAID_STOP = stop.Stop("1c" * 16, ISSUER, CELL, "ur3e", "carol", "a glove lies in its way", NOW + 30, NOW)
STANDING = answers.Answers(
    ISSUER, CELL, "n" * 22, NOW * 1_000, (answers.AnsweredAsk("0a" * 16, "granted", ("vote",)),), ("opening",)
)
SURVEY = cell.Cell(
    name="cell-1",
    author="carol",
    audience=CELL,
    tool="robotiq_2f85",
    payload_g=None,
    workspace=cell.Workspace((-900_000, -900_000, -200_000), (900_000, 900_000, 1_200_000)),
    objects=(
        cell.Surveyed(
            "table", "rigid", observation.Box((0, 0, -60_000), (500_000, 500_000, 50_000), (1_000_000, 0, 0, 0))
        ),
    ),
    zones=(
        cell.Zone("charger", None, observation.Sphere((0, 800_000, 0), 100_000)),
        cell.Zone("press", Tier.SAFETY_CRITICAL, observation.Capsule((0, 0, 1), (0, 0, 2), 9)),
    ),
    contacts=(cell.Contact("table", "tool", False), cell.Contact("part-1", "payload", True)),
    outputs=(cell.Output(0, "lamp", Tier.NO_EFFECT), cell.Output(17, "vacuum", Tier.CONSEQUENTIAL)),
    sensors=("camera-1", "camera-2"),
    not_before=NOW,
    not_after=NOW + 86_400,
)
SAID = message.Message(
    sender="orchestrator",
    addressee="robotic",
    token_id="g" * 22,
    hop_id="0d" * 16,
    conversation="c" * 22,
    sequence=3,
    in_reply_to=HEX,
    schema="task/1",
    body=b'{"pick":{"part":"red","x_um":-5},"steps":[1,null,true]}',
    at=NOW,
    not_after=NOW + 60,
)
LISTED = manifest.Manifest(
    collection="procedures",
    content="document",
    curator="dora",
    version=4,
    entries=(
        manifest.entry_of("gripping", b"Close on the part with 40 N.", "handbook-7"),
        manifest.ManifestEntry("moving", HEX, "handbook-7"),
    ),
    at=NOW,
    not_after=NOW + 86_400,
)
WANTED = intent.Intent(
    subject="alice",
    schema="sort/1",
    body=b'{"box":2,"parts":["red"]}',
    nonce="n" * 22,
    at=NOW,
    not_after=NOW + 3_600,
)
LET_IN = admission.Receipt(
    audience=CELL,
    agent="robotic",
    hop_id="0d" * 16,
    value=HEX,
    sources=("retrieval", "sensor"),
    signers=("*", "camera-1", "dora"),
    integrity="curated",
    age_ms=40,
    tainted=False,
    at=NOW,
    not_after=NOW + 600,
)
SEEN = conduct.Conduct(
    ISSUER,
    9,
    2,
    8,
    NOW * 1_000,
    "n" * 22,
    (conduct.EdgeEntry(3, "alice", "orchestrator", 800), conduct.EdgeEntry(8, "orchestrator", "robotic", 640)),
    (
        conduct.AgentEntry(
            7, "robotic", (conduct.DeviationEntry("near boundary", NOW - 60, 1_400),), NOW - 60, True, 71, NOW - 900
        ),
    ),
)
ANSWERED = response.Response(
    audience=CELL,
    agent="robotic",
    hop_id="0d" * 16,
    proof="cd" * 32,
    request=HEX,
    tool="read_state",
    definition="ef" * 32,
    result="01" * 32,
    tainted=False,
    at=NOW,
    not_after=NOW + 600,
)
ROW = memory.Remembered(
    audience=CELL,
    sequence=7,
    previous=HEX,
    name="tray/pose-1",
    value="cd" * 32,
    writer="robotic",
    hop_id="0d" * 16,
    token_id="g" * 22,
    behind=(("agent", "robotic"), ("hop", "0d" * 16), ("key", "-" + "k" * 42), ("sponsor", "alice")),
    sources=("agent", "retrieval"),
    signers=("*", "dora", "robotic"),
    integrity="agent",
    age_ms=40,
    tainted=False,
    at=NOW,
)
PASSED_ON = ticket.Ticket(
    id="0e" * 16,
    pep="cell-1",
    audience=CELL,
    url="http://127.0.0.1:8902/calls",
    carried=ticket.RequestDigests(token=HEX, proof="cd" * 32, body="ef" * 32),
    at_ms=NOW * 1_000,
)
PROMISED = mandate.Mandate(
    mandate_id="0f" * 16,
    issuer=ISSUER,
    sponsor="alice",
    agent="robotic",
    agent_key="k" * 42 + "A",
    purpose="tidy the hall",
    scope=dataclasses.replace(SCOPE, not_before=NOW - 5, not_after=NOW + 604_800),
    at=NOW,
)
POINT = checkpoint.Checkpoint(ISSUER, 12, HEX, NOW * 1_000)
KNOWN = mark.Mark(
    issuer=ISSUER,
    line=1,
    epoch=9,
    head=HEX,
    entries=(mark.MarkEntry("agent", "robotic"), mark.MarkEntry("audience", CELL), mark.MarkEntry("hop", "0e" * 16)),
    remaining=2,
    at=NOW,
)

RELEASED = release.Release("acme", "planner-1.4", *(bytes([n]) * 32 for n in range(4)), NOW, NOW + 86_400)
KINDS = {
    release: RELEASED,
    attestation: EVIDENCE,
    revocation: INDEX,
    registry: SNAPSHOT,
    observation: FRAME,
    checkpoint: POINT,
    conduct: SEEN,
    ask: ASKED,
    vote: VOTED,
    opening: OPENED,
    envelope: ENVELOPED,
    latch: LATCHED,
    clearing: CLEARED,
    stop: SAID_STOP,
    answers: STANDING,
    cell: SURVEY,
    manifest: LISTED,
    mark: KNOWN,
    memory: ROW,
    response: ANSWERED,
    message: SAID,
    intent: WANTED,
    mandate: PROMISED,
    admission: LET_IN,
    ticket: PASSED_ON,
    trust_bundle: TRUST,
}
each = pytest.mark.parametrize("module", KINDS, ids=lambda module: module.KIND)


def code_of(module, text: str, trusted=TRUSTED, caps=DEFAULT) -> FaultCode:
    with pytest.raises(StatementError) as caught:
        module.open(text, trusted, caps)
    return caught.value.code


def claims_of(module) -> dict:
    return json.loads(jws.split(module.sign(KINDS[module], SIGNER), most_bytes=10**6).payload_raw)


@pytest.mark.clause("STM-5")
@each
def test_a_statement_comes_back(module):
    text = module.sign(KINDS[module], SIGNER)
    assert module.open(text, TRUSTED, DEFAULT) == KINDS[module]
    assert module.sign(module.open(text, TRUSTED, DEFAULT), SIGNER) == text


@pytest.mark.clause("STM-1", "STM-3")
@each
def test_a_statement_by_a_p256_key_comes_back(module):
    """The algorithm follows the key: the same texts, the same answers, one spelling."""
    key = curve_of("signer")
    raw = keys.public_raw(key)
    said = structs.replace(EVIDENCE, key_thumbprint=keys.thumbprint(raw)) if module is attestation else KINDS[module]
    text = module.sign(said, key)
    assert jws.split(text, most_bytes=10**6).header["alg"] == "ES256"
    assert module.open(text, TRUSTED | {raw}, DEFAULT) == said
    assert module.sign(module.open(text, {raw}, DEFAULT), key) == text
    assert code_of(module, text) is FaultCode.STATEMENT_UNTRUSTED
    assert code_of(module, text, {keys.public_raw(curve_of("other"))}) is FaultCode.STATEMENT_UNTRUSTED


@pytest.mark.clause("STM-2")
@each
def test_another_kind_is_refused(module):
    for other in KINDS:
        if other is not module:
            assert code_of(module, other.sign(KINDS[other], SIGNER)) is FaultCode.STATEMENT_WRONG_KIND


@pytest.mark.clause("STM-3")
@each
def test_another_key_is_refused(module):
    text = module.sign(KINDS[module], SIGNER)
    assert code_of(module, text, frozenset({raw_of("other")})) is FaultCode.STATEMENT_UNTRUSTED
    assert code_of(module, text, frozenset()) is FaultCode.STATEMENT_UNTRUSTED
    # Signed by another, naming the trusted one.
    forged = jws.sign(
        {"typ": statement_form.type_of(module.KIND), "kid": keys.thumbprint(raw_of("signer"))},
        strict_json.canonical(claims_of(module)),
        key_of("eve"),
    )
    assert code_of(module, forged) is FaultCode.STATEMENT_UNTRUSTED


@pytest.mark.clause("STM-4")
@each
def test_only_canonical_bytes(module):
    claims = claims_of(module)
    header = {"typ": statement_form.type_of(module.KIND), "kid": keys.thumbprint(raw_of("signer"))}
    canonical = strict_json.canonical(claims)
    first = next(iter(claims))
    payloads = [
        json.dumps(claims).encode(),
        canonical + b" ",
        b" " + canonical,
        canonical.replace(b"{", b'{"%s":null,' % first.encode(), 1),  # a member twice
        canonical[:-1],
        canonical.replace(b":", b": ", 1),
        b"\xef\xbb\xbf" + canonical,
        canonical.decode().encode("utf-16"),
        b"",
        b"null",
        b"[]",
    ]
    for payload in payloads:
        assert code_of(module, jws.sign(header, payload, SIGNER)) is FaultCode.STATEMENT_MALFORMED
    assert module.open(jws.sign(header, canonical, SIGNER), TRUSTED, DEFAULT) == KINDS[module]


@pytest.mark.clause("STM-1", "STM-3")
@each
def test_the_header_is_closed(module):
    header = {"typ": statement_form.type_of(module.KIND), "kid": keys.thumbprint(raw_of("signer"))}
    canonical = strict_json.canonical(claims_of(module))
    for extra in (
        {"crit": ["x"]},
        {"jwk": jws.jwk(raw_of("signer"))},
        {"jku": "http://evil.example"},
        {"x": 1},
        {"cty": "json"},
    ):
        assert code_of(module, jws.sign({**header, **extra}, canonical, SIGNER)) is FaultCode.STATEMENT_MALFORMED
    assert code_of(module, jws.sign({"typ": header["typ"]}, canonical, SIGNER)) is FaultCode.STATEMENT_MALFORMED
    assert code_of(module, jws.sign({**header, "kid": "5"}, canonical, SIGNER)) is FaultCode.STATEMENT_UNTRUSTED
    assert code_of(module, jws.sign({**header, "typ": "JWT"}, canonical, SIGNER)) is FaultCode.STATEMENT_WRONG_KIND
    text = module.sign(KINDS[module], SIGNER)
    head, payload, signature = text.split(".")
    spaced = keys.b64u(json.dumps(json.loads(keys.unb64u(head))).encode())
    assert code_of(module, f"{spaced}.{payload}.{signature}") is FaultCode.STATEMENT_MALFORMED
    number = keys.b64u(strict_json.canonical({**header, "alg": "EdDSA", "kid": 5}))
    assert code_of(module, f"{number}.{payload}.{signature}") is FaultCode.STATEMENT_UNTRUSTED
    none = keys.b64u(strict_json.canonical({**header, "alg": "none"}))
    assert code_of(module, f"{none}.{payload}.") is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-1")
@each
def test_other_spellings_and_sizes(module):
    from dataclasses import replace  # noqa: PLC0415

    text = module.sign(KINDS[module], SIGNER)
    for other in (
        "",
        ".",
        "..",
        text + "=",
        text + "\n",
        " " + text,
        text[:-1],
        text + "A",
        text.replace(".", "..", 1),
        "ä",
        text[:100],
    ):
        assert code_of(module, other) in {FaultCode.STATEMENT_MALFORMED, FaultCode.STATEMENT_UNTRUSTED}
    assert code_of(module, text, caps=replace(DEFAULT, statement_bytes=len(text) - 1)) is FaultCode.STATEMENT_MALFORMED
    head, payload, signature = text.split(".")
    flipped = keys.unb64u(payload)
    for at in range(0, len(flipped), 7):
        mutant = flipped[:at] + bytes([flipped[at] ^ 1]) + flipped[at + 1 :]
        assert code_of(module, f"{head}.{keys.b64u(mutant)}.{signature}") is FaultCode.STATEMENT_UNTRUSTED


def places(value: object, path: tuple = ()):
    """Every place in a JSON value."""
    yield path
    if isinstance(value, dict):
        for name, member in value.items():
            yield from places(member, (*path, name))
    if isinstance(value, list):
        for at, member in enumerate(value):
            yield from places(member, (*path, at))


def put(value: object, path: tuple, new: object) -> object:
    if not path:
        return new
    copied = copy.copy(value)
    copied[path[0]] = put(copied[path[0]], path[1:], new)
    return copied


WRONG = [None, True, -1, INT_LIMIT, "", "x y", "\n", "\u202e", [], {}, [[]], ["x"], {"x": 1}, "A" * 300]
HARMLESS = {
    # values that are right in their place by chance
    ("attestation", ("delegator",), ""),
    ("attestation", ("at",), INT_LIMIT),
    ("observation", ("complete",), True),
}


@pytest.mark.long
@pytest.mark.clause("STM-5")
@each
def test_every_member_has_its_form(module):
    """Each place of the claims replaced by each wrong value, and each member removed or doubled under another name."""
    claims = claims_of(module)
    refused = 0
    for path in places(claims):
        for wrong in WRONG:
            text = sealed_text(module, put(claims, path, wrong))
            if text is None:
                continue
            try:
                opened = module.open(text, TRUSTED, DEFAULT)
            except StatementError as error:
                assert error.code is FaultCode.STATEMENT_MALFORMED
                refused += 1
            else:
                # What is accepted must come back as it was sent.
                assert module.sign(opened, SIGNER) == text, (path, wrong)
    for name in claims:
        rest = {other: value for other, value in claims.items() if other != name}
        assert code_of(module, statement_form.sign(module.KIND, rest, SIGNER)) is FaultCode.STATEMENT_MALFORMED
        assert (
            code_of(module, statement_form.sign(module.KIND, {**claims, name + "2": 1}, SIGNER))
            is FaultCode.STATEMENT_MALFORMED
        )
    assert refused > 25


@pytest.mark.clause("STM-13")
@each
def test_nothing_is_signed_that_its_own_reader_refuses(module):
    """Each member of the value replaced by each wrong one: `sign` refuses it, or `open` takes what was signed."""
    value, refused = KINDS[module], 0
    fields = getattr(value, "__struct_fields__", None) or [field.name for field in dataclasses.fields(value)]
    for name in fields:
        for wrong in WRONG:
            changed = copy.copy(value)
            object.__setattr__(changed, name, wrong) if dataclasses.is_dataclass(value) else structs.force_setattr(
                changed, name, wrong
            )
            try:
                text = module.sign(changed, SIGNER)
            except (CapabilityError, TypeError, AttributeError, ValueError, KeyError):
                refused += 1
            else:
                module.open(text, TRUSTED, DEFAULT)
    assert refused > 10


def sealed_text(module, claims: object) -> str | None:
    if not isinstance(claims, dict):
        header = {"typ": statement_form.type_of(module.KIND), "kid": keys.thumbprint(raw_of("signer"))}
        return jws.sign(header, strict_json.canonical(claims), SIGNER)
    return statement_form.sign(module.KIND, claims, SIGNER)


@pytest.mark.clause("STM-4")
@pytest.mark.parametrize(
    "value", [1.5, float("nan"), float("inf"), INT_LIMIT + 1, b"x", {1, 2}, object(), "\ud800", {1: 2}]
)
def test_what_no_statement_can_hold_is_not_signed(value):
    with pytest.raises(StatementError) as caught:
        statement_form.sign("checkpoint", {"x": value}, SIGNER)
    assert caught.value.code is FaultCode.STATEMENT_MALFORMED


# --- each kind -------------------------------------------------------------------------------------------------------------


@pytest.mark.clause("STM-5")
@pytest.mark.parametrize(
    "change",
    [
        {"version": 7},
        {"through": 7},
        {"through": 10},
        {"through": 1},
        {"since": 3},
        {"since": 7},
        {"edges": [{"version": 3, "delegator": "alice", "delegate": "a", "score_permille": 1_001}]},
        {"edges": [{"version": v, "delegator": "alice", "delegate": "a", "score_permille": 1} for v in (3, 4)]},
        {"nonce": "short"},
    ],
)
def test_a_word_on_conduct_is_consistent(change):
    text = statement_form.sign("conduct", {**claims_of(conduct), **change}, SIGNER)
    assert code_of(conduct, text) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-26")
@pytest.mark.parametrize("change", [{"not_after": NOW}, {"not_after": NOW + 31}, {"at": NOW + 30}, {"at": NOW - 1}])
def test_a_word_on_a_stop_counts_for_half_a_minute_at_most(change):
    text = statement_form.sign("stop", {**claims_of(stop), **change}, SIGNER)
    assert code_of(stop, text) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-26")
def test_the_longest_word_on_a_stop_fits_what_a_gateway_reads_of_one():
    url = "https://" + "a" * 240 + ".example"
    longest = structs.replace(SAID_STOP, issuer=url, audience=url, robot="r" * 256, person="p" * 256, reason='"' * 512)
    text = stop.sign(longest, SIGNER)
    assert len(text) <= stop.STOP_BYTES
    assert stop.open(text, TRUSTED, DEFAULT) == longest


@pytest.mark.clause("STM-5")
def test_the_largest_words_on_conduct_fit_a_statement():
    """As many as one word may hold are cut earlier where names are long; the provider counts bytes."""
    name = lambda kind, n: f"{kind}{n:04}".ljust(40, "x")
    edges = tuple(conduct.EdgeEntry(n + 1, name("d", n), name("a", n), 1_000) for n in range(conduct.ENTRIES))
    word = structs.replace(SEEN, since=0, version=1_024, through=1_024, edges=edges, agents=())
    assert conduct.open(conduct.sign(word, SIGNER), TRUSTED, DEFAULT) == word


@pytest.mark.clause("STM-5")
def test_evidence_names_the_key_that_signed_it():
    claims = {**claims_of(attestation), "key": keys.thumbprint(raw_of("other"))}
    assert code_of(attestation, statement_form.sign("attestation", claims, SIGNER)) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-5")
@pytest.mark.parametrize(
    "change",
    [
        {"epoch": 8},
        {"since": 3},
        {"entries": [{"epoch": 9, "kind": "agent", "id": "b"}, {"epoch": 3, "kind": "agent", "id": "a"}]},
        {"entries": [{"epoch": 2, "kind": "agent", "id": "b"}]},
        {"entries": [{"epoch": 10, "kind": "agent", "id": "b"}]},
        {"entries": [{"epoch": 3, "kind": "person", "id": "b"}]},
        {"nonce": "short"},
        {"nonce": "n" * 65},
    ],
)
def test_an_index_is_consistent(change):
    assert (
        code_of(revocation, statement_form.sign("revocation", {**claims_of(revocation), **change}, SIGNER))
        is FaultCode.STATEMENT_MALFORMED
    )


@pytest.mark.clause("STM-5")
def test_an_index_is_bounded():
    many = [{"epoch": 3, "kind": "agent", "id": f"a{i}"} for i in range(revocation.ENTRIES + 1)]
    text = statement_form.sign("revocation", {**claims_of(revocation), "entries": many}, SIGNER)
    assert code_of(revocation, text) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("TOK-9")
def test_a_view_that_was_never_read_knows_nothing_and_is_older_than_any_lease():
    view = revocation.RevocationView.never()
    assert view.why(chain_of(chain_of_four())) is None
    assert view.age_ms > 10**12


@pytest.mark.clause("TOK-9")
def test_a_view_asks_for_every_audience_when_none_is_given():
    chain = chain_of(chain_of_four())
    view = revocation.RevocationView(1, 0, frozenset({("audience", CELL)}))
    assert view.why(chain) == ("audience", CELL)
    assert view.why(chain, audience=CELL) == ("audience", CELL)
    assert view.why(chain, audience="http://127.0.0.1:9001/mcp") is None


@pytest.mark.clause("TOK-9")
@pytest.mark.parametrize("kind", list(revocation.Revoked))
def test_what_is_spared_is_what_there_is_no_reason_against(kind):
    chain = chain_of(chain_of_four())
    names = revocation.named(chain)
    assert len(names) == 2 + 3 * len(chain.hops)
    mine = [name for name in (*sorted(names), ("audience", CELL)) if name[0] == kind]
    for name in (*mine, (str(kind), "somebody-else")):
        view = revocation.RevocationView(1, 0, frozenset({name, ("agent", "eve")}))
        assert view.spares(names, audience=CELL) == (view.why(chain, audience=CELL) is None) == (name not in mine)


WORDS_OF_A_MESSAGE = {
    "to oneself": {"addressee": "orchestrator"},
    "from a role": {"sender": "role:planner"},
    "to a role": {"addressee": "role:planner"},
    "sequence 0": {"sequence": 0},
    "half an answer": {"in_reply_to": HEX[:-1]},
    "an answer in capitals": {"in_reply_to": HEX.upper()},
    "a short conversation": {"conversation": "c" * 15},
    "a hop that is none": {"hop_id": "0D" * 16},
    "a body that is a list": {"body": []},
    "a body that is a text": {"body": "{}"},
    "too long a body": {"body": {"x": "y" * BODY_BYTES}},
    "over before it was said": {"not_after": NOW},
    "too long a life": {"not_after": NOW + message.LIFETIME_S + 1},
    "no schema": {"schema": ""},
}


@pytest.mark.clause("STM-5")
@pytest.mark.parametrize("name", WORDS_OF_A_MESSAGE)
def test_a_message_is_well_formed(name):
    text = statement_form.sign("message", {**claims_of(message), **WORDS_OF_A_MESSAGE[name]}, SIGNER)
    assert code_of(message, text) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-4")
@pytest.mark.parametrize(
    "body", [b"", b"[]", b"null", b"{ }", b'{"b":1,"a":2}', b'{"a":1.5}', b'{"a":1,"a":1}', b"\xff"]
)
def test_a_body_that_is_not_canonical_is_not_signed(body):
    with pytest.raises(StatementError) as caught:
        message.sign(structs.replace(SAID, body=body), SIGNER)
    assert caught.value.code is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-1", "STM-5")
def test_the_largest_message_fits():
    frame = len(b'{"x":""}')
    full = structs.replace(
        SAID,
        sender="s" * 256,
        addressee="a" * 256,
        schema="x" * 256,
        body=b'{"x":"' + b"y" * (BODY_BYTES - frame) + b'"}',
        not_after=NOW + message.LIFETIME_S,
    )
    assert len(full.body) == BODY_BYTES
    assert message.open(message.sign(full, SIGNER), TRUSTED, DEFAULT) == full


PLACE = message.ExpectedMessage("orchestrator", "robotic", "g" * 22, "0d" * 16, "c" * 22, 2)
MISPLACED = {
    "another sender": ({"sender": "vision"}, FaultCode.STATEMENT_UNTRUSTED),
    "under another token": ({"token_id": "w" * 22}, FaultCode.STATEMENT_UNTRUSTED),
    "under another hop": ({"hop_id": "0e" * 16}, FaultCode.STATEMENT_UNTRUSTED),
    "to another": ({"addressee": "gripper"}, FaultCode.WRONG_AUDIENCE),
    "in another conversation": ({"conversation": "d" * 22}, FaultCode.WRONG_AUDIENCE),
    "heard before": ({"sequence": 2}, FaultCode.REPLAYED),
    "long heard": ({"sequence": 1}, FaultCode.REPLAYED),
    "one left out": ({"sequence": 4}, FaultCode.CHAIN_BROKEN),
    "of the future": ({"at": NOW + 7}, FaultCode.NOT_YET_VALID),
    "over": ({"not_after": NOW + 1, "at": NOW - 60}, FaultCode.EXPIRED),
}


@pytest.mark.clause("STM-6")
@pytest.mark.parametrize("name", MISPLACED)
def test_a_message_has_one_place(name):
    change, code = MISPLACED[name]
    said = message.open(message.sign(structs.replace(SAID, **change), SIGNER), TRUSTED, DEFAULT)
    fault = message.refusal(said, PLACE, at=NOW + 1, caps=DEFAULT)
    assert (fault.code, fault.clause) == (code, "STM-6")
    assert message.refusal(SAID, PLACE, at=NOW + 1, caps=DEFAULT) is None


@pytest.mark.clause("STM-5", "STM-6")
def test_an_answer_names_the_very_text():
    text = message.sign(SAID, SIGNER)
    assert message.digest_of(text) != message.digest_of(message.sign(structs.replace(SAID, sequence=4), SIGNER))
    answer = structs.replace(SAID, in_reply_to=message.digest_of(text))
    assert message.open(message.sign(answer, SIGNER), TRUSTED, DEFAULT).in_reply_to == vote.digest_of(text)


CALLED = response.Call(CELL, "robotic", "0d" * 16, "cd" * 32, HEX, "read_state")
NO_ANSWERS = {
    "of another enforcement point": ({"audience": ISSUER}, FaultCode.STATEMENT_UNTRUSTED),
    "to another agent": ({"agent": "vision"}, FaultCode.WRONG_AUDIENCE),
    "to another hop": ({"hop_id": "0e" * 16}, FaultCode.WRONG_AUDIENCE),
    "to the same request, earlier": ({"proof": "ce" * 32}, FaultCode.PROOF_NOT_FOR_THIS_REQUEST),
    "to another request": ({"request": "ce" * 32}, FaultCode.PROOF_NOT_FOR_THIS_REQUEST),
    "of another tool": ({"tool": "move_joint"}, FaultCode.PROOF_NOT_FOR_THIS_REQUEST),
    "of the future": ({"at": NOW + 7}, FaultCode.NOT_YET_VALID),
    "over": ({"at": NOW - 60, "not_after": NOW + 1}, FaultCode.EXPIRED),
}


@pytest.mark.clause("STM-11")
@pytest.mark.parametrize("name", NO_ANSWERS)
def test_a_response_is_to_one_call(name):
    change, code = NO_ANSWERS[name]
    said = response.open(response.sign(structs.replace(ANSWERED, **change), SIGNER), TRUSTED, DEFAULT)
    fault = response.refusal(said, CALLED, at=NOW + 1, caps=DEFAULT)
    assert (fault.code, fault.clause) == (code, "STM-11")
    assert response.refusal(ANSWERED, CALLED, at=NOW + 1, caps=DEFAULT) is None


@pytest.mark.clause("STM-5")
@pytest.mark.parametrize("change", [{"not_after": NOW}, {"not_after": NOW + response.LIFETIME_S + 1}])
def test_a_response_lives_for_a_while(change):
    text = statement_form.sign("response", {**claims_of(response), **change}, SIGNER)
    assert code_of(response, text) is FaultCode.STATEMENT_MALFORMED


NO_ROWS = {
    "the first row follows another": {"sequence": 1},
    "a later row follows none": {"previous": memory.FIRST_PREVIOUS},
    "no source": {"sources": []},
    "a source twice": {"sources": ["agent", "agent"]},
    "signers out of order": {"signers": ["robotic", "dora"]},
    "an unknown integrity": {"integrity": "certain"},
    "an audience behind it": {"behind": [{"kind": "audience", "id": CELL}]},
    "names behind it out of order": {"behind": [{"kind": "hop", "id": "b"}, {"kind": "agent", "id": "a"}]},
    "too many behind it": {"behind": [{"kind": "hop", "id": f"h{n:02}"} for n in range(memory.BEHIND + 1)]},
}


@pytest.mark.clause("STM-12")
@pytest.mark.parametrize("name", NO_ROWS)
def test_a_row_of_a_memory_is_well_formed(name):
    text = statement_form.sign("memory", {**claims_of(memory), **NO_ROWS[name]}, SIGNER)
    assert code_of(memory, text) is FaultCode.STATEMENT_MALFORMED


A_DOCUMENT = {"id": "a", "digest": HEX, "source": "s"}
LISTS_THAT_ARE_NONE = {
    "an id twice": {"entries": [A_DOCUMENT, {**A_DOCUMENT, "digest": "cd" * 32}]},
    "out of order": {"entries": [{**A_DOCUMENT, "id": "b"}, A_DOCUMENT]},
    "too many": {"entries": [{**A_DOCUMENT, "id": f"d{n:04}"} for n in range(manifest.ENTRIES + 1)]},
    "an id in another script": {"entries": [{**A_DOCUMENT, "id": "gr\u0456pping"}]},
    "an id that is decomposed": {"entries": [{**A_DOCUMENT, "id": "gru\u0308n"}]},
    "an id that turns the line": {"entries": [{**A_DOCUMENT, "id": "a\u202eb"}]},
    "no version": {"version": 0},
    "another content": {"content": "instruction"},
    "over before it was signed": {"not_after": NOW},
    "too long a life": {"not_after": NOW + manifest.LIFETIME_S + 1},
}


@pytest.mark.clause("STM-5")
@pytest.mark.parametrize("name", LISTS_THAT_ARE_NONE)
def test_a_manifest_is_well_formed(name):
    text = statement_form.sign("manifest", {**claims_of(manifest), **LISTS_THAT_ARE_NONE[name]}, SIGNER)
    assert code_of(manifest, text) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-1", "STM-5")
def test_the_largest_manifest_fits():
    long = "x" * 59
    full = structs.replace(
        LISTED,
        collection="c" * 256,
        curator="d" * 256,
        entries=tuple(manifest.ManifestEntry(f"{n:04}{long}", HEX, f"{long}{n:04}") for n in range(manifest.ENTRIES)),
        not_after=NOW + manifest.LIFETIME_S,
    )
    assert manifest.open(manifest.sign(full, SIGNER), TRUSTED, DEFAULT) == full


SHELF = manifest.ExpectedManifest("procedures", "document", "dora", 0, "")
OFF_THE_SHELF = {
    "of another curator": ({"curator": "eve"}, SHELF, FaultCode.STATEMENT_UNTRUSTED),
    "of another collection": ({"collection": "recipes"}, SHELF, FaultCode.WRONG_AUDIENCE),
    "of scenarios": ({"content": "scenario"}, SHELF, FaultCode.WRONG_AUDIENCE),
    "an older one": ({"version": 3}, dataclasses.replace(SHELF, version=4, digest=HEX), FaultCode.REPLAYED),
    "another of its version": ({}, dataclasses.replace(SHELF, version=4, digest=HEX), FaultCode.REPLAYED),
    "of the future": ({"at": NOW + 7}, SHELF, FaultCode.NOT_YET_VALID),
    "over": ({"at": NOW - 60, "not_after": NOW + 1}, SHELF, FaultCode.EXPIRED),
}


@pytest.mark.clause("STM-7")
@pytest.mark.parametrize("name", OFF_THE_SHELF)
def test_a_manifest_has_one_place(name):
    change, place, code = OFF_THE_SHELF[name]
    text = manifest.sign(structs.replace(LISTED, **change), SIGNER)
    said = manifest.open(text, TRUSTED, DEFAULT)
    fault = manifest.refusal(said, manifest.digest_of(text), place, at=NOW + 1, caps=DEFAULT)
    assert (fault.code, fault.clause) == (code, "STM-7")


@pytest.mark.clause("STM-7")
def test_a_manifest_may_be_read_again_and_followed_by_a_newer_one():
    text = manifest.sign(LISTED, SIGNER)
    for digest, version in (("", 0), (manifest.digest_of(text), 4), (HEX, 3)):
        place = dataclasses.replace(SHELF, version=version, digest=digest)
        assert manifest.refusal(LISTED, manifest.digest_of(text), place, at=NOW + 1, caps=DEFAULT) is None


NO_INTENTS = {
    "no person": {"subject": ""},
    "a person in another script": {"subject": "\u0430lice"},
    "a short nonce": {"nonce": "n" * 15},
    "a body that is a text": {"body": "sort the red parts"},
    "a body that is too large": {"body": {"text": "x" * BODY_BYTES}},
    "over before it was signed": {"not_after": NOW},
    "too long a life": {"not_after": NOW + intent.LIFETIME_S + 1},
}


@pytest.mark.clause("STM-5")
@pytest.mark.parametrize("name", NO_INTENTS)
def test_an_intent_is_well_formed(name):
    text = statement_form.sign("intent", {**claims_of(intent), **NO_INTENTS[name]}, SIGNER)
    assert code_of(intent, text) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-4")
@pytest.mark.parametrize("body", [b'{"b":1,"a":2}', b'{"a": 1}', b"[]", b'{"a":1,"a":1}', b'{"a":NaN}', b'{"a":0.5}'])
def test_an_intent_is_signed_in_one_spelling(body):
    with pytest.raises(StatementError) as caught:
        intent.sign(structs.replace(WANTED, body=body), SIGNER)
    assert caught.value.code is FaultCode.STATEMENT_MALFORMED


def within_mandate(**changes):
    return {"scope": {**claims_of(mandate)["scope"], **changes}}


NO_MANDATES = {
    "a token's id": {"mandate_id": "g" * 22},
    "an id in capitals": {"mandate_id": "0F" * 16},
    "an issuer with a slash": {"issuer": f"{ISSUER}/"},
    "no sponsor": {"sponsor": ""},
    "a role for an agent": {"agent": "role:robotic"},
    "a key for a thumbprint": {"agent_key": "k" * 44},
    "a purpose that cannot be seen": {"purpose": "tidy\u200b"},
    "a purpose that is too long": {"purpose": "x" * 513},
    "no scope": {"scope": None},
    "a scope of no grant": lambda: within_mandate(grants=[]),
    "a scope with one more member": lambda: within_mandate(more=1),
    "a ceiling of 5": lambda: within_mandate(ceiling=5),
    "audiences out of order": lambda: within_mandate(audiences=[OTHER_CELL, CELL]),
    "a negative time": {"at": -1},
    "over before it was signed": lambda: within_mandate(not_after=NOW),
    "too long a life": lambda: within_mandate(not_after=NOW + mandate.LIFETIME_S + 1),
    "signed so early that its life is too long": {"at": NOW - 1},
}


@pytest.mark.clause("STM-5", "STM-16")
@pytest.mark.parametrize("name", NO_MANDATES)
def test_a_mandate_is_well_formed(name):
    change = NO_MANDATES[name]
    claims = claims_of(mandate) | (change() if callable(change) else change)
    assert code_of(mandate, statement_form.sign("mandate", claims, SIGNER)) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-13", "STM-16")
def test_no_mandate_is_signed_that_lasts_longer_than_a_week():
    scope = dataclasses.replace(PROMISED.scope, not_after=NOW + mandate.LIFETIME_S + 1)
    with pytest.raises(StatementError) as caught:
        mandate.sign(structs.replace(PROMISED, scope=scope), SIGNER)
    assert caught.value.code is FaultCode.STATEMENT_MALFORMED


INTENTS_OUT_OF_PLACE = {
    "of another person": ({}, "bob", NOW, FaultCode.STATEMENT_UNTRUSTED),
    "of the future": ({"at": NOW + 6}, "alice", NOW, FaultCode.NOT_YET_VALID),
    "over": ({}, "alice", NOW + 3_600, FaultCode.EXPIRED),
}


@pytest.mark.clause("STM-9")
@pytest.mark.parametrize("name", INTENTS_OUT_OF_PLACE)
def test_an_intent_has_its_person_and_its_time(name):
    change, subject, at, code = INTENTS_OUT_OF_PLACE[name]
    fault = intent.refusal(structs.replace(WANTED, **change), subject=subject, at=at, caps=DEFAULT)
    assert (fault.code, fault.clause) == (code, "STM-9")
    assert intent.refusal(WANTED, subject="alice", at=NOW + 3_599, caps=DEFAULT) is None
    assert intent.refusal(structs.replace(WANTED, at=NOW + 5), subject="alice", at=NOW, caps=DEFAULT) is None


def purposed(*purposes):
    chain = chain_of(chain_of_four())
    hops = tuple(dataclasses.replace(hop, purpose=p) for hop, p in zip(chain.hops, purposes, strict=False))
    return dataclasses.replace(chain, hops=hops)


@pytest.mark.clause("STM-9")
@pytest.mark.parametrize(
    ("purposes", "bound"),
    [
        ((f"intent:{HEX}",), HEX),
        ((intent.purpose(HEX, "sort the red parts"), "grip"), HEX),
        (("sort the red parts",), ""),
        (("sort the red parts", f"intent:{HEX}"), ""),
        ((f"intent:{HEX}", "intent:" + "cd" * 32), HEX),
        ((f"intent:{HEX}0",), ""),
        ((f"intent:{HEX},",), ""),
        ((f" intent:{HEX}",), ""),
        ((f"Intent:{HEX}",), ""),
        ((f"intent:{HEX.upper()}",), ""),
        ((f"intent: {HEX}",), ""),
        ((f"not intent:{HEX}",), ""),
    ],
)
def test_a_delegation_is_bound_by_its_first_purpose_alone(purposes, bound):
    assert intent.bound(purposed(*purposes)) == bound


NO_RECEIPTS = {
    "no source": {"sources": []},
    "a source twice": {"sources": ["agent", "agent"]},
    "sources out of order": {"sources": ["tool", "agent"]},
    "an unknown source": {"sources": ["hearsay"]},
    "a signer twice": {"signers": ["dora", "dora"]},
    "signers out of order": {"signers": ["dora", "camera-1"]},
    "a signer in another script": {"signers": ["d\u043era"]},
    "too many signers": {"signers": [f"s{n:02}" for n in range(admission.SIGNERS + 1)]},
    "an unknown integrity": {"integrity": "5"},
    "a negative age": {"age_ms": -1},
    "a taint that is a number": {"tainted": 0},
    "a digest in capitals": {"value": HEX.upper()},
    "over before it was given": {"not_after": NOW},
    "too long a life": {"not_after": NOW + admission.LIFETIME_S + 1},
}


@pytest.mark.clause("STM-5")
@pytest.mark.parametrize("name", NO_RECEIPTS)
def test_a_receipt_is_well_formed(name):
    text = statement_form.sign("admission", {**claims_of(admission), **NO_RECEIPTS[name]}, SIGNER)
    assert code_of(admission, text) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-5")
@pytest.mark.parametrize("member", ["tools", "sensors", "trust"])
def test_a_snapshot_names_each_once(member):
    claims = claims_of(registry)
    text = statement_form.sign("registry", {**claims, member: claims[member] * 2}, SIGNER)
    assert code_of(registry, text) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-5")
def test_a_snapshot_answers_by_name():
    assert SNAPSHOT.tool("move_joint").base_tier is Tier.REVERSIBLE
    assert SNAPSHOT.sensor("camera-1").transit_ms == 100
    assert SNAPSHOT.trust_permille("robotic") == 800
    assert (SNAPSHOT.tool("x"), SNAPSHOT.sensor("x"), SNAPSHOT.trust_permille("x")) == (None, None, None)


@pytest.mark.clause("STM-5")
@pytest.mark.parametrize(
    "shape",
    [
        {"form": "cone", "center_um": [0, 0, 0], "radius_um": 1},
        {"form": "sphere", "center_um": [0, 0], "radius_um": 1},
        {"form": "sphere", "center_um": [0, 0, 0, 0], "radius_um": 1},
        {"form": "sphere", "center_um": [0, 0, 0], "radius_um": 0},
        {"form": "sphere", "center_um": [0, 0, 0], "radius_um": -5},
        {"form": "sphere", "center_um": [0, 0, 100_000_001], "radius_um": 5},
        {"form": "sphere", "center_um": [0, 0, True], "radius_um": 5},
        {"form": "sphere", "center_um": [0, 0, "0"], "radius_um": 5},
        {"form": "sphere", "center_um": [0, 0, 0], "radius_um": 5, "extra": 1},
        {"form": "box", "center_um": [0, 0, 0], "half_um": [1, 1, 1], "quaternion_ppm": [0, 0, 0, 0]},
        {"form": "box", "center_um": [0, 0, 0], "half_um": [1, 1, 1], "quaternion_ppm": [1_000_000, 1_000_000, 0, 0]},
        {"form": "box", "center_um": [0, 0, 0], "half_um": [0, 1, 1], "quaternion_ppm": [1_000_000, 0, 0, 0]},
        {"form": "capsule", "a_um": [0, 0, 0], "radius_um": 5},
        {"form": "convex", "vertices_um": CORNERS[:3], "radius_um": 0},
        {"form": "convex", "vertices_um": [*CORNERS, CORNERS[0]], "radius_um": 0},
        {"form": "convex", "vertices_um": [[k, k * k, k**3] for k in range(65)], "radius_um": 0},
        {"form": "convex", "vertices_um": [[0, 0, 0], [1, 2, 3], [2, 4, 6], [3, 6, 9]], "radius_um": 0},
        {"form": "convex", "vertices_um": [[0, 0, 5], [1, 0, 5], [0, 1, 5], [7, 9, 5], [-3, 8, 5]], "radius_um": 9},
        {"form": "convex", "vertices_um": CORNERS, "radius_um": -1},
        {"form": "convex", "vertices_um": CORNERS},
        {"form": "convex", "vertices_um": [*CORNERS, [0, 0, 100_000_001]], "radius_um": 0},
        {"form": "convex", "vertices_um": [*CORNERS, [0, 0]], "radius_um": 0},
        {"form": "convex", "vertices_um": "abcd", "radius_um": 0},
    ],
)
def test_a_shape_is_well_formed(shape):
    claims = claims_of(observation)
    wrong = put(claims, ("objects", 0, "shape"), shape)
    assert code_of(observation, statement_form.sign("observation", wrong, SIGNER)) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-5")
@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("people", 0, "regions"), []),
        (("people", 0, "regions", 0, "region"), "tail"),
        (
            ("people", 0, "regions", 0, "shape"),
            {"form": "box", "center_um": [0, 0, 0], "half_um": [1, 1, 1], "quaternion_ppm": [1_000_000, 0, 0, 0]},
        ),
        (
            ("people", 0, "regions", 0, "shape"),
            {"form": "convex", "vertices_um": CORNERS, "radius_um": 0},
        ),
        (("people", 1, "age_ms"), 0),  # left out then: one spelling
        (("people", 1, "age_ms"), -1),
        (("people", 1, "age_ms"), 3_600_001),
        (("objects", 1, "age_ms"), True),
        (("objects", 1, "age_ms"), None),
        (("objects", 0, "kind"), "soft"),
        (("boot_id",), "0F" * 16),
        (("complete",), 1),
        (("sequence",), -1),
    ],
)
def test_a_frame_is_well_formed(path, value):
    wrong = put(claims_of(observation), path, value)
    assert code_of(observation, statement_form.sign("observation", wrong, SIGNER)) is FaultCode.STATEMENT_MALFORMED


ACT = structs.replace(
    ASKED,
    perception="none",
    start_urad=(),
    index_milli=0,
    contributors=(),
    perception_age_ms=None,
    facts=(
        ask.AskedFact("zone-a/people", "fresh", Unit.COUNT, 1, 120, True),
        ask.AskedFact("tank/level", "missing", Unit.PERMILLE, None, None, False),
    ),
)


@pytest.mark.clause("STM-5", "FCT-3")
def test_an_ask_with_facts_comes_back():
    assert ask.open(ask.sign(ACT, SIGNER), TRUSTED, DEFAULT) == ACT
    assert [fact.contributor for fact in ACT.facts] == [("fact", "zone-a/people"), ("fact-unseen", "tank/level")]


@pytest.mark.clause("STM-5")
@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("facts",), []),  # left out then: one spelling
        (("facts", 0, "state"), "old"),
        (("facts", 0, "unit"), "metre"),
        (("facts", 0, "value"), "1"),
        (("facts", 0, "age_ms"), -1),
        (("facts", 0, "raises"), 1),
        (("facts", 1, "fact"), "zone-a/people"),
        (("facts", 0, "fact"), "zone a"),
        (("perception",), "missing"),  # a robot's act has physics
    ],
)
def test_an_ask_with_facts_is_well_formed(path, value):
    claims = json.loads(jws.split(ask.sign(ACT, SIGNER), most_bytes=10**6).payload_raw)
    text = statement_form.sign("ask", put(claims, path, value), SIGNER)
    assert code_of(ask, text) is FaultCode.STATEMENT_MALFORMED


STATED = structs.replace(
    FRAME,
    facts=(observation.ObservedFact("people", "count", 2), observation.ObservedFact("oven", "mdegC", -INT_LIMIT)),
)


@pytest.mark.clause("STM-5", "FCT-1")
def test_a_frame_with_facts_comes_back():
    text = observation.sign(STATED, SIGNER)
    assert observation.open(text, TRUSTED, DEFAULT) == STATED
    assert observation.sign(structs.replace(STATED, facts=()), SIGNER) == observation.sign(FRAME, SIGNER)


@pytest.mark.clause("STM-5", "FCT-1")
@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("facts", 0, "value"), False),
        (("facts", 0, "value"), "2"),
        (("facts", 0, "value"), None),
        (("facts", 0, "unit"), "metre"),
        (("facts", 0, "unit"), "flag"),
        (("facts", 0, "name"), "zone/people"),
        (("facts", 0, "name"), ""),
        (("facts", 0), {"name": "people", "value": 1}),
        (("facts", 0), {"name": "people", "unit": "count", "value": 1, "age_ms": 1}),
        (("facts", 1, "name"), "people"),
        (("facts",), []),  # left out then: one spelling
        (("facts",), None),
        (("facts",), [{"name": f"f{n}", "unit": "count", "value": n} for n in range(65)]),
    ],
)
def test_a_fact_is_well_formed(path, value):
    claims = json.loads(jws.split(observation.sign(STATED, SIGNER), most_bytes=10**6).payload_raw)
    wrong = put(claims, path, value)
    assert code_of(observation, statement_form.sign("observation", wrong, SIGNER)) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-5", "FCT-1")
@pytest.mark.parametrize("value", [2**53, -(2**53), 0.5])
def test_a_fact_that_not_every_reader_keeps_is_not_signed(value):
    stated = structs.replace(STATED, facts=(observation.ObservedFact("people", "count", value),))
    with pytest.raises(StatementError) as refused:
        observation.sign(stated, SIGNER)
    assert refused.value.code is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-5")
def test_what_was_seen_in_the_frame_itself_has_no_age_of_its_own():
    claims = claims_of(observation)
    assert ["age_ms" in each for each in (*claims["people"], *claims["objects"])] == [False, True, False, True]


@pytest.mark.clause("STM-5")
def test_a_frame_names_each_once():
    claims = claims_of(observation)
    for member in ("people", "objects"):
        assert (
            code_of(observation, statement_form.sign("observation", {**claims, member: claims[member] * 2}, SIGNER))
            is FaultCode.STATEMENT_MALFORMED
        )


@pytest.mark.clause("STM-5")
@pytest.mark.parametrize("source", ["", None, 1, "two words"])
def test_what_no_sensor_speaks_of_has_no_source(source):
    claims = claims_of(ask)
    assert ["source" in each for each in claims["contributors"]] == [True, False]
    claims["contributors"][1]["source"] = source
    assert code_of(ask, statement_form.sign("ask", claims, SIGNER)) is FaultCode.STATEMENT_MALFORMED


VALUES = (
    Quantity("bar", DeclaredUnit("x-bar", 1_000), 7),
    argument("word", Sort.TEXT, "é pump"),
    argument("file", Sort.PATH, "/srv/a"),
    argument("page", Sort.URL, "https://a.example"),
    argument("bleed", Sort.FLAG, False),
    argument("filter", Sort.FREE, {"a": [1]}),
    argument("tags", ListOf(Sort.TEXT), ["a"]),
)


@pytest.mark.clause("STM-5")
def test_an_ask_states_values_of_each_kind():
    asked = structs.replace(ASKED, values=VALUES)
    assert ask.open(ask.sign(asked, SIGNER), TRUSTED, DEFAULT) == asked
    assert [{"unit", "kind"} & each.keys() for each in ask.claims(asked)["values"]] == [{"unit"}, *[{"kind"}] * 6]


@pytest.mark.clause("STM-5")
@pytest.mark.parametrize(
    "stated",
    [
        {"name": "x", "kind": "count", "value": 1}, {"name": "x", "unit": "text", "value": "a"}, {"name": "x", "value": 1},
        {"name": "x", "unit": "count", "kind": "count", "value": 1}, {"name": "x", "unit": "count", "value": True},
        {"name": "x", "kind": "text", "value": "a\u202eb"}, {"name": "x", "kind": "path", "value": "/a/../b"},
        {"name": "x", "kind": "free", "value": {"a": 1}}, {"name": "x", "unit": "x-bar", "value": 1},
    ],
)  # fmt: skip
def test_an_ask_with_another_value_is_malformed(stated):
    text = statement_form.sign("ask", {**claims_of(ask), "values": [stated]}, SIGNER)
    assert code_of(ask, text) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-5")
def test_an_ask_is_no_longer_than_people_read():
    words = tuple(argument(f"w{n}", Sort.TEXT, "x" * 1_000) for n in range(17))
    ask.sign(structs.replace(ASKED, values=words[:16]), SIGNER)
    with pytest.raises(StatementError) as refused:
        ask.sign(structs.replace(ASKED, values=words), SIGNER)
    assert refused.value.code is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-1")
def test_the_largest_snapshot_fits():
    """The counts and the size cap of a statement belong together."""
    long = "x" * 59
    full = registry.RegistrySnapshot(
        ISSUER,
        1,
        CELL,
        NOW,
        tuple(registry.ToolEntry(f"{long}{i:04}", HEX, long + "xxxx", Tier(1)) for i in range(registry.TOOLS)),
        tuple(registry.SensorEntry(f"{long}{i:04}", raw_of("alice"), HEX, 10_000) for i in range(registry.SENSORS)),
        tuple(registry.TrustEntry(f"{long}{i:04}", 1_000) for i in range(registry.AGENTS)),
        tuple(registry.PartyEntry(f"{long}{i:04}", raw_of(f"alice{i}")) for i in range(registry.APPROVERS)),
        tuple(registry.PartyEntry(f"{long}{i:04}", raw_of("alice")) for i in range(registry.PEPS)),
        tuple(f"{long}{i:04}" for i in range(registry.SUSPENDED)),
    )
    assert registry.open(registry.sign(full, SIGNER), TRUSTED, DEFAULT) == full


SPHERE = {"form": "sphere", "center_um": [0, 0, 0], "radius_um": 1}
CONTRADICTORY_CELLS = {
    "no sensor": {"sensors": []},
    "a sensor twice": {"sensors": ["camera-1", "camera-1"]},
    "an object twice": {"objects": [{"name": "a", "kind": "rigid", "shape": SPHERE}] * 2},
    "an object and a zone of one name": {
        "objects": [{"name": "a", "kind": "rigid", "shape": SPHERE}],
        "zones": [{"name": "a", "tier": 2, "shape": SPHERE}],
    },
    "a contact twice": {"contacts": [{"object": "table", "by": "tool", "observed": o} for o in (True, False)]},
    "a contact with a hand": {"contacts": [{"object": "table", "by": "hand", "observed": False}]},
    "an output twice": {"outputs": [{"number": 1, "name": n, "tier": 1} for n in "ab"]},
    "an output name twice": {"outputs": [{"number": n, "name": "a", "tier": 1} for n in (1, 2)]},
    "an output that no controller has": {"outputs": [{"number": 18, "name": "a", "tier": 1}]},
    "an output of tier 5": {"outputs": [{"number": 1, "name": "a", "tier": 5}]},
    "a zone of tier 0": {"zones": [{"name": "a", "tier": 0, "shape": SPHERE}]},
    "a zone of tier 5": {"zones": [{"name": "a", "tier": 5, "shape": SPHERE}]},
    "a zone without shape": {"zones": [{"name": "a", "tier": 2}]},
    "a size of 0": {"objects": [{"name": "a", "kind": "rigid", "shape": {**SPHERE, "radius_um": 0}}]},
    "a quaternion that turns nothing": {
        "objects": [
            {
                "name": "a",
                "kind": "rigid",
                "shape": {"form": "box", "center_um": [0, 0, 0], "half_um": [1, 1, 1], "quaternion_ppm": [0, 0, 0, 0]},
            }
        ]
    },
    "a kind that is none": {"objects": [{"name": "a", "kind": "soft", "shape": SPHERE}]},
    "a workspace without extent": {"workspace": {"low_um": [0, 0, 0], "high_um": [1, 0, 1]}},
    "a workspace turned round": {"workspace": {"low_um": [1, 1, 1], "high_um": [0, 0, 0]}},
    "it ends before it begins": {"not_before": NOW, "not_after": NOW},
    "it lives for more than a year": {"not_before": NOW, "not_after": NOW + 366 * 86_400 + 1},
    "a payload that nothing carries": {"payload_g": 100_001},
    "too many objects": {
        "objects": [{"name": f"o{i}", "kind": "rigid", "shape": SPHERE} for i in range(cell.OBJECTS + 1)]
    },
    "too many zones": {"zones": [{"name": f"z{i}", "tier": 1, "shape": SPHERE} for i in range(cell.ZONES + 1)]},
    "too many sensors": {"sensors": [f"s{i}" for i in range(cell.SENSORS + 1)]},
}


@pytest.mark.clause("STM-5")
@pytest.mark.parametrize("name", CONTRADICTORY_CELLS)
def test_a_cell_does_not_contradict_itself(name):
    text = statement_form.sign("cell", {**claims_of(cell), **CONTRADICTORY_CELLS[name]}, SIGNER)
    assert code_of(cell, text) is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("STM-1")
def test_the_largest_cell_fits():
    long = "x" * 200
    box = observation.Box((-(10**7),) * 3, (10**7,) * 3, (1_000_000, 0, 0, 0))
    full = structs.replace(
        SURVEY,
        objects=tuple(cell.Surveyed(f"o{i}{long}", "fragile", box) for i in range(cell.OBJECTS)),
        zones=tuple(cell.Zone(f"z{i}{long}", Tier(4), box) for i in range(cell.ZONES)),
        contacts=tuple(cell.Contact(f"o{i}{long}", "payload", False) for i in range(cell.CONTACTS)),
        outputs=tuple(cell.Output(i, f"{i}{long}", Tier(4)) for i in range(cell.OUTPUTS)),
        sensors=tuple(f"{i}{long}" for i in range(cell.SENSORS)),
    )
    assert cell.open(cell.sign(full, SIGNER), TRUSTED, DEFAULT) == full


@pytest.mark.clause("STM-15")
@pytest.mark.parametrize(
    "entries",
    [
        KNOWN.entries[::-1],
        (KNOWN.entries[0], KNOWN.entries[0]),
        (mark.MarkEntry("key", "robotic"),),
        (mark.MarkEntry("hop", "robotic"),),
    ],
)
def test_a_mark_holds_each_revocation_once_in_order_and_in_its_form(entries):
    claims = claims_of(mark) | {"entries": [{"kind": entry.kind, "id": entry.id} for entry in entries]}
    assert code_of(mark, statement_form.sign(mark.KIND, claims, SIGNER)) is FaultCode.STATEMENT_MALFORMED
    without = claims_of(mark) | {"entries": [], "head": ""}
    assert mark.open(statement_form.sign(mark.KIND, without, SIGNER), TRUSTED, DEFAULT).entries == ()
