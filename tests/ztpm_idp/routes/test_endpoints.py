"""Endpoints: each permits, refuses by role, and answers every bad body and proof with a code.

The status is a 4xx, and nothing is half done.
"""

from __future__ import annotations

import json
import secrets

import httpx2
import pytest
from capabilities.keys.trust import TrustBundle
from capabilities.proof.proof import prove
from capabilities.values.scope_json import restriction_to_json, scope_to_json
from tests.hostile_bodies import HOSTILE_BODIES
from msgspec import structs
from tests.capabilities.statements.people.test_pictures import SHOWN
from tests.ztpm_idp.asks import Cell
from tests.ztpm_idp.world import AUDIENCE, ISSUER, MEASUREMENT, SLOWER, new_jti
from ztpm_idp.store.schema import metadata

from capabilities.keys import keys
from capabilities.statements import mark
from capabilities.statements.people import mandate, picture
from ztpm_idp.client import ClientError, ProofAuth, delegate_request, issue_request

pytestmark = [pytest.mark.version, pytest.mark.long]


def known(world):
    """A mark of the enforcement point."""
    if "cell-1" not in world.private:
        world.pep()
    empty = mark.Mark(ISSUER, 0, 0, "", (), 0, int(world.clock()))
    return mark.sign(empty, world.private["cell-1"])


def kept(world):
    """A picture that the store awaits, without a record: none is to be shipped beside the rows."""
    text = picture.write(SHOWN)
    world.sql(
        f"INSERT INTO pictures (digest, since_ms, bytes, packed) VALUES ('{picture.digest_of(text)}', {int(world.clock() * 1_000)}, 0, '') "
        "ON CONFLICT DO NOTHING"
    )
    return text


def good_bodies(world):
    """One good request for each endpoint that takes a body: path, body, who may, who may not."""
    bob = world.people["bob"]
    if not next(row for row in bob.persons() if row["id"] == "bob")["logins"]:
        world.people["dan"].confirm_change(bob.propose_login("bob", "https://op.example", "b"))
    helper = world.agents.get("helper") or world.agent("helper")
    planner = world.agents.get("planner") or world.agent("planner")
    lent = world.people["alice"].issue(planner, world.scope(), purpose="p")
    request = issue_request("helper", world.scope(), purpose="p")
    hop = delegate_request("helper", SLOWER, purpose="p")
    record = {"v": 1, "pep": "cell-1", "seq": 1, "prev": "0" * 64, "at_ms": 1, "kind": "decision", "body": {}}
    everybody = {"alice", "bob", "carol", "dan", "helper", "planner", "cell-1"}
    key = lambda: keys.b64u(keys.public_raw(keys.generate()))
    rows = [
        ("/people", {"id": "eve", "name": "Eve", "key": key(), "roles": ["sponsor"]}, {"alice", "dan"}),
        ("/changes/person", {"id": "erin", "name": "Erin", "key": key(), "roles": ["approver"]}, {"alice", "dan"}),
        (
            "/changes/login",
            {"person": "carol", "issuer": "https://op.example", "subject": "c"},
            {"alice", "carol", "dan"},
        ),
        ("/changes/key", {"key": key()}, {"alice", "bob", "carol", "dan"}),
        ("/changes/end", {"person": "carol", "reason": "left"}, {"alice", "dan"}),
        ("/changes/roles", {"person": "carol", "roles": ["admin"]}, {"alice", "dan"}),
        ("/people/bob/disable", {"reason": "left"}, {"alice", "dan", "bob"}),
        (
            "/agents",
            {"id": "new", "key": key(), "software_digest": "0" * 64, "model": "m", "role": "r", "sponsor": "alice"},
            {"alice", "dan"},
        ),
        ("/agents/helper/suspend", {"reason": "odd"}, {"alice", "dan"}),
        ("/agents/helper/retire", {"reason": "odd"}, {"alice", "dan", "helper"}),
        ("/agents/helper/trust", {"permille": 500}, {"alice", "dan"}),
        ("/agents/helper/attestations", {"evidence": helper._evidence("", bytes(32))}, {"helper"}),
        ("/peps", {"id": "cell-2", "key": key(), "audiences": [AUDIENCE]}, {"alice", "dan"}),
        (
            "/sensors",
            {"id": "camera", "key": key(), "calibration": "0" * 64, "transit_ms": 20, "audience": AUDIENCE},
            {"alice", "dan"},
        ),
        (
            "/tools",
            {
                "audience": AUDIENCE,
                "name": "move",
                "definition_digest": "0" * 64,
                "operation": "move_joint",
                "base_tier": 1,
            },
            {"alice", "dan"},
        ),
        ("/nonces", {}, {"helper", "planner"}),
        ("/logins/end", {"issuer": "https://op.example", "subject": "b"}, {"alice", "bob", "dan"}),
        ("/login/links", {}, {"alice", "bob", "carol", "dan"}),
        ("/tokens", {"request": request, "evidence": helper.evidence("alice", request)}, {"alice"}),
        ("/tokens/delegate", {"request": hop, "evidence": helper.evidence("planner", hop)}, {"planner"}),
        ("/revocations", {"kind": "agent", "id": "helper", "reason": "odd"}, {"alice", "dan", "helper"}),
        ("/ledger/records", {"records": [record]}, {"cell-1"}),
        ("/ledger/pictures", {"picture": kept(world)}, {"cell-1"}),
        ("/restoring/marks", {"mark": known(world)}, {"cell-1"}),
        ("/restoring/resume", {"unheard": []}, {"alice", "dan"}),
        ("/agents/helper/vouch", {"reason": "seen"}, {"alice", "dan"}),
    ]
    cell = Cell(world, furnished=True)
    ask_id, asked = cell.taken(agent="helper")
    opened = world.people["carol"].open_tier_4(
        audience=AUDIENCE, agent="helper", object="ur3e", operation="move_joint"
    )  # fmt: skip
    rows += [
        ("/approvals", {"ask": cell.text(agent="helper")}, {"cell-1"}),
        (f"/approvals/{ask_id}/votes", {"vote": cell.vote(asked, "alice")}, {"alice", "carol"}),
        ("/openings", {"opening": cell.opening("alice", agent="helper")}, {"alice", "carol"}),
        (f"/openings/{opened}/withdraw", {"reason": "done"}, {"alice", "carol"}),
    ]
    week = world.scope(not_after=int(world.clock()) + 604_800)
    drawn_from = world.people["alice"].sign_mandate("helper", week, purpose="p")
    text = world.people["alice"].mandate(drawn_from)["mandate"]
    promised = structs.replace(mandate.read_again(text), mandate_id=secrets.token_hex(16))
    draw = {"lifetime_s": 60, "mandate_id": drawn_from}
    rows += [
        ("/mandates", {"mandate": mandate.sign(promised, world.private["alice"])}, {"alice"}),
        (f"/mandates/{drawn_from}/tokens", {"request": draw, "evidence": helper.evidence("alice", draw)}, {"helper"}),
    ]
    changes = [
        world.people["dan"].propose_person(f"p-{secrets.token_hex(4)}", "P", keys.unb64u(key()), ["admin"])
        for _ in range(2)
    ]
    rows += [
        (f"/changes/{changes[0]}/confirm", {}, {"alice"}),
        (f"/changes/{changes[1]}/decline", {"reason": "who?"}, {"alice", "dan"}),
    ]
    return [
        (path, body, may, everybody - may, lent.token if path == "/tokens/delegate" else None)
        for path, body, may in rows
    ]


def send(world, path, content, who=None, token=None, **headers):
    auth = None if who is None else ProofAuth(world.private[who], token, now=world.clock)
    with world.anonymous() as http:
        return http.post(ISSUER + path, content=content, auth=auth, headers=headers)


def checked(response, *, status=None):
    """The problem, which must be one of ours."""
    assert 400 <= response.status_code < 500, (response.status_code, response.text)
    assert response.headers["content-type"] == "application/problem+json"
    problem = response.json()
    assert problem.keys() == {"type", "title", "status", "code", "detail"}
    assert problem["status"] == response.status_code
    assert status is None or response.status_code == status, problem
    return problem


def tables(world):
    """Every row of every table but the proofs used up, the beats and nonces."""
    names = [table.name for table in metadata.sorted_tables if table.name not in {"proofs", "nonces", "heartbeat"}]
    in_order = lambda row: [f"{value:020}" if type(value) is int else repr(value) for value in row]
    return {name: sorted((tuple(row.values()) for row in world.rows(name)), key=in_order) for name in names}


def test_every_endpoint_refuses_every_role_that_it_should_and_then_permits(world):
    world.pep()
    paths = []
    for path, body, may, may_not, token in good_bodies(world):
        before = tables(world)
        for who in sorted(may_not):
            problem = checked(send(world, path, json.dumps(body), who, token))
            assert problem["code"] in {
                "NOT_PERMITTED",
                "CHANGE_YOURS",
                "PROOF_WRONG_KEY",
                "ATTESTATION_INVALID",
                "RECORD_OF_ANOTHER",
                "STATEMENT_UNTRUSTED",
                "MANDATE_NOT_YOURS",
            }, (path, who)
        checked(send(world, path, json.dumps(body)), status=401)
        after = tables(world)
        if path.startswith(("/approvals", "/openings")):
            # Every attempt is in the ledger, and nowhere else.
            assert len(after.pop("ledger")) == len(before.pop("ledger")) + len(may_not)
            del after["counters"], before["counters"]
            del after["refusals"], before["refusals"]
        assert after == before, path
        paths.append(path)
    # Permitted ones last: some of them end a party.
    order = sorted(
        good_bodies(world),
        key=lambda row: row[0].endswith(("suspend", "retire", "disable")) or row[0] == "/revocations",
    )
    for path, body, may, _, token in order:
        who = "alice" if "alice" in may else min(may)
        answered = send(world, path, json.dumps(body), who, token)
        if path == "/restoring/resume":
            assert checked(answered, status=409)["code"] == "NOT_RESTORING"
        else:
            assert answered.is_success, path
    assert len(paths) == 34


def test_the_openapi_names_every_endpoint(world):
    with world.anonymous() as http:
        described = http.get(ISSUER + "/openapi.json").json()["paths"]
        assert http.get(ISSUER + "/docs").status_code == 404
    posts = {path.removeprefix("/ztpm") for path, verbs in described.items() if "post" in verbs}
    gets = {path.removeprefix("/ztpm") for path, verbs in described.items() if "get" in verbs}
    assert posts == {
        "/people", "/people/{id_}/disable", "/changes/person", "/changes/key", "/changes/end", "/changes/{change_id}/confirm",
        "/changes/{change_id}/decline", "/recoveries", "/agents", "/agents/{id_}/attestations", "/agents/{id_}/suspend", "/agents/{id_}/retire", "/agents/{id_}/trust",
        "/agents/{id_}/restore",
        "/peps", "/sensors", "/tools", "/nonces", "/tokens", "/tokens/delegate", "/revocations", "/ledger/records", "/ledger/pictures",
        "/approvals", "/approvals/{ask_id}/votes", "/openings", "/openings/{opening_id}/withdraw", "/envelopes", "/envelopes/{envelope_id}/revoke",
        "/latches", "/latches/{latch_id}/clearings", "/latches/{latch_id}/passkey-clearings",
        "/restoring/marks", "/revocations/marks", "/restoring/resume", "/agents/{id_}/vouch", "/mandates", "/mandates/{mandate_id}/tokens",
        "/oauth/token", "/oauth/introspect", "/oauth/revoke", "/oauth/clients", "/oauth/scopes/{name}", "/oauth/scopes/{name}/end",
        "/oauth/lent/{family}/end",
        "/agents/{id_}/key", "/tools/suspend", "/tools/restore", "/tools/retire",
        *(f"/{of}/{{id_}}/{act}" for of in ("peps", "sensors") for act in ("suspend", "restore", "retire", "key")),
        "/login/links", "/changes/login", "/logins/end",
        "/login/links", "/changes/login", "/logins/end", "/login/devices", "/login/devices/poll",
        "/changes/roles", "/changes/passkey", "/passkeys/enrolments", "/passkeys/enrolments/{enrolment_id}/credential",
        "/approvals/{ask_id}/passkey-votes",
    }  # fmt: skip
    assert gets == {
        "/livez", "/healthz", "/readyz", "/metrics", "/trust", "/trust/signed", "/people", "/people/{id_}/allowances", "/changes", "/agents", "/revocations", "/registry", "/ledger/export", "/ledger/pictures/{digest}",
        "/approvals", "/approvals/answers", "/approvals/{ask_id}", "/approvals/{ask_id}/page", "/approvals/{ask_id}/picture", "/approvals/{ask_id}/state", "/approvals/assets/{name}", "/openings", "/envelopes", "/latches", "/latches/{latch_id}", "/latches/{latch_id}/page",
        "/revocations/wait", "/conduct", "/mandates", "/mandates/{mandate_id}",
        "/.well-known/oauth-authorization-server", "/.well-known/oauth-protected-resource", "/oauth/jwks",
        "/.well-known/openid-configuration", "/.well-known/openid-configuration{path}",
        "/.well-known/oauth-authorization-server{path}", "/.well-known/oauth-protected-resource{path}",
        "/oauth/clients", "/oauth/scopes", "/oauth/lent",
        "/peps", "/sensors", "/tools",
        "/ledger/checkpoint", "/ledger/proofs/inclusion", "/ledger/proofs/consistency", "/ledger/entries/{number}", "/ledger/search", "/revocations/points", "/revocations/events",
        "/revocations/wait", "/conduct", "/mandates", "/mandates/{mandate_id}", "/passkeys/passkey.js",
        "/passkeys/enrolments/{enrolment_id}", "/passkeys/enrolments/{enrolment_id}/page",
    }  # fmt: skip


REASONS = {name: reasons for name, _, reasons in HOSTILE_BODIES} | {"huge integer": {"OUT_OF_RANGE"}}


def json_differs(content: bytes, body: dict) -> bool:
    try:
        return json.loads(content) != body
    except (ValueError, RecursionError):
        return True


def hostile(body: dict) -> dict[str, bytes]:
    """Bad versions of a good body, by name."""
    text = json.dumps(body)
    first = next(iter(body), None)
    bad = {
        **{name: content for name, content, _ in HOSTILE_BODIES if json_differs(content, body)},
        "extra": json.dumps(body | {"extra": 1}).encode(),
        "hostile extra": json.dumps(body | {"__proto__": {"admin": True}}).encode(),
        "trailing x": text.encode() + b"x",
        "huge integer": b'{"x": 9007199254740993}',
        "duplicate": (text[:-1] + (", " if first else "") + '"dup": 1, "dup": 2}').encode(),
        "utf-16 of it": text.encode("utf-16"),
        "bom before it": b"\xef\xbb\xbf" + text.encode(),
        "quotes without end": b'{"' + b'\\"' * 60_000,
    }
    for name, value in body.items():
        bad[f"missing {name}"] = json.dumps({k: v for k, v in body.items() if k != name}).encode()
        bad[f"duplicate {name}"] = (text[:-1] + f', "{name}": {json.dumps(value)}' + "}").encode()
        for label, wrong in {
            "null": None, "true": True, "list": [value], "object": {"a": 1}, "float": 1.5, "empty": "", "zero": "a\x00b",
            "bidi": "x\u202ey", "zero width": "x\u200by", "not composed": "e\u0301", "newline": "a\n", "long": "a" * 5_000,
            "upper": "Alice", "wide": "ａlice", "cyrillic": "аlice", "negative": -1, "sql": "'; DROP TABLE parties; --", "path": "../../etc",
        }.items():  # fmt: skip
            if type(wrong) is dict and type(value) is dict:
                wrong = {"a": 1}
            bad[f"{name} {label}"] = json.dumps(body | {name: wrong}).encode()
    return bad


PEOPLES_TEXT = {"name cyrillic", "name wide", "name upper", "name sql", "name path", "reason sql", "reason path", "reason upper",
                "reason wide", "reason cyrillic", "subject upper", "subject path", "model sql", "model path", "model upper", "model wide", "model cyrillic"}  # fmt: skip
"""Texts for people may be in any script; they are bound, never formatted."""


BODY_BYTES = {
    "/tokens": 65_536,
    "/tokens/delegate": 65_536,
    "/approvals": 528_384,
    "/mandates": 135_168,
    "/ledger/records": 262_144,
    "/ledger/pictures": 528_384,
    "/restoring/marks": 262_144,
}
"""Largest body of each route that takes more than a statement or two."""


@pytest.mark.parametrize("share", [48, pytest.param(1, marks=pytest.mark.campaign)])
def test_every_bad_body_at_every_endpoint(world, share):
    """Each endpoint gets all that is bad as a whole, and of bad members another share."""
    world.pep()
    seen = set()
    for turn, (path, body, may, _, token) in enumerate(good_bodies(world)):
        who = "alice" if "alice" in may else min(may)
        before = tables(world)
        for number, (name, content) in enumerate(hostile(body).items()):
            if name.split()[0] in body and (number + turn) % share:
                continue
            if name in PEOPLES_TEXT or (path == "/tools" and name.endswith("upper")):
                continue
            problem = checked(send(world, path, content, who, token))
            if len(content) > BODY_BYTES.get(path, 16_384):
                assert problem["code"] == "BODY_TOO_LARGE", (path, name, problem)
            else:
                assert problem["code"] in REASONS.get(name, {problem["code"]}), (path, name, problem)
            assert "DROP" not in problem["detail"] and "proto" not in problem["detail"]
            seen.add(problem["code"])
        after = tables(world)
        same = [name for name in before if not name.startswith("ledger")]  # its tree and index follow beside
        assert [after[name] for name in same] == [before[name] for name in same] or path == "/tokens/delegate", path
        # What may be added is the record of a refused delegation alone.
        assert after["parties"] == before["parties"]
        assert after["hops"] == before["hops"]
    assert {"BODY_MALFORMED", "NOT_FINITE", "OUT_OF_RANGE", "BODY_TOO_LARGE"} <= seen


@pytest.mark.parametrize("where", ["scope", "restriction"])
def test_bad_scopes_and_restrictions(world, where):
    helper, planner = world.agent("helper"), world.agent("planner")
    lent = world.people["alice"].issue(planner, world.scope(), purpose="p")
    good = scope_to_json(world.scope()) if where == "scope" else restriction_to_json(SLOWER)
    for name, wrong in {
        "extra": good | {"more": 1},
        "bool": good | {"depth": True},
        "text": good | {"ceiling": "3"},
        "unsorted": good | {"delegates": ["b", "a"]},
        "url": good | {"audiences": ["HTTP://x/"]},
        "no grants": good | {"grants": []},
        "unit": good
        | {
            "grants": [
                {"object": "o", "operation": "p", "limits": [{"parameter": "q", "unit": "mph", "low": 0, "high": 1}]}
            ]
        },
        "reversed": good
        | {
            "grants": [
                {"object": "o", "operation": "p", "limits": [{"parameter": "q", "unit": "um", "low": 2, "high": 1}]}
            ]
        },
        "float": good | {"not_after": 1_800_000_500.5},
        "tier": good | {"ceiling": 5},
    }.items():
        if where == "scope":
            request = {"agent": "helper", "purpose": "p", "scope": wrong}
            response = send(
                world,
                "/tokens",
                json.dumps({"request": request, "evidence": helper.evidence("alice", request)}),
                "alice",
            )
        else:
            request = {"delegate": "helper", "purpose": "p", "restriction": wrong}
            body = {"request": request, "evidence": helper.evidence("planner", request)}
            response = send(world, "/tokens/delegate", json.dumps(body), "planner", lent.token)
        assert checked(response)["code"] in {"STATEMENT_MALFORMED", "OUT_OF_RANGE", "BODY_MALFORMED"}, name


def proof(world, **changes):
    stated = dict(
        key=world.private["alice"],
        method="GET",
        url=ISSUER + "/agents",
        body=b"",
        token=None,
        at=int(world.clock()),
        jti=new_jti(),
    )
    stated |= changes
    return prove(stated.pop("key"), **stated)


def test_every_bad_proof(world):
    world.agent("helper")
    once = proof(world)

    def ask(*proofs, **headers):
        listed = [("DPoP", p) for p in proofs] + list(headers.items())
        with world.anonymous() as http:
            return http.get(ISSUER + "/agents", headers=listed)

    assert ask(once).status_code == 200
    for name, (code, response) in {
        "none": ("PROOF_MISSING", ask()),
        "used": ("REPLAYED", ask(once)),
        "two": ("PROOF_MALFORMED", ask(proof(world), proof(world))),
        "text": ("PROOF_MALFORMED", ask("nonsense")),
        "stranger": ("CALLER_UNKNOWN", ask(proof(world, key=keys.generate()))),
        "method": ("PROOF_NOT_FOR_THIS_REQUEST", ask(proof(world, method="POST"))),
        "url": ("PROOF_NOT_FOR_THIS_REQUEST", ask(proof(world, url=ISSUER + "/people"))),
        "host": ("PROOF_NOT_FOR_THIS_REQUEST", ask(proof(world, url="http://evil.example/ztpm/agents"))),
        "body": ("PROOF_NOT_FOR_THIS_REQUEST", ask(proof(world, body=b"{}"))),
        "token": ("PROOF_NOT_FOR_THIS_REQUEST", ask(proof(world, token="A"))),
        "old": ("PROOF_STALE", ask(proof(world, at=int(world.clock()) - 31))),
        "future": ("PROOF_STALE", ask(proof(world, at=int(world.clock()) + 6))),
        "bearer": ("TOKEN_MALFORMED", ask(proof(world), Authorization="Bearer x")),
    }.items():
        problem = checked(response, status=401)
        assert problem["code"] == code, name
        assert response.headers["www-authenticate"].startswith("DPoP "), name
        assert problem["detail"] == problem["title"], "strangers get fixed text"


def test_a_used_proof_stays_used_over_a_restart(world):
    once = proof(world)
    with world.anonymous() as http:
        assert http.get(ISSUER + "/agents", headers={"DPoP": once}).status_code == 200
    world.stop()
    world.start()
    with world.anonymous() as http:
        assert checked(http.get(ISSUER + "/agents", headers={"DPoP": once}))["code"] == "REPLAYED"


def test_a_proof_is_used_up_whatever_the_outcome(world):
    body = b"{"
    once = proof(world, method="POST", url=ISSUER + "/people", body=body)
    with world.anonymous() as http:
        assert checked(http.post(ISSUER + "/people", content=body, headers={"DPoP": once}))["code"] == "BODY_MALFORMED"
        assert checked(http.post(ISSUER + "/people", content=body, headers={"DPoP": once}))["code"] == "REPLAYED"


def test_a_stranger_changes_nothing(world):
    with world.anonymous() as http:
        checked(http.get(ISSUER + "/agents", headers={"DPoP": proof(world, key=keys.generate())}), status=401)
    assert world.rows("proofs") == []


def test_one_key_has_one_owner_and_one_role(world):
    alice = world.people["alice"]
    taken = {
        "a person's": keys.public_raw(world.private["bob"]),
        **{f"the provider's {role}": keys.public_raw(getattr(world.idp_keys, role)) for role in ("root", "attester", "feed", "registry", "ledger")},
    }  # fmt: skip
    for name, raw in taken.items():
        for register in (
            lambda raw: alice.register_person("eve", "Eve", raw, ["sponsor"]),
            lambda raw: alice.register_agent("eve", raw, software_digest="0" * 64, model="m", role="r"),
            lambda raw: alice.register_pep("eve", raw, [AUDIENCE]),
            lambda raw: alice.register_sensor("eve", raw, calibration="0" * 64, transit_ms=1, audience=AUDIENCE),
        ):
            with pytest.raises(ClientError) as caught:
                register(raw)
            assert caught.value.code == "KEY_IN_USE", name


def test_an_id_is_never_used_again(world):
    world.agent("helper")
    world.people["alice"].retire_agent("helper", "odd")
    for register in ("person", "agent", "pep", "sensor"):
        raw = keys.public_raw(keys.generate())
        with pytest.raises(ClientError) as caught:
            match register:
                case "person":
                    world.people["alice"].register_person("helper", "H", raw, ["sponsor"])
                case "agent":
                    world.people["alice"].register_agent("helper", raw, software_digest="0" * 64, model="m", role="r")
                case "pep":
                    world.people["alice"].register_pep("helper", raw, [AUDIENCE])
                case "sensor":
                    world.people["alice"].register_sensor(
                        "helper", raw, calibration="0" * 64, transit_ms=1, audience=AUDIENCE
                    )
        assert caught.value.code == "ALREADY_REGISTERED"


@pytest.mark.parametrize("raw", [bytes(32), b"\x01" + bytes(31), b"\xff" * 32])
def test_a_key_of_small_order_is_refused(world, raw):
    with pytest.raises(ClientError) as caught:
        world.people["alice"].register_pep("weak", raw, [AUDIENCE])
    assert caught.value.code == "BODY_MALFORMED"


def test_a_sponsor_registers_under_itself_only(world):
    for sponsor in ("alice", "carol", "nobody"):
        with pytest.raises(ClientError) as caught:
            world.people["bob"].register_agent(
                "new", keys.public_raw(keys.generate()), software_digest="0" * 64, model="m", role="r", sponsor=sponsor
            )
        assert caught.value.code == "NOT_PERMITTED"
    with pytest.raises(ClientError) as caught:
        world.people["dan"].register_agent(
            "new", keys.public_raw(keys.generate()), software_digest="0" * 64, model="m", role="r", sponsor="carol"
        )
    assert caught.value.code == "SPONSOR_INACTIVE"


def test_unknown_paths_methods_and_traversals(world):
    with world.anonymous() as http:
        for path in ("/", "/ztpm", "/ztpm/", "/agents", "/ztpm/agents/", "/ztpm/../agents", "/ztpm/people/x/y"):
            assert checked(http.get("http://127.0.0.1:8700" + path))["code"] in {
                "PATH_UNKNOWN",
                "METHOD_NOT_ALLOWED",
            }, path
        assert checked(http.delete(ISSUER + "/agents"), status=405)["code"] == "METHOD_NOT_ALLOWED"


@pytest.mark.parametrize("query", ["", "?since=0", "?nonce=" + "a" * 16, "?since=0&nonce=short", "?since=-1&nonce=" + "a" * 16,
    "?since=1e3&nonce=" + "a" * 16, "?since=9007199254740993&nonce=" + "a" * 16, "?since=0&since=1&nonce=" + "a" * 16,
    "?since=0&nonce=" + "a" * 65, "?since=0&nonce=%C3%A9" + "a" * 16, "?since=0&more=1&nonce=" + "a" * 16, "?since=%20&nonce=" + "a" * 16])  # fmt: skip
def test_bad_queries_of_the_feed(world, query):
    with world.anonymous() as http:
        assert checked(http.get(ISSUER + "/revocations" + query), status=400)["code"] == "QUERY_MALFORMED"


def test_bad_queries_of_the_registry(world):
    with world.known() as http:
        for query in (
            "",
            "?audience=",
            "?audience=nonsense",
            "?audience=" + "a" * 300,
            f"?audience={AUDIENCE}&audience={AUDIENCE}",
            "?x=1",
        ):
            assert checked(http.get(ISSUER + "/registry" + query), status=400)["code"] == "QUERY_MALFORMED", query


def test_open_endpoints_and_listing(world):
    world.agent("helper", attested=False)
    with world.anonymous() as http:
        for path in ("/livez", "/healthz"):
            assert http.get(ISSUER + path).json() == {"alive": True}
        assert http.get(ISSUER + "/readyz").json() == {"ready": True}
        assert TrustBundle.from_json(http.get(ISSUER + "/trust").content) == world.trust
        checked(http.get(ISSUER + "/agents"), status=401)
        checked(http.get(ISSUER + "/ledger/export"), status=401)
    world.pep()
    for caller in (*world.people.values(), *world.agents.values(), *world.peps.values()):
        assert [row["id"] for row in caller.agents()] == ["helper"]
    for name in ("bob",):
        with pytest.raises(ClientError) as caught:
            world.people[name].export_ledger()
        assert caught.value.code == "NOT_PERMITTED"
    assert httpx2.Response(200, content=world.people["carol"].export_ledger()).content


def test_the_measurement_is_what_was_registered(world):
    wrong = world.agent("helper", attested=False, measurement=bytes(32))
    with pytest.raises(ClientError) as caught:
        wrong.attest()
    assert caught.value.code == "ATTESTATION_INVALID"
    assert MEASUREMENT != bytes(32)
