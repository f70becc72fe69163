"""Rights to revoke, and the signed feed's account of a revocation."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest
from capabilities.token.token_text import token_from_text
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Restriction, Tier
from tests.ztpm_idp.world import AUDIENCE, ISSUER, SLOWER, World, new_keys

from capabilities.keys import keys
from capabilities.statements import registry, revocation
from ztpm_idp.client import ClientError
from ztpm_idp.provider import feed, heartbeat
from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.store import StoreUnavailableError, prepared
from ztpm_idp.store.joined import Joined
from ztpm_idp.store.revocations import Revocations

pytestmark = pytest.mark.long

NONCE = "n" * 32
AMONG = next(place for place, part in enumerate(prepared.JOINT.parts) if part.select is prepared.AMONG)


def index(world, since=0, nonce=NONCE):
    with world.anonymous() as http:
        response = http.get(ISSUER + "/revocations", params={"since": str(since), "nonce": nonce})
    assert response.status_code == 200, response.text
    return revocation.open(response.text, world.trust.feed, DEFAULT)


def forest(world):
    """Ids of a forest: alice -> planner -> mover -> helper, alice -> planner -> second; bob -> other."""
    planner, mover, helper = world.agent("planner", role="planner"), world.agent("mover"), world.agent("helper")
    second, other = world.agent("second"), world.agent("other", sponsor="bob")
    lent = world.people["alice"].issue(planner, world.scope(), purpose="p")
    below = planner.delegate(lent.token, mover, SLOWER, purpose="p")
    lowest = mover.delegate(below.token, helper, Restriction(ceiling=Tier(1)), purpose="p")
    beside = planner.delegate(lent.token, second, SLOWER, purpose="p")
    bobs = world.people["bob"].issue(other, world.scope(), purpose="p")
    world.pep()
    return {
        ("token", "alice's"): lent.token_id,
        ("token", "bob's"): bobs.token_id,
        ("token", "unknown"): "A" * 22,
        ("hop", "planner's"): lent.hop_id,
        ("hop", "mover's"): below.hop_id,
        ("hop", "helper's"): lowest.hop_id,
        ("hop", "second's"): beside.hop_id,
        ("hop", "other's"): bobs.hop_id,
        ("hop", "unknown"): "a" * 32,
        ("agent", "mover"): "mover",
        ("agent", "other"): "other",
        ("agent", "unknown"): "nobody",
        ("key", "mover's"): keys.thumbprint(keys.public_raw(world.private["mover"])),
        ("key", "other's"): keys.thumbprint(keys.public_raw(world.private["other"])),
        ("key", "bob's"): keys.thumbprint(keys.public_raw(world.private["bob"])),
        ("key", "the pep's"): keys.thumbprint(keys.public_raw(world.private["cell-1"])),
        ("key", "unknown"): "A" * 43,
        ("sponsor", "bob"): "bob",
        ("sponsor", "alice"): "alice",
        ("sponsor", "unknown"): "nobody",
        ("audience", "the cell"): AUDIENCE,
    }


OF_ALICE = {("token", "alice's"), ("hop", "planner's"), ("hop", "mover's"), ("hop", "helper's"), ("hop", "second's")}
MAY = {
    "bob": {
        ("token", "bob's"),
        ("hop", "other's"),
        ("agent", "other"),
        ("key", "other's"),
        ("key", "bob's"),
        ("sponsor", "bob"),
    },
    "carol": set(),
    "planner": OF_ALICE,
    "mover": {("hop", "mover's"), ("hop", "helper's"), ("agent", "mover"), ("key", "mover's")},
    "helper": {("hop", "helper's")},
    "second": {("hop", "second's")},
    "other": {("token", "bob's"), ("hop", "other's"), ("agent", "other"), ("key", "other's")},
    "cell-1": set(),
}
"""Subjects that each caller may revoke; any other is refused.

Administrators come in a test of their own.
"""


def test_who_may_revoke_matrix_refusals(world):
    ids = forest(world)
    callers = world.people | world.agents | world.peps
    for who, may in MAY.items():
        for (kind, name), id_ in ids.items():
            if (kind, name) in may:
                continue
            with pytest.raises(ClientError) as caught:
                callers[who].revoke(kind, id_, "test")
            assert (caught.value.code, caught.value.status) == ("NOT_PERMITTED", 403), (who, kind, name)
    assert index(world).entries == ()


@pytest.mark.parametrize("who", ["bob", "planner", "mover", "other"])
def test_who_may_revoke_matrix_permissions(world, who):
    ids = forest(world)
    callers = world.people | world.agents
    # What ends the caller itself comes last; each is its own revocation with the next epoch.
    last = {("agent", who), ("key", f"{who}'s"), ("sponsor", who)}
    order = sorted(MAY[who], key=lambda row: (row in last, row))
    done = []
    for kind, name in order:
        try:
            epoch = callers[who].revoke(kind, ids[kind, name], "test")
        except ClientError as error:
            assert error.code == "CALLER_INACTIVE"
            assert {(k, n) for k, n in order if (k, n) not in done} <= last
            break
        done.append((kind, name))
        assert epoch == len(done)
    assert {(e.kind, e.id) for e in index(world).entries} == {(kind, ids[kind, name]) for kind, name in done}
    assert set(order) - last <= set(done)


def test_an_administrator_may_revoke_anything_but_those_whom_two_people_end(world):
    ids = forest(world)
    done = 0
    for (kind, name), id_ in ids.items():
        if kind in {"agent", "sponsor"} and name == "unknown":
            with pytest.raises(ClientError) as caught:
                world.people["dan"].revoke(kind, id_, "test")
            assert caught.value.code == "NOT_FOUND"
            continue
        if (kind, name) == ("sponsor", "alice"):
            with pytest.raises(ClientError) as caught:
                world.people["dan"].revoke(kind, id_, "test")
            assert caught.value.code == "TWO_PEOPLE_NEEDED"
            assert world.people["alice"].revoke(kind, id_, "test") == done + 4
            done += 4
            continue
        # A person takes along those of its agents that are not revoked yet.
        done += 1 + {("sponsor", "bob"): 0}.get((kind, name), 0)
        assert world.people["dan"].revoke(kind, id_, "test") == done
    assert len(index(world).entries) == done


@pytest.mark.parametrize(
    ("kind", "id_"),
    [
        ("token", "short"),
        ("hop", "A" * 32),
        ("hop", "a" * 31),
        ("key", "A" * 42),
        ("agent", "mover\n"),
        ("audience", "x"),
        ("robot", "x"),
    ],
)
def test_an_id_that_could_match_nothing_is_refused(world, kind, id_):
    with pytest.raises(ClientError) as caught:
        world.people["dan"].revoke(kind, id_, "test")
    assert caught.value.code == "BODY_MALFORMED"


def test_revoking_again_changes_nothing(world):
    forest(world)
    alice = world.people["alice"]
    first = alice.revoke("agent", "mover", "one")
    assert alice.retire_agent("mover", "two") == first
    assert [(e.epoch, e.kind, e.id) for e in index(world).entries] == [(1, "agent", "mover")]


def test_epochs_grow_by_one_and_since_gives_the_rest(world):
    ids = forest(world)
    wanted = [("hop", "helper's"), ("hop", "mover's"), ("agent", "other"), ("audience", "the cell")]
    epochs = [world.people["alice"].revoke(kind, ids[kind, name], "r") for kind, name in wanted]
    assert epochs == [1, 2, 3, 4]
    for since in range(5):
        found = index(world, since)
        assert found.since == since
        assert [e.epoch for e in found.entries] == [e for e in epochs if e > since]
        assert found.epoch == 4
    with world.anonymous() as http:
        ahead = http.get(ISSUER + "/revocations", params={"since": "5", "nonce": NONCE})
        assert (ahead.status_code, ahead.json()["code"]) == (409, "EPOCH_AHEAD")


def test_the_nonce_is_echoed_and_the_time_taken_before(world):
    one, two = index(world, nonce="a" * 16), index(world, nonce="b" * 64)
    assert (one.nonce, two.nonce) == ("a" * 16, "b" * 64)
    assert one.as_of_ms == int(world.clock() * 1000)
    assert one.issuer == ISSUER


def test_as_of_is_taken_before_the_snapshot(world):
    """A revocation that commits while the answer is made may be in it; the stated time is not later."""
    provider, beat = world.provider, heartbeat.Heartbeat(world.provider)
    inner = beat.beat

    async def late():
        world.clock.at_s += 100
        await inner()

    beat.beat = late
    before = int(world.clock() * 1000)
    text = world.on_loop(heartbeat.revocation_index(provider, beat, since=0, nonce=NONCE))
    assert revocation.open(text, world.trust.feed, DEFAULT).as_of_ms == before


def test_an_index_that_cannot_hold_everything_says_so(world, monkeypatch):
    for number in range(5):
        world.people["dan"].revoke("hop", f"{number:032x}", "r")
    monkeypatch.setattr(feed, "INDEX_BYTES", 3 * (60 + 32))
    part = index(world)
    assert [e.epoch for e in part.entries] == [1, 2, 3]
    assert (part.last, part.epoch) == (3, 5)
    rest = index(world, since=3)
    assert ([e.epoch for e in rest.entries], rest.last, rest.epoch) == ([4, 5], 5, 5)


def test_the_largest_index_is_still_a_statement():
    entries = tuple(
        revocation.RevocationEntry(2**53 - feed.INDEX_ENTRIES + n - 1, "audience", "http://h/" + "h" * 247)
        for n in range(feed.INDEX_ENTRIES)
    )
    kept = feed._that_fit([(e.epoch, e.kind, e.id) for e in entries])
    key = keys.generate()
    whole = revocation.RevocationIndex(ISSUER, 2**53 - 1, 0, 2**53 - 1, "n" * 64, 2**53 - 1, kept)
    assert len(kept) > 400
    assert revocation.open(revocation.sign(whole, key), {keys.public_raw(key)}, DEFAULT) == whole


def test_a_store_that_cannot_commit_sends_no_heartbeat(world, monkeypatch):
    async def broken(self):
        raise StoreUnavailableError

    monkeypatch.setattr(type(world.provider.store), "beat", broken)
    with world.anonymous() as http:
        for path in ("/readyz", f"/revocations?since=0&nonce={NONCE}"):
            response = http.get(ISSUER + path)
            assert (response.status_code, response.json()["code"]) == (503, "STORE_UNAVAILABLE")
        unready = http.get(ISSUER + "/readyz").json()
        assert (unready["ready"], unready["causes"]) == (False, {"store": "StoreUnavailableError"})
        assert http.get(ISSUER + "/livez").json() == {"alive": True}
    monkeypatch.undo()
    assert index(world).nonce == NONCE


def test_one_commit_serves_those_who_waited_and_nobody_later(world):
    class Counting:
        beats = 0

        async def beat(self):
            self.beats += 1
            await asyncio.sleep(0)

    class Providing:
        store = Counting()
        now_ms = staticmethod(lambda: 1)

    async def go():
        beat = heartbeat.Heartbeat(Providing())
        await asyncio.gather(*(beat.beat() for _ in range(20)))
        crowd = Providing.store.beats
        await beat.beat()
        return crowd, Providing.store.beats

    crowd, after = world.on_loop(go())
    assert crowd <= 3
    assert after == crowd + 1


def test_the_registry_snapshot(world):
    alice = world.people["alice"]
    world.agent("mover")
    camera = keys.public_raw(keys.generate())
    with world.known() as http:
        fetch = lambda audience=AUDIENCE: registry.open(
            http.get(ISSUER + "/registry", params={"audience": audience}).text, world.trust.registry, DEFAULT
        )
        versions = [fetch().version, index(world).registry_version]
        alice.register_sensor("camera", camera, calibration="1" * 64, transit_ms=20, audience=AUDIENCE)
        alice.register_tool(
            audience=AUDIENCE, name="move", definition_digest="2" * 64, operation="move_joint", base_tier=1
        )
        alice.set_trust("mover", 650)
        found = fetch()
        assert found.version > versions[0] == versions[1]
        assert index(world).registry_version == found.version
        assert [(t.name, t.definition_digest, t.operation, t.base_tier) for t in found.tools] == [
            ("move", "2" * 64, "move_joint", 1)
        ]
        assert [(s.id, s.key, s.calibration, s.transit_ms) for s in found.sensors] == [("camera", camera, "1" * 64, 20)]
        assert found.trust_permille("mover") == 650
        assert (fetch("http://127.0.0.1:9/mcp").tools, fetch("http://127.0.0.1:9/mcp").sensors) == ((), ())
        alice.register_tool(
            audience=AUDIENCE, name="move", definition_digest="3" * 64, operation="move_joint", base_tier=2
        )
        world.people["dan"].revoke("key", keys.thumbprint(camera), "stolen")
        newer = fetch()
        assert newer.version > found.version
        assert [t.definition_digest for t in newer.tools] == ["3" * 64]
        assert newer.sensors == ()


def test_trust_is_the_sponsors_to_state(world):
    world.agent("mover")
    for who in ("bob", "carol"):
        with pytest.raises(ClientError) as caught:
            world.people[who].set_trust("mover", 1000)
        assert caught.value.code == "NOT_PERMITTED"
    world.people["dan"].set_trust("mover", 100)
    with pytest.raises(ClientError) as caught:
        world.people["dan"].set_trust("nobody", 100)
    assert caught.value.code == "NOT_FOUND"


def test_revoked_things_survive_a_restart(tmp_path):
    with World(tmp_path) as world:
        ids = forest(world)
        world.people["alice"].revoke("hop", ids["hop", "mover's"], "r")
        world.stop()
        world.start()
        assert [(e.kind, e.id) for e in index_of(world)] == [("hop", ids["hop", "mover's"])]


def index_of(world):
    text = world.on_loop(heartbeat.revocation_index(world.provider, world.app.state.heartbeat, since=0, nonce=NONCE))
    return revocation.open(text, world.trust.feed, DEFAULT).entries


# --- bases -----------------------------------------------------------------------------------------------------------


def rows(world, revoked):
    """Puts revocations, (kind, id, at_ms), into the store as if they had been made then; the chain goes over them."""
    import sqlalchemy as sa
    from ztpm_idp.store import schema as t

    async def go():
        async with world.provider.store.write() as transaction:
            made = [
                {"epoch": epoch, "kind": kind, "id": id_, "by": "alice", "reason": "r", "at_ms": at_ms}
                for epoch, (kind, id_, at_ms) in enumerate(revoked, start=1)
            ]
            await transaction._connection.execute(sa.insert(t.revocations), made)
            await transaction._connection.execute(sa.update(t.counters).values(epoch=len(made)))
            await transaction.revocations.begin(0)
            await transaction.append((), actor="alice", at_ms=0)

    world.on_loop(go())


def based(world, since, base):
    with world.anonymous() as http:
        response = http.get(ISSUER + "/revocations", params={"since": str(since), "nonce": NONCE, "base": str(base)})
    return response if response.status_code != 200 else revocation.open(response.text, world.trust.feed, DEFAULT)


@pytest.mark.clause("STM-18")
def test_a_base_leaves_out_what_has_ended_and_nothing_else(world):
    """At the base's own revocation: a token's or hop's end is exact, a mandate's too, and parties stay for ever."""
    now = 2_000_000_000_000
    token_ms, mandate_ms = 86_410_000, 691_210_000
    kinds = {
        "token": token_ms,
        "hop": token_ms,
        "mandate": mandate_ms,
        "agent": None,
        "key": None,
        "sponsor": None,
        "audience": None,
    }
    made = [
        (kind, f"{kind}-{age}", now - age)
        for kind, end in kinds.items()
        for age in ((end or 10**11) - 1, end or 10**11, (end or 10**11) + 1)
    ]
    made.sort(key=lambda row: row[2])
    made += [("hop", f"{n:032x}", now) for n in range(256 - len(made))] + [
        ("hop", f"{n:032x}", now) for n in range(400, 404)
    ]
    stored = [(kind, spelled(kind, id_), at_ms) for kind, id_, at_ms in made]
    rows(world, stored)
    index = based(world, 0, 0)
    assert (index.base.epoch, index.base.through, index.epoch) == (256, 260, 260)
    told = {(entry.kind, entry.id) for entry in index.entries}
    left = [row for row in stored if row[:2] not in told]
    assert {(kind, at_ms) for kind, _, at_ms in left} == {
        (kind, now - end - 1) for kind, end in kinds.items() if end is not None
    }
    head = index.base.head
    for entry in index.entries:
        if entry.epoch > 256:
            head = revocation.next_head(head, entry.epoch, entry.kind, entry.id)
    assert head == index.head, "the chain goes on from the base"
    whole = revocation.first_head(0)
    for epoch, (kind, id_, _) in enumerate(stored[:256], start=1):
        whole = revocation.next_head(whole, epoch, kind, id_)
    assert whole == index.base.head
    world.clock.at_s += 10**6
    assert based(world, 0, 256).entries == index.entries, "a base is the same at any time"


def spelled(kind, name):
    import base64
    import hashlib

    digest = hashlib.sha256(name.encode()).digest()
    match kind:
        case "token":
            return base64.urlsafe_b64encode(digest[:16]).rstrip(b"=").decode()
        case "key":
            return base64.urlsafe_b64encode(digest).rstrip(b"=").decode()
        case "hop" | "mandate":
            return name if len(name) == 32 else digest[:16].hex()
        case "audience":
            return f"http://127.0.0.1:8800/{digest[:4].hex()}"
        case _:
            return f"{kind}-{digest[:4].hex()}"


@pytest.mark.clause("STM-18")
def test_a_base_in_pages_tells_everything_once(world, monkeypatch):
    from ztpm_idp.provider import feed

    rows(
        world,
        [
            ("agent" if n % 3 else "hop", f"a{n}" if n % 3 else f"{n:032x}", 1 if n < 200 else 10**12)
            for n in range(1, 301)
        ],
    )
    whole = based(world, 0, 0)
    monkeypatch.setattr(feed, "INDEX_ENTRIES", 7)
    seen, since = [], 0
    while since < 300:
        page = based(world, since, 256)
        seen += page.entries
        assert page.last > since
        since = page.last
    assert tuple(seen) == whole.entries
    assert len(seen) == 300 - 66, "hops of long ago are left out"


@pytest.mark.clause("STM-18")
@pytest.mark.parametrize("base, code", [("1", "QUERY_MALFORMED"), ("x", "QUERY_MALFORMED"), ("256", "EPOCH_AHEAD")])
def test_bases_that_are_none(world, base, code):
    assert based(world, 0, base).json()["code"] == code
    assert based(world, 0, 0).base == revocation.NO_BASE, "a short feed has none"


@pytest.mark.clause("STM-18")
def test_a_mandates_end_is_that_of_mandates():
    from capabilities.statements.people import mandate

    assert revocation.MANDATE_S == mandate.LIFETIME_S
    assert {kind: revocation.ended_after_s(kind, DEFAULT) for kind in revocation.Revoked} == {
        "token": 86_410, "hop": 86_410, "mandate": 691_210, "agent": None, "key": None, "sponsor": None, "audience": None,
    }  # fmt: skip


def lending(world):
    """A token of planner's, and a delegation of it to mover that is ready to be asked for."""
    planner, mover = world.agent("planner", role="planner"), world.agent("mover")
    lent = world.people["alice"].issue(planner, world.scope(), purpose="x")

    def delegate():
        return planner.delegate(lent.token, mover, SLOWER, purpose="x")

    return lent, delegate


@pytest.mark.parametrize("kind", ["token", "hop", "agent", "key", "sponsor", "audience", "suspended"])
def test_a_token_that_was_verified_before_is_dead_at_once(world, kind):
    lent, delegate = lending(world)
    delegate()  # it is remembered from here on
    dan, key = world.people["dan"], keys.public_raw(world.private["planner"])
    if kind == "suspended":
        dan.suspend_agent("planner", "x")
    elif kind == "sponsor":
        world.end("alice")
    else:
        dead = {"token": lent.token_id, "hop": lent.hop_id, "agent": "planner", "key": keys.thumbprint(key)}
        dan.revoke(kind, dead.get(kind, AUDIENCE), reason="x")
    with pytest.raises(ClientError) as refused:
        delegate()
    # With a person end its agents, so that the caller itself is refused.
    by_caller = dict.fromkeys(("agent", "key", "sponsor"), "CALLER_INACTIVE") | {"suspended": "AGENT_SUSPENDED"}
    assert refused.value.code == by_caller.get(kind, "REVOKED")


def test_a_token_is_judged_by_its_own_names_alone(world):
    _, delegate = lending(world)
    for number in range(5):
        world.people["dan"].revoke("hop", f"{number:032x}", reason="x")
    asked = []
    read = Joined.read

    async def seen(self, connection, values):
        found = await read(self, connection, values)
        asked.append(({kind.value for kind in RevocationKind if values[kind.value]}, found[AMONG]))
        return found

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Joined, "read", seen)
        patched.setattr(Revocations, "every", None)  # not asked for
        delegate()
    _, (kinds, found) = asked  # the delegate's nonce, the token
    assert not found
    assert kinds == {"sponsor", "token", "hop", "agent", "key", "audience"}


def test_rules_with_another_bundle_remember_nothing(world):
    rules = world.provider.rules
    lent, _ = lending(world)
    token = token_from_text(lent.token, DEFAULT)
    assert not isinstance(rules.verifier.names(token, epoch=0), Fault)
    other = replace(rules, trust=new_keys().trust(issuer=ISSUER, root_key_id=1))
    assert isinstance(other.verifier.names(token, epoch=0), Fault)
    assert rules.verifier.names(token[:-1] + bytes([token[-1] ^ 1]), epoch=0).code is FaultCode.SIGNATURE_INVALID
