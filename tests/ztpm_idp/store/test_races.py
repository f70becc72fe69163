"""Two workers over one PostgreSQL: what a command read holds until it commits, and other commands go on."""

from __future__ import annotations

import asyncio
import json
import secrets
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import pytest
import sqlalchemy as sa
from capabilities.keys import keys
from tests.ztpm_idp.asks import AT_ONCE, Cell
from tests.ztpm_idp.journals import Journal
from tests.ztpm_idp.world import ISSUER, LOWER, MEASUREMENT, SLOWER, Bridge, World
from ztpm_idp.domain import registry
from ztpm_idp.domain.events import (
    AgentSuspended,
    AskTaken,
    NonceGiven,
    PartyRegistered,
    RecordTaken,
    Revoked,
    TokenDelegated,
    TokenIssued,
    VoteCast,
)
from ztpm_idp.store.database import postgres
from ztpm_idp.store.transaction import Transaction

from ztpm_idp import create_app, ledger_file
from ztpm_idp.client import Agent, ClientError, Evidence, Operator, delegate_request, issue_request

pytestmark = pytest.mark.xdist_group("postgres")
PATIENCE_S = 60
IDLE = "idle_in_transaction_session_timeout"
WAITING = "SELECT count(*) FROM pg_locks WHERE NOT granted AND locktype = 'advisory'"


class Workers:
    """Two workers: `first` calls reach the world's own application, `second` calls another over the same database."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.app = create_app(world.settings, world.idp_keys, platform=world.platform, now=world.clock)
        self.life = self.app.router.lifespan_context(self.app)
        world.on_loop(self.life.__aenter__())
        self.pool = ThreadPoolExecutor(4)

    def close(self) -> None:
        self.world.on_loop(self.life.__aexit__(None, None, None))
        self.pool.shutdown()

    def second(self, name):
        """The same caller, before the second worker."""
        world, bridge = self.world, Bridge(self.app, self.world.loop)
        if name in world.agents:
            return Agent(name, world.private[name], ISSUER, MEASUREMENT, transport=bridge, now=world.clock)
        return Operator(name, world.private[name], ISSUER, transport=bridge, now=world.clock)

    @contextmanager
    def held(self, kind, act, *, idle_ms=None):
        """While it lasts, `act` by the first worker has decided on such an event, and not written it."""
        decided, go = threading.Event(), asyncio.Event()
        inner, armed = Transaction.append_each, [True]

        async def append_each(transaction, made, **more):
            if armed and any(isinstance(each.event, kind) for each in made):
                armed.clear()
                if idle_ms is not None:
                    limit = sa.text(f"SET LOCAL idle_in_transaction_session_timeout = {idle_ms}")
                    await transaction._connection.execute(limit)
                decided.set()
                await go.wait()
            return await inner(transaction, made, **more)

        Transaction.append_each = append_each
        try:
            running = self.pool.submit(code_of, act)
            assert decided.wait(PATIENCE_S)
            yield running
        finally:
            self.world.loop.call_soon_threadsafe(go.set)
            Transaction.append_each = inner

    def one_after_the_other(self, kind, act, other):
        """The codes of two acts, of which the second began while the first had decided and not committed."""
        with self.held(kind, act) as first:
            second = self.pool.submit(code_of, other)
            while not second.done() and self.world.sql(WAITING) == [(0,)]:
                pass
            assert not second.done(), second.result()
        return first.result(PATIENCE_S), second.result(PATIENCE_S)

    def side_by_side(self, kind, act, other):
        """The codes of two acts, of which the second is done while the first had decided and not committed."""
        with self.held(kind, act) as first:
            second = self.pool.submit(code_of, other).result(PATIENCE_S)
        return first.result(PATIENCE_S), second


def code_of(act):
    try:
        act()
    except ClientError as error:
        return error.code
    return "done"


@pytest.fixture(scope="module")
def workers(tmp_path_factory):
    with World(tmp_path_factory.mktemp("races"), database="postgres") as world:
        made = Workers(world)
        yield made
        try:
            lines = world.people["alice"].export_ledger().splitlines()
            assert isinstance(ledger_file.verify(lines, world.trust), ledger_file.Verified)
        finally:
            made.close()


def new(world, **more):
    return world.agent(f"agent-{secrets.token_hex(4)}", **more)


@pytest.fixture
def lent(workers):
    """A holder with a token, and two agents to which it may delegate."""
    world = workers.world
    holder, mover, other = (new(world) for _ in range(3))
    scope = world.scope(delegates=frozenset({mover.id, other.id, "role:actuator"}))
    return holder, mover, other, world.people["alice"].issue(holder, scope, purpose="p")


def issuing(world, agent, by):
    """An act by which this person lends to the agent, whose evidence is made already."""
    scope = world.scope()
    evidence = Evidence(agent.id, agent.evidence("alice", issue_request(agent.id, scope, purpose="p")))
    return lambda: by.issue(evidence, scope, purpose="p")


def test_a_revoked_agent_is_lent_nothing(workers):
    world = workers.world
    agent = new(world)
    revoke = lambda: world.people["alice"].retire_agent(agent.id, "r")
    issue = issuing(world, agent, workers.second("alice"))
    assert workers.one_after_the_other(Revoked, revoke, issue) == ("done", "AGENT_INACTIVE")


@pytest.mark.parametrize("kind", ["hop", "token"])
def test_nothing_is_delegated_from_a_token_that_is_being_revoked(workers, lent, kind):
    holder, mover, _, token = lent
    revoke = lambda: workers.world.people["alice"].revoke(kind, getattr(token, f"{kind}_id"), "r")
    evidence = mover.evidence(holder.id, delegate_request(mover.id, SLOWER, purpose="p"))
    delegate = lambda: workers.second(holder.id).delegate_with(
        token.token, mover.id, SLOWER, purpose="p", evidence=evidence
    )  # fmt: skip
    assert workers.one_after_the_other(Revoked, revoke, delegate) == ("done", "REVOKED")


def test_a_revocation_waits_for_what_is_being_delegated(workers, lent):
    holder, mover, _, token = lent
    delegate = lambda: holder.delegate(token.token, mover, SLOWER, purpose="p")
    revoke = lambda: workers.second("alice").revoke("hop", token.hop_id, "r")
    assert workers.one_after_the_other(TokenDelegated, delegate, revoke) == ("done", "done")


def test_one_nonce_is_spent_once(workers, lent):
    holder, mover, _, token = lent
    evidence = mover.evidence(holder.id, delegate_request(mover.id, SLOWER, purpose="p"))

    def delegate(by):
        return lambda: by.delegate_with(token.token, mover.id, SLOWER, purpose="p", evidence=evidence)

    found = workers.one_after_the_other(TokenDelegated, delegate(holder), delegate(workers.second(holder.id)))
    assert found == ("done", "ATTESTATION_INVALID")


def test_of_a_mandate_two_tokens_live(workers):
    world = workers.world
    agent = new(world)
    mandate_id = world.people["alice"].sign_mandate(
        agent.id, world.scope(not_after=int(world.clock()) + 86_400), purpose="p"
    )  # fmt: skip
    agent.draw(mandate_id)
    request = {"lifetime_s": 60, "mandate_id": mandate_id}

    def draw(by):
        body = {"request": request, "evidence": agent.evidence("alice", request)}
        return lambda: by._post(f"/mandates/{mandate_id}/tokens", body)

    found = workers.one_after_the_other(TokenIssued, draw(agent), draw(workers.second(agent.id)))
    assert found == ("done", "MANDATE_TOKENS_LIVE")


def test_open_nonces_are_bounded(workers):
    world = workers.world
    agent = new(world)
    most = world.settings.open_nonces
    rows = ",".join(f"('{secrets.token_hex(16)}', '{agent.id}', {int(world.clock() * 1_000)})" for _ in range(most - 1))
    world.sql(f"INSERT INTO nonces (nonce, agent, given_ms) VALUES {rows}")
    found = workers.one_after_the_other(NonceGiven, agent.nonce, workers.second(agent.id).nonce)
    assert found == ("done", "TOO_MANY_NONCES")


def test_a_sponsors_agents_are_bounded(workers, monkeypatch):
    world = workers.world
    world.person("eve", "sponsor")
    monkeypatch.setattr(registry, "AGENTS_OF_ONE", 1)

    def register(by, name):
        raw = keys.public_raw(keys.generate())
        return lambda: by.register_agent(name, raw, software_digest="0" * 64, model="m", role="actuator")

    first, second = world.caller(Operator, "eve"), workers.second("eve")
    found = workers.one_after_the_other(PartyRegistered, register(first, "e-1"), register(second, "e-2"))
    assert found == ("done", "REGISTRY_FULL")


@pytest.fixture(scope="module")
def cell(workers):
    return Cell(workers.world)


def test_waiting_asks_are_bounded(workers, cell):
    world = workers.world
    share = world.settings.open_asks // 3
    for _ in range(share - 1):
        cell.taken()
    ask = lambda by, text: lambda: by._post("/approvals", {"ask": text})
    first, second = world.peps["cell-1"], workers.second("cell-1")
    found = workers.one_after_the_other(AskTaken, ask(first, cell.text()), ask(second, cell.text()))
    assert found == ("done", "ASK_BUDGET_SPENT")


def test_a_person_votes_once(workers, cell):
    world = workers.world
    world.clock.at_s += 700  # the asks before are over
    ask_id, _ = cell.taken(approvers=2)
    first, second = world.people["carol"], workers.second("carol")
    found = workers.one_after_the_other(VoteCast, lambda: first.approve(ask_id), lambda: second.approve(ask_id))
    assert found == ("done", "VOTED_BEFORE")


@pytest.mark.parametrize(("approvers", "one", "other"), AT_ONCE)
def test_an_answer_waits_for_the_one_that_another_worker_takes(workers, cell, approvers, one, other):
    world = workers.world
    world.clock.at_s += 700  # the asks before are over
    ask_id, _ = cell.taken(approvers=approvers)
    first = lambda: getattr(world.people["alice"], one)(ask_id)
    second = lambda: getattr(workers.second("carol"), other)(ask_id)
    found = workers.one_after_the_other(VoteCast, first, second)
    told = cell.told(ask_id)
    assert told.state == ("denied" if "deny" in (one, other) else "granted")
    counted = approvers == 2 or (one, other) == ("approve", "deny")
    assert found == ("done", "done" if counted else "ASK_ANSWERED")
    assert len(told.votes) == 1 + counted


def test_records_are_taken_once_and_count_once(workers, lent, cell):
    world, token = workers.world, lent[3].token
    journal = Journal(world, registered=True)
    journal.acted(token)
    ship = lambda by: lambda: by._post("/ledger/records", {"records": journal.made})
    found = workers.one_after_the_other(RecordTaken, ship(world.peps["cell-1"]), ship(workers.second("cell-1")))
    assert found == ("done", "done")
    assert world.sql("SELECT count(*) FROM records WHERE pep = 'cell-1'") == [(len(journal.made),)]
    entries = [json.loads(line) for line in world.people["alice"].export_ledger().splitlines()]
    assert sum(entry.get("kind") == "pep-record" for entry in entries) == len(journal.made)


def test_a_suspended_agent_lends_nothing(workers, lent):
    holder, mover, _, token = lent
    evidence = mover.evidence(holder.id, delegate_request(mover.id, SLOWER, purpose="p"))
    suspend = lambda: workers.world.people["alice"].suspend_agent(holder.id, "r")
    delegate = lambda: workers.second(holder.id).delegate_with(
        token.token, mover.id, SLOWER, purpose="p", evidence=evidence
    )  # fmt: skip
    assert workers.one_after_the_other(AgentSuspended, suspend, delegate) == ("done", "AGENT_SUSPENDED")
    workers.world.people["alice"].restore_agent(holder.id, "r")


def test_what_does_not_concern_a_command_goes_on(workers, lent):
    """While one token is being issued: others are issued and delegated, revoked, and the heartbeat beats."""
    world = workers.world
    holder, mover, _, token = lent
    agent, another = new(world), new(world)
    acts = {
        "issue": issuing(world, another, workers.second("alice")),
        "delegate": lambda: workers.second(holder.id).delegate(token.token, mover, LOWER, purpose="p"),
        "revoke": lambda: workers.second("alice").revoke("hop", secrets.token_hex(16), "r"),
        "beat": lambda: world.on_loop(workers.app.state.heartbeat.beat()),
    }
    for name, act in acts.items():
        assert workers.side_by_side(TokenIssued, issuing(world, agent, world.people["alice"]), act) == (
            "done",
            "done",
        ), name


def test_a_revocation_by_one_worker_wakes_those_who_wait_at_the_other(workers):
    world = workers.world
    (epoch,) = world.sql("SELECT epoch FROM counters")[0]
    epochs = workers.app.state.provider.epochs

    async def never():
        await asyncio.Event().wait()

    epochs._longest_s = 2 * PATIENCE_S  # so that it is no end of a wait that answers
    waiting = asyncio.run_coroutine_threadsafe(epochs.above(epoch, gone=never), world.loop)
    while not epochs._waiting:
        pass
    world.people["alice"].revoke("hop", secrets.token_hex(16), "r")
    assert waiting.result(PATIENCE_S) == epoch + 1


def test_a_frozen_worker_stops_no_revocation(workers, lent):
    """Its transaction has decided and says nothing more: the server ends it, and nothing of it holds."""
    world, (holder, mover, _, token) = workers.world, lent
    limits = world.sql(
        "SELECT name, setting FROM pg_settings WHERE name IN ('lock_timeout', :idle) ORDER BY name", idle=IDLE
    )
    assert [(name, int(ms)) for name, ms in limits] == [
        (IDLE, postgres.IDLE_TIMEOUT_MS), ("lock_timeout", postgres.LOCK_TIMEOUT_MS)
    ]  # fmt: skip
    assert postgres.IDLE_TIMEOUT_MS < postgres.LOCK_TIMEOUT_MS
    delegate = lambda: holder.delegate(token.token, mover, LOWER, purpose="p")
    with workers.held(TokenDelegated, delegate, idle_ms=200) as running:
        workers.second("alice").revoke("hop", token.hop_id, "r")
    assert running.result(PATIENCE_S) == "STORE_UNAVAILABLE"
    assert world.sql("SELECT count(*) FROM hops WHERE parent = :id", id=token.hop_id) == [(0,)]
