"""A command and the use of its proof are one commit: both hold or neither, and no proof serves twice."""

import asyncio
import secrets

import pytest
import rfc8785
import sqlalchemy as sa
from capabilities.proof.proof import prove
from tests.ztpm_idp.world import ISSUER, SLOWER
from ztpm_idp.client import ClientError, delegate_request, issue_request

from ztpm_idp.provider.provider import TRIES, Provider
from ztpm_idp.store import AgainError, LocksTooFewError, StoreUnavailableError
from ztpm_idp.store import schema as t


class Sender:
    """Sends the very same bytes as often as it is asked to."""

    def __init__(self, world, name, path, body, token=None):
        raw = body if isinstance(body, bytes) else rfc8785.dumps(body)
        proof = prove(
            world.private[name], method="POST", url=ISSUER + path, body=raw, token=token,
            at=int(world.clock()), jti=secrets.token_urlsafe(18),
        )  # fmt: skip
        self.world, self.url, self.raw = world, ISSUER + path, raw
        self.headers = {"dpop": proof} | ({} if token is None else {"authorization": f"DPoP {token}"})

    def __call__(self):
        with self.world.anonymous() as http:
            return http.post(self.url, content=self.raw, headers=self.headers)


def rows(world, table):
    async def counted():
        async with world.provider.store.read() as view:
            return await view._scalar(sa.select(sa.func.count()).select_from(table))

    return world.on_loop(counted())


def issuing(world, agent, **changes):
    request = issue_request("planner", world.scope(**changes), purpose="x")
    return Sender(world, "alice", "/tokens", {"request": request, "evidence": agent.evidence("alice", request)})


def delegating(world, holder, delegate, token):
    request = delegate_request("mover", SLOWER, purpose="x")
    body = {"request": request, "evidence": delegate.evidence("planner", request)}
    return Sender(world, "planner", "/tokens/delegate", body, token)


def test_a_proof_serves_one_command(world):
    planner, mover = world.agent("planner", role="planner"), world.agent("mover")
    issue = issuing(world, planner)
    token = issue().json()["token"]
    for send in (
        issue,
        delegate := delegating(world, planner, mover, token),
        revoke := Sender(world, "alice", "/revocations", {"kind": "hop", "id": "0" * 32, "reason": "x"}),
        nonce := Sender(world, "planner", "/nonces", {}),
    ):
        first = None if send is issue else send()
        assert first is None or first.is_success, first.text
        hops, revoked, nonces = rows(world, t.hops), rows(world, t.revocations), rows(world, t.nonces)
        again = send()
        assert (again.status_code, again.json()["code"]) == (401, "REPLAYED")
        assert (hops, revoked, nonces) == (rows(world, t.hops), rows(world, t.revocations), rows(world, t.nonces))
    assert len({each.headers["dpop"] for each in (issue, delegate, revoke, nonce)}) == 4


def test_a_proof_is_used_up_whatever_became_of_its_command(world):
    planner = world.agent("planner", role="planner")
    body = {"request": issue_request("planner", world.scope(), purpose="x"), "evidence": planner.evidence("bob", {})}
    spent = rfc8785.dumps(body)
    for send, code in (
        (Sender(world, "alice", "/tokens", b"{}"), "BODY_MALFORMED"),  # before there is a command
        (Sender(world, "alice", "/tokens", spent), "ATTESTATION_INVALID"),  # refused by the domain
        (Sender(world, "bob", "/revocations", {"kind": "hop", "id": "0" * 32, "reason": "x"}), "NOT_PERMITTED"),
        (Sender(world, "planner", "/tokens/delegate", b"{}"), "BODY_MALFORMED"),
    ):
        assert send().json()["code"] == code
        assert send().json()["code"] == "REPLAYED"


def test_what_is_rolled_back_uses_its_proof_up_all_the_same(world, monkeypatch):
    planner = world.agent("planner", role="planner")
    issue = issuing(world, planner)
    before = rows(world, t.ledger)
    with monkeypatch.context() as patched:
        patched.setattr("ztpm_idp.provider.provider.Provider._make_token", _over)
        assert issue().status_code == 500
    assert rows(world, t.ledger) == before
    assert issue().json()["code"] == "REPLAYED"


def _over(*_):
    raise ZeroDivisionError


def test_a_store_that_cannot_say_permits_nothing(world, monkeypatch):
    nonce = Sender(world, "planner", "/nonces", {}) if world.agent("planner") else None

    async def broken(*_, **__):
        raise StoreUnavailableError

    with monkeypatch.context() as patched:
        patched.setattr("ztpm_idp.store.engine.Store._use_up", broken)
        assert nonce().json()["code"] == "STORE_UNAVAILABLE"
    assert nonce().is_success


def test_one_of_many_at_once_is_answered(world):
    planner = world.agent("planner", role="planner")
    issue = issuing(world, planner)

    async def asked():
        import httpx2

        async with httpx2.AsyncClient(transport=httpx2.ASGITransport(app=world.app)) as http:
            answers = [http.post(issue.url, content=issue.raw, headers=issue.headers) for _ in range(8)]
            return [answer.status_code for answer in await asyncio.gather(*answers)]

    assert sorted(world.on_loop(asked())) == [201, *[401] * 7]


@pytest.mark.parametrize("path", ["/tokens", "/nonces", "/revocations"])
def test_a_command_is_one_commit(world, path):
    planner = world.agent("planner", role="planner")
    send = {
        "/tokens": lambda: issuing(world, planner),
        "/nonces": lambda: Sender(world, "planner", "/nonces", {}),
        "/revocations": lambda: Sender(world, "alice", "/revocations", {"kind": "hop", "id": "0" * 32, "reason": "x"}),
    }[path]()
    commits = []
    sa.event.listen(world.provider.store._engine.sync_engine, "commit", commits.append)
    assert send().is_success
    assert len(commits) == 1


def test_locks_that_were_too_few_cost_no_try(world, monkeypatch):
    """Four other transactions were in the way, then its own locks were too few: it is done all the same."""
    world.agent("mover")
    faults = [*(AgainError() for _ in range(TRIES - 1)), LocksTooFewError()]
    decided = Provider._decided

    async def disturbed(self, *args, **named):
        if faults:
            raise faults.pop(0)
        return await decided(self, *args, **named)

    monkeypatch.setattr(Provider, "_decided", disturbed)
    assert world.people["alice"].revoke("agent", "mover", "x") > 0
    assert faults == []


def test_a_command_that_others_are_always_in_the_way_of_is_503(world, monkeypatch):
    world.agent("mover")
    tried = []

    async def disturbed(self, *args, **named):
        tried.append(1)
        raise AgainError

    monkeypatch.setattr(Provider, "_decided", disturbed)
    with pytest.raises(ClientError) as refused:
        world.people["alice"].revoke("agent", "mover", "x")
    assert (refused.value.code, len(tried)) == ("STORE_UNAVAILABLE", TRIES)
