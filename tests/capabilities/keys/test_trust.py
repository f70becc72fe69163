"""The bundle of trust: its one spelling, its windows, and which bundle may follow which."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from capabilities.keys.trust import TrustBundle
from capabilities.keys.windows import FOREVER, KEYS_OF_A_ROLE, Role, Standing, Window
from capabilities.rotation.succession import NewestBundle, check_bundle, succeed
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import BadKeyError, CapabilityError, Fault, FaultCode
from tests.capabilities.keys.test_keys import curve_of
from tests.capabilities.world import NOW, ROOT_ID, TRUST, key_of, raw_of

from capabilities.keys import keys
from capabilities.statements import statement_form
from capabilities.statements import trust as trust_bundle
from capabilities.values import strict_json

HOUR = 3_600
ROOT, ATTESTER, SECOND = raw_of("root"), raw_of("attester"), raw_of("attester-2")
TIMED = replace(
    TRUST,
    windows={
        ROOT: Window(NOW, NOW + 24 * HOUR),
        ATTESTER: Window(NOW, NOW + 24 * HOUR, tainted_at=NOW + HOUR),
        raw_of("registry"): Window(NOW - HOUR, NOW + HOUR),
    },
    issued_at=NOW,
    valid_until=NOW + 48 * HOUR,
)


@pytest.mark.clause("TRB-1")
@pytest.mark.parametrize("bundle", [TRUST, TIMED], ids=["always", "timed"])
def test_a_bundle_comes_back_in_one_spelling(bundle):
    wire = bundle.to_json()
    assert TrustBundle.from_json(wire) == bundle
    assert TrustBundle.from_json(wire).to_json() == wire
    for mapping in (bundle.roots, bundle.windows):
        with pytest.raises(TypeError):
            mapping[9] = b""


@pytest.mark.clause("TRB-1")
def test_a_p256_key_may_sign_statements_and_no_token():
    raw = keys.public_raw(curve_of("feed"))
    bundle = replace(TRUST, feed=frozenset({raw}))
    assert TrustBundle.from_json(bundle.to_json()).feed == {raw}
    for role in ({"roots": {ROOT_ID: raw}}, {"attesters": frozenset({raw})}):
        with pytest.raises(BadKeyError) as caught:
            replace(TRUST, **role)
        assert caught.value.code is FaultCode.KEY_MALFORMED


@pytest.mark.clause("TRB-1")
@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"attesters": frozenset()}, FaultCode.KEY_MALFORMED),
        ({"feed": frozenset()}, FaultCode.KEY_MALFORMED),
        ({"roots": {}}, FaultCode.KEY_MALFORMED),
        ({"attesters": frozenset({raw_of("root")})}, FaultCode.KEY_WRONG_ROLE),
        ({"feed": frozenset({raw_of("ledger")})}, FaultCode.KEY_WRONG_ROLE),
        ({"roots": {1: raw_of("root"), 2: raw_of("root")}}, FaultCode.KEY_WRONG_ROLE),
        ({"ledger": frozenset({bytes(32)})}, FaultCode.KEY_MALFORMED),
        ({"ledger": frozenset({b"\2" + b"\xff" * 32})}, FaultCode.KEY_MALFORMED),
        ({"issuer": ""}, FaultCode.KEY_MALFORMED),
        ({"issuer": "idp"}, FaultCode.KEY_MALFORMED),
        ({"version": -1}, FaultCode.KEY_MALFORMED),
        ({"roots": {-1: raw_of("root")}}, FaultCode.KEY_MALFORMED),
        ({"roots": {2**32: raw_of("root")}}, FaultCode.KEY_MALFORMED),
        ({"issued_at": -1}, FaultCode.KEY_MALFORMED),
        ({"valid_until": 0}, FaultCode.KEY_MALFORMED),
        ({"valid_until": FOREVER + 1}, FaultCode.KEY_MALFORMED),
        ({"feed": frozenset(raw_of(f"feed-{n}") for n in range(KEYS_OF_A_ROLE + 1))}, FaultCode.KEY_MALFORMED),
    ],
)
def test_a_bad_bundle_is_refused(change, code):
    with pytest.raises(BadKeyError) as caught:
        replace(TRUST, **change)
    assert caught.value.code is code


@pytest.mark.clause("TRB-1")
def test_a_crowded_role_just_fits():
    assert (
        len(replace(TRUST, feed=frozenset(raw_of(f"feed-{n}") for n in range(KEYS_OF_A_ROLE))).feed) == KEYS_OF_A_ROLE
    )


@pytest.mark.clause("TRB-1")
@pytest.mark.parametrize("window", [(5, 5), (6, 5), (-1, 5), (0, FOREVER + 1), (0, 5, -1), (0, 5, FOREVER + 1)])
def test_a_window_has_a_moment_in_it(window):
    with pytest.raises(BadKeyError) as caught:
        Window(*window)
    assert caught.value.code is FaultCode.KEY_MALFORMED


def entry_with(**change) -> dict:
    return {**json.loads(TIMED.to_json())["feed"][0], **change}


@pytest.mark.clause("TRB-1")
def test_a_bad_bundle_file_is_refused():
    good = json.loads(TIMED.to_json())
    entry = good["feed"][0]
    changes = [
        {"extra": 1},
        {"roots": []},
        {"roots": {"07": good["roots"]["7"]}},
        {"roots": {"x": good["roots"]["7"]}},
        {"roots": {"7": 5}},
        {"roots": {"7": good["roots"]["7"]["key"]}},
        {"version": "1"},
        {"version": True},
        {"version": 1.0},
        {"issuer": 1},
        {"issued_at": None},
        {"issued_at": good["valid_until"]},
        {"valid_until": "2027"},
        {"feed": good["feed"] * 2},
        {"feed": entry},
        {"feed": []},
        {"feed": [entry["key"]]},
        {"feed": [None]},
        {"feed": [entry_with(key=entry["key"] + "=")]},
        {"feed": [entry_with(key=None)]},
        {"feed": [entry_with(not_before=True)]},
        {"feed": [entry_with(not_before=1.5)]},
        {"feed": [entry_with(not_after=None)]},
        {"feed": [entry_with(not_after=0)]},
        {"feed": [entry_with(tainted_at=False)]},
        {"feed": [entry_with(tainted_at="")]},
        {"feed": [entry_with(more=1)]},
        {"feed": [{"key": entry["key"]}]},
        {"feed": [entry_with(key=keys.b64u(raw_of(f"f{n}"))) for n in range(KEYS_OF_A_ROLE + 1)]},
    ]
    for change in changes:
        with pytest.raises(CapabilityError):
            TrustBundle.from_json(json.dumps({**good, **change}).encode())
    for name in good:
        with pytest.raises(CapabilityError):
            TrustBundle.from_json(json.dumps({k: v for k, v in good.items() if k != name}).encode())
    for raw in (
        b"",
        b"null",
        b"[]",
        b"\xff",
        TRUST.to_json()[:-1],
        TRUST.to_json().replace(b'"feed"', b'"feed":[],"feed"', 1),
    ):
        with pytest.raises(CapabilityError):
            TrustBundle.from_json(raw)


# --- at a moment -----------------------------------------------------------------------------------------------------------


@pytest.mark.clause("TRB-2", "TRB-3")
@pytest.mark.parametrize(
    ("at", "signed_at", "standing"),
    [
        (NOW - 1, NOW - 1, Standing.NOT_YET),
        (NOW, NOW, Standing.TRUSTED),
        (NOW + HOUR, NOW + HOUR - 1, Standing.TRUSTED),
        (NOW + HOUR, NOW + HOUR, Standing.TAINTED),
        (NOW + 2 * HOUR, NOW + HOUR + 1, Standing.TAINTED),
        (NOW + 24 * HOUR - 1, NOW, Standing.TRUSTED),
        (NOW + 24 * HOUR, NOW, Standing.OVER),
        (float("nan"), NOW, Standing.NOT_YET),
        (NOW, float("nan"), Standing.TAINTED),
        (float("inf"), NOW, Standing.OVER),
    ],
)
def test_how_a_key_stands(at, signed_at, standing):
    assert TIMED.standing(ATTESTER, signed_at=signed_at, at=at) is standing
    assert TIMED.standing(raw_of("nobody"), signed_at=signed_at, at=at) is Standing.UNKNOWN


@pytest.mark.clause("TRB-2")
def test_a_root_and_the_attesters_of_a_moment():
    assert TIMED.root(ROOT_ID, NOW) == ROOT
    for number, at in ((ROOT_ID + 1, NOW), (ROOT_ID, NOW - 1), (ROOT_ID, NOW + 24 * HOUR)):
        fault = TIMED.root(number, at)
        assert (fault.code, fault.clause) == (FaultCode.UNKNOWN_ROOT_KEY, "TRB-2")
    assert TIMED.signers(Role.ATTESTER, NOW) == TIMED.attesters == {ATTESTER, SECOND}
    assert TIMED.signers(Role.ATTESTER, NOW + 24 * HOUR) == {SECOND}
    assert TIMED.signers(Role.ATTESTER, NOW + 48 * HOUR) == frozenset(), "the bundle itself is over"
    assert TIMED.signers(Role.REGISTRY, NOW) == {raw_of("registry")}
    assert TIMED.signers(Role.REGISTRY, NOW + HOUR) == frozenset()


REFUSED = {
    "an unknown root": ((ROOT_ID + 1, NOW, []), NOW, FaultCode.UNKNOWN_ROOT_KEY, "TRB-2"),
    "a root that is over": ((ROOT_ID, NOW, []), NOW + 24 * HOUR, FaultCode.UNKNOWN_ROOT_KEY, "TRB-2"),
    "a bundle that is over": ((ROOT_ID, NOW, [(SECOND, NOW)]), NOW + 48 * HOUR, FaultCode.UNKNOWN_ROOT_KEY, "TRB-2"),
    "an attester that is over": ((ROOT_ID, NOW, [(ATTESTER, NOW)]), NOW + 24 * HOUR, FaultCode.HOP_NOT_ATTESTED, "TRB-2"),
    "after the taint": ((ROOT_ID, NOW, [(ATTESTER, NOW + HOUR)]), NOW + 2 * HOUR, FaultCode.HOP_NOT_ATTESTED, "TRB-3"),
    "the second hop": ((ROOT_ID, NOW, [(SECOND, NOW), (ATTESTER, NOW + HOUR)]), NOW + 2 * HOUR, FaultCode.HOP_NOT_ATTESTED, "TRB-3"),
    "a stranger": ((ROOT_ID, NOW, [(raw_of("eve"), NOW)]), NOW, FaultCode.HOP_NOT_ATTESTED, "TRB-2"),
    "a root as attester": ((ROOT_ID, NOW, [(ROOT, NOW)]), NOW, FaultCode.HOP_NOT_ATTESTED, "TRB-2"),
    "a feed key as attester": ((ROOT_ID, NOW, [(raw_of("feed"), NOW)]), NOW, FaultCode.HOP_NOT_ATTESTED, "TRB-2"),
}  # fmt: skip


@pytest.mark.clause("TRB-2", "TRB-3")
@pytest.mark.parametrize("name", REFUSED)
def test_every_key_under_a_token_is_asked(name):
    (number, signed_at, hops), at, code, clause = REFUSED[name]
    bundle = (
        replace(TIMED, windows={**TIMED.windows, ROOT: Window(NOW, NOW + 96 * HOUR)}) if "attester" in name else TIMED
    )
    fault = bundle.refusal(number, signed_at, hops, at=at)
    assert (fault.code, fault.clause) == (code, clause)


@pytest.mark.clause("TRB-3")
def test_a_tainted_root_vouches_for_what_it_signed_before():
    bundle = replace(TIMED, windows={ROOT: Window(NOW, NOW + 24 * HOUR, tainted_at=NOW + 60)})
    assert bundle.root(ROOT_ID, NOW + HOUR) == ROOT
    assert bundle.refusal(ROOT_ID, NOW + 59, [(ATTESTER, NOW + 90)], at=NOW + HOUR) is None
    fault = bundle.refusal(ROOT_ID, NOW + 60, [], at=NOW + HOUR)
    assert (fault.code, fault.clause) == (FaultCode.UNKNOWN_ROOT_KEY, "TRB-3")


@pytest.mark.clause("TRB-2", "TRB-3")
@pytest.mark.parametrize(
    "bundle", [TRUST, TIMED, replace(TIMED, valid_until=NOW + HOUR)], ids=["always", "timed", "short"]
)
@pytest.mark.parametrize(
    "signed",
    [
        *(asked for asked, *_ in REFUSED.values()),
        (ROOT_ID, NOW, []),
        (ROOT_ID, NOW, [(ATTESTER, NOW)]),
        (ROOT_ID, NOW, [(SECOND, NOW), (ATTESTER, NOW + 59)]),
    ],
)
def test_the_span_is_where_nothing_is_refused(bundle, signed):
    start, end = bundle.span(*signed)
    moments = {0, NOW - 1, NOW, NOW + HOUR, NOW + 24 * HOUR, NOW + 48 * HOUR, start - 1, start, end - 1, end}
    for at in moments | {moment + 1 for moment in moments}:
        assert (start <= at < end) == (bundle.refusal(*signed, at=at) is None), at


# --- succession ------------------------------------------------------------------------------------------------------------

OLD, NEXT = key_of("registry"), curve_of("registry-2")
BOTH = frozenset({raw_of("registry"), keys.public_raw(NEXT)})
FIRST = replace(TRUST, version=3, issued_at=NOW, valid_until=NOW + 100 * HOUR)
LATER = replace(FIRST, version=4, issued_at=NOW + HOUR, valid_until=NOW + 200 * HOUR, registry=BOTH)
LAST = replace(LATER, version=5, issued_at=NOW + 2 * HOUR, registry=frozenset({keys.public_raw(NEXT)}))
AT = NOW + 3 * HOUR


def follow(held, newer, key, at=AT):
    return succeed(held, trust_bundle.sign(newer, key), at=at, caps=DEFAULT)


@pytest.mark.clause("TRB-5")
def test_a_registry_key_is_rotated_step_by_step():
    assert follow(FIRST, LATER, OLD) == LATER
    assert follow(LATER, LAST, NEXT) == LAST
    assert follow(LAST, LAST, NEXT) == LAST, "the same again is no step"
    gap = follow(FIRST, LAST, NEXT)
    assert (gap.code, gap.clause) == (FaultCode.STATEMENT_UNTRUSTED, "TRB-5")
    by_the_old = follow(FIRST, LAST, OLD)
    assert by_the_old.code is FaultCode.STATEMENT_UNTRUSTED, "a bundle that its own signer is not in"


UNFIT = {
    "a lower version": (LATER, FIRST, OLD, AT, FaultCode.REPLAYED),
    "the same version, other bytes": (LATER, replace(LATER, issued_at=NOW + 2 * HOUR), OLD, AT, FaultCode.REPLAYED),
    "a later version, issued earlier": (LATER, replace(LATER, version=5, issued_at=NOW), OLD, AT, FaultCode.REPLAYED),
    "of the future": (FIRST, LATER, OLD, NOW + HOUR - 6, FaultCode.NOT_YET_VALID),
    "over": (replace(FIRST, valid_until=FOREVER), LATER, OLD, NOW + 200 * HOUR, FaultCode.EXPIRED),
    "after one that is over": (FIRST, LATER, OLD, NOW + 100 * HOUR, FaultCode.STATEMENT_UNTRUSTED),
    "of another issuer": (FIRST, replace(LATER, issuer="http://127.0.0.1:1/x"), OLD, AT, FaultCode.STATEMENT_UNTRUSTED),
    "by a stranger": (FIRST, LATER, key_of("eve"), AT, FaultCode.STATEMENT_UNTRUSTED),
    "by its root": (FIRST, LATER, key_of("root"), AT, FaultCode.STATEMENT_UNTRUSTED),
    "by its feed key": (FIRST, LATER, key_of("feed"), AT, FaultCode.STATEMENT_UNTRUSTED),
    "by a key that it alone trusts": (FIRST, LATER, NEXT, AT, FaultCode.STATEMENT_UNTRUSTED),
    "by a key that it taints": (FIRST, replace(LATER, windows={raw_of("registry"): Window(tainted_at=NOW)}), OLD, AT, FaultCode.STATEMENT_UNTRUSTED),
    "by a key that is tainted": (replace(FIRST, windows={raw_of("registry"): Window(tainted_at=NOW)}), LATER, OLD, AT, FaultCode.STATEMENT_UNTRUSTED),
    "by a key whose time is over": (replace(FIRST, windows={raw_of("registry"): Window(0, AT)}), LATER, OLD, AT, FaultCode.STATEMENT_UNTRUSTED),
    "the feed key as a root": (FIRST, replace(LATER, roots={ROOT_ID: ROOT, 8: raw_of("feed")}, feed=frozenset({raw_of("feed-2")})), OLD, AT, FaultCode.KEY_WRONG_ROLE),
    "a root key id with another key": (FIRST, replace(LATER, roots={ROOT_ID: raw_of("root-2")}), OLD, AT, FaultCode.KEY_WRONG_ROLE),
}  # fmt: skip


@pytest.mark.clause("TRB-5")
@pytest.mark.parametrize("name", UNFIT)
def test_a_bundle_that_may_not_follow(name):
    held, newer, key, at, code = UNFIT[name]
    fault = follow(held, newer, key, at)
    assert isinstance(fault, Fault)
    assert (fault.code, fault.clause[:4]) == (code, "TRB-")


@pytest.mark.clause("TRB-5")
def test_a_bundle_in_another_kind_or_spelling_does_not_follow():
    registry_like = statement_form.sign("registry", LATER.to_members(), OLD)
    assert succeed(FIRST, registry_like, at=AT, caps=DEFAULT).code is FaultCode.STATEMENT_WRONG_KIND
    members = LATER.to_members()
    turned = {**members, "registry": members["registry"][::-1]}
    assert (
        succeed(FIRST, statement_form.sign("trust", turned, OLD), at=AT, caps=DEFAULT).code
        is FaultCode.STATEMENT_MALFORMED
    )
    empty = {**members, "feed": []}
    assert (
        succeed(FIRST, statement_form.sign("trust", empty, OLD), at=AT, caps=DEFAULT).code
        is FaultCode.STATEMENT_MALFORMED
    )
    for text in ("", "a.b.c", strict_json.canonical(members).decode()):
        assert succeed(FIRST, text, at=AT, caps=DEFAULT).code is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("TRB-4")
def test_what_was_seen_is_not_forgotten():
    """An old file put back is refused, in the running verifier and after a restart that kept `Seen`."""
    seen = check_bundle(FIRST, None, at=AT, caps=DEFAULT)
    assert (seen.version, check_bundle(FIRST, seen, at=AT, caps=DEFAULT)) == (3, seen)
    seen = check_bundle(LATER, seen, at=AT, caps=DEFAULT)
    assert isinstance(seen, NewestBundle)
    for older in (FIRST, replace(LATER, valid_until=NOW + 300 * HOUR), replace(FIRST, version=0)):
        fault = check_bundle(older, seen, at=AT, caps=DEFAULT)
        assert (fault.code, fault.clause) == (FaultCode.REPLAYED, "TRB-4")
    assert check_bundle(LATER, None, at=NOW + HOUR - 5, caps=DEFAULT) == seen
    assert check_bundle(LATER, None, at=NOW + HOUR - 6, caps=DEFAULT).code is FaultCode.NOT_YET_VALID
    assert check_bundle(LATER, None, at=NOW + 200 * HOUR, caps=DEFAULT).code is FaultCode.EXPIRED
    assert check_bundle(LATER, None, at=float("nan"), caps=DEFAULT).code is FaultCode.NOT_YET_VALID
