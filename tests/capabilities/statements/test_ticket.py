"""Tickets: for one request, one gateway, one moment; each step refuses by itself, and no changed byte passes."""

from __future__ import annotations

import dataclasses
import hashlib

import pytest
from capabilities.statements.revocation import RevocationView
from capabilities.statements.ticket import RequestDigests, Ticket
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import Fault, FaultCode
from hypothesis import given
from hypothesis import strategies as st
from pep.journal.replay_cache import ReplayCache
from tests.capabilities.keys.test_keys import curve_of
from tests.capabilities.statements.test_statements import ANSWERED
from tests.capabilities.world import CELL, NOW, OTHER_CELL, VIEW, key_of, raw_of

from capabilities.keys import jws, keys
from capabilities.statements import statement_form, ticket
from capabilities.statements.context import response
from capabilities.values import strict_json

CALLS = "http://127.0.0.1:8902/calls"
ID = "0e" * 16
TOKEN, PROOF, BODY = "token-text", "proof-text", b'{"method":"tools/call"}'
CALL = RequestDigests.of(token=TOKEN, proof=PROOF, body=BODY)
PEPS = {"door-1": raw_of("door"), "door-2": raw_of("door-2")}


def issued(carried=CALL, *, key=None, at=NOW, **changes):
    given = {"id": ID, "pep": "door-1", "audience": CELL, "url": CALLS, **changes}
    return ticket.issue(carried, key=key or key_of("door"), at=at, **given)


def verified(text, carried=CALL, **changes):
    given = {"peps": PEPS, "view": VIEW, "audience": CELL, "url": CALLS, "at": NOW + 0.25, "caps": DEFAULT, **changes}
    return ticket.verify(text, carried, **given)


def refused(found):
    assert isinstance(found, Fault)
    return found.clause, found.code


@pytest.mark.clause("TKT-1", "TKT-2", "TKT-4", "TKT-5", "TKT-6")
@pytest.mark.parametrize("key", [key_of("door"), curve_of("door")], ids=["ed25519", "p256"])
def test_a_ticket_for_this_request_here_and_now(key):
    found = verified(issued(key=key), peps={"door-1": keys.public_raw(key)})
    assert found == Ticket(ID, "door-1", CELL, CALLS, CALL, NOW * 1_000)


@pytest.mark.clause("TKT-1")
def test_the_header_is_fixed():
    header = jws.split(issued(), most_bytes=ticket.BYTES).header
    assert header == {"alg": "EdDSA", "typ": "ztpm-ticket+jwt", "kid": keys.thumbprint(raw_of("door"))}


def forged(*, by="door", **claims):
    """A ticket whose claims say something else, signed by the right key."""
    stated = strict_json.parse_object(jws.split(issued(), most_bytes=ticket.BYTES).payload_raw)
    return statement_form.sign(ticket.KIND, {**stated, **claims}, key_of(by))


FORMS = {
    "nothing": ("", FaultCode.STATEMENT_MALFORMED),
    "a letter that is no base64url": ("ä", FaultCode.STATEMENT_MALFORMED),
    "half a surrogate pair": ("\ud800", FaultCode.STATEMENT_MALFORMED),
    "a text too long, before anybody asks who signed": (
        forged(by="eve", audience="http://a/" + "x" * ticket.BYTES),
        FaultCode.STATEMENT_MALFORMED,
    ),
    "another kind by the same key": (response.sign(ANSWERED, key_of("door")), FaultCode.STATEMENT_WRONG_KIND),
    "an unknown member": (forged(more=1), FaultCode.STATEMENT_MALFORMED),
    "a time that is none": (forged(at_ms="now"), FaultCode.STATEMENT_MALFORMED),
    "a short id": (forged(id="0e"), FaultCode.STATEMENT_MALFORMED),
    "by a stranger": (issued(key=key_of("eve")), FaultCode.STATEMENT_UNTRUSTED),
}


@pytest.mark.clause("TKT-1")
@pytest.mark.parametrize("name", FORMS)
def test_what_is_no_ticket(name):
    text, code = FORMS[name]
    assert refused(verified(text)) == ("TKT-1", code)


@pytest.mark.clause("TKT-1")
def test_where_nobody_is_enrolled_nobody_is_believed():
    assert refused(verified(issued(), peps={})) == ("TKT-1", FaultCode.STATEMENT_UNTRUSTED)


@pytest.mark.clause("TKT-1")
def test_a_registered_key_that_is_none_refuses_and_does_not_break():
    assert refused(verified(issued(), peps={"door-1": b"short"})) == ("TKT-1", FaultCode.KEY_MALFORMED)


@pytest.mark.clause("TKT-1")
@pytest.mark.parametrize("key", [key_of("door"), curve_of("door")], ids=["ed25519", "p256"])
def test_the_longest_ticket_fits(key):
    longest = issued(key=key, pep="p" * 256, audience="http://" + "a" * 249, url="http://" + "b" * 249, at=253402300799)
    assert len(longest) <= ticket.BYTES
    found = verified(
        longest,
        peps={"p" * 256: keys.public_raw(key)},
        audience="http://" + "a" * 249,
        url="http://" + "b" * 249,
        at=253402300799,
    )
    assert isinstance(found, Ticket)


@pytest.mark.clause("TKT-2")
def test_a_tool_server_speaks_for_itself_alone():
    assert refused(verified(issued(key=key_of("door-2")))) == ("TKT-2", FaultCode.STATEMENT_UNTRUSTED)
    assert refused(verified(issued(pep="door-3"))) == ("TKT-2", FaultCode.STATEMENT_UNTRUSTED)


@pytest.mark.clause("TKT-3")
def test_a_revoked_key_opens_no_ticket():
    def view(raw):
        return RevocationView(4, 100, frozenset({("key", keys.b64u(keys.thumbprint_bytes(raw)))}))

    assert refused(verified(issued(), view=view(PEPS["door-1"]))) == ("TKT-3", FaultCode.STATEMENT_UNTRUSTED)
    assert isinstance(verified(issued(), view=view(PEPS["door-2"])), Ticket)


@pytest.mark.clause("TKT-4")
def test_another_gateway_or_cell_does_not_take_it():
    assert refused(verified(issued(), url="http://127.0.0.1:8903/calls")) == ("TKT-4", FaultCode.WRONG_AUDIENCE)
    assert refused(verified(issued(), audience=OTHER_CELL)) == ("TKT-4", FaultCode.WRONG_AUDIENCE)


OTHERS = {
    "another body": {"body": BODY + b" "},
    "no body": {"body": b""},
    "another token": {"token": TOKEN + "A"},
    "no token": {"token": None},
    "another proof": {"proof": PROOF + "A"},
    "no proof": {"proof": None},
    "token and proof changed about": {"token": PROOF, "proof": TOKEN},
    "a token that no header can spell": {"token": "\ud800"},
}


@pytest.mark.clause("TKT-5")
@pytest.mark.parametrize("name", OTHERS)
def test_another_request(name):
    carried = RequestDigests.of(**{"token": TOKEN, "proof": PROOF, "body": BODY, **OTHERS[name]})
    assert refused(verified(issued(), carried)) == ("TKT-5", FaultCode.PROOF_NOT_FOR_THIS_REQUEST)


@pytest.mark.clause("TKT-5")
def test_what_is_bound_is_the_bytes():
    assert CALL.body == hashlib.sha256(BODY).hexdigest()
    assert RequestDigests.of(token=None, proof=None, body=b"") == RequestDigests(*[hashlib.sha256(b"").hexdigest()] * 3)


@pytest.mark.clause("TKT-6")
@pytest.mark.parametrize(
    ("age_s", "code"),
    [
        (-0.1, None),
        (-0.101, FaultCode.NOT_YET_VALID),
        (-5.0, FaultCode.NOT_YET_VALID),
        (0.0, None),
        (0.5, None),
        (0.501, FaultCode.EXPIRED),
        (5.0, FaultCode.EXPIRED),
        (float("nan"), FaultCode.NOT_YET_VALID),
        (float("inf"), FaultCode.EXPIRED),
    ],
)
def test_a_ticket_lives_for_half_a_second(age_s, code):
    found = verified(issued(), at=NOW + age_s)
    if code is None:
        assert isinstance(found, Ticket)
    else:
        assert refused(found) == ("TKT-6", code)


@pytest.mark.clause("TKT-6")
def test_the_age_counts_from_the_moment_of_issue():
    assert isinstance(verified(issued(at=NOW + 0.75), at=NOW + 1.25), Ticket)
    assert refused(verified(issued(at=NOW + 0.75), at=NOW + 1.2521)) == ("TKT-6", FaultCode.EXPIRED)


@pytest.mark.clause("TKT-1", "TKT-5")
@given(st.data())
def test_no_changed_byte_passes(data):
    """Of the ticket, the token, the proof and the body: any one byte that is another, missing or more."""
    text = issued()
    whole = {"text": text.encode(), "token": TOKEN.encode(), "proof": PROOF.encode(), "body": BODY}
    part = data.draw(st.sampled_from(sorted(whole)))
    raw = whole[part]
    at = data.draw(st.integers(0, len(raw) - 1))
    new = data.draw(st.one_of(st.just(b""), st.binary(min_size=1, max_size=2)).filter(lambda b: b != raw[at : at + 1]))
    whole[part] = raw[:at] + new + raw[at + 1 :]
    if whole[part] == raw:  # one of several equal bytes was put beside its twin and taken out again
        return
    said = {name: value.decode("latin-1") for name, value in whole.items() if name != "body"}
    found = verified(said["text"], RequestDigests.of(token=said["token"], proof=said["proof"], body=whole["body"]))
    assert isinstance(found, Fault)


class Clock:
    """A monotonic clock that goes when it is told to."""

    mono = 0

    def monotonic_ms(self):
        return self.mono

    def wall_s(self):
        raise AssertionError("ids are kept by the monotonic clock")


@pytest.mark.clause("TKT-7")
@given(
    lead_ms=st.integers(-ticket.AHEAD_MS, ticket.AGE_MS),
    steps=st.lists(st.tuples(st.integers(0, 4_000), st.integers(-8_000, 1_000)), max_size=12),
)
def test_a_ticket_is_taken_once_whatever_becomes_of_the_clock(lead_ms, steps):
    """The wall time jumps as [PRF-9] lets it: never more than the skew behind the highest, carried on."""
    clock, text = Clock(), issued()
    store, wall_ms = ReplayCache(clock), NOW * 1_000 + lead_ms
    highest_ms, taken = wall_ms, 0
    for passed_ms, jump_ms in [(0, 0), *steps]:
        clock.mono += passed_ms
        highest_ms += passed_ms
        wall_ms = max(wall_ms + passed_ms + jump_ms, highest_ms - DEFAULT.skew_s * 1_000)
        highest_ms = max(highest_ms, wall_ms)
        found = verified(text, at=wall_ms / 1_000)
        if isinstance(found, Ticket):
            kept_until_ms = clock.mono + ticket.retention_ms(DEFAULT)
            taken += store.first_use(found.id, key=PEPS["door-1"], expires_ms=kept_until_ms)
    assert taken == 1


@pytest.mark.clause("TKT-7")
def test_ids_are_forgotten_when_no_clock_can_make_the_ticket_fresh_again():
    clock = Clock()
    store = ReplayCache(clock, capacity=1)
    assert store.first_use(ID, key=PEPS["door-1"], expires_ms=ticket.retention_ms(DEFAULT))
    clock.mono = ticket.retention_ms(DEFAULT) + 1
    assert store.first_use("0f" * 16, key=PEPS["door-1"], expires_ms=2 * clock.mono)
    assert ticket.retention_ms(DEFAULT) == 6_600


@pytest.mark.clause(reason="a ticket is a value")
def test_a_ticket_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        CALL.body = "x"
