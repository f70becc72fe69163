"""Commands that wait at once share one transaction, and each of them is answered as if it had come alone."""

import asyncio
import json
import secrets

import httpx2
import pytest
import rfc8785
import sqlalchemy as sa
from capabilities.proof.proof import prove
from tests.ztpm_idp.world import ISSUER
from ztpm_idp.client import issue_request
from ztpm_idp.domain.locks import Locks

from ztpm_idp.provider import joint_work
from ztpm_idp.provider.joint_work import JointWork, Work
from ztpm_idp.store import OnceOnlyError, StoreUnavailableError
from ztpm_idp.store import schema as t
from ztpm_idp.store.asking import AskedTogether
from ztpm_idp.store.transaction import Transaction

AGENTS = tuple(f"agent-{n}" for n in range(6))


def request_of(world, name, path, body):
    raw, jti = rfc8785.dumps(body), secrets.token_urlsafe(18)
    proof = prove(
        world.private[name], method="POST", url=ISSUER + path, body=raw, token=None, at=int(world.clock()), jti=jti
    )
    return ISSUER + path, raw, {"dpop": proof}


def at_once(world, requests):
    """The answers to requests that all wait before the first of them is done."""
    all_here = [False]

    async def all_wait(waiting):
        async with asyncio.timeout(60):
            while not all_here[0] and len(waiting) < len(requests):
                await asyncio.sleep(0)
        all_here[0] = True

    async def asked():
        async with httpx2.AsyncClient(transport=httpx2.ASGITransport(app=world.app)) as http:
            sent = [http.post(url, content=raw, headers=headers) for url, raw, headers in requests]
            return await asyncio.gather(*sent)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(joint_work, "gathered", all_wait)
        return world.on_loop(asked())


def answers_of(world, requests):
    """Status, or code of the refusal, of each; and the number of commits that it took."""
    commits = []
    engine, counted = world.provider.store._engine.sync_engine, commits.append
    sa.event.listen(engine, "commit", counted)
    try:
        answers = at_once(world, requests)
    finally:
        sa.event.remove(engine, "commit", counted)
    return [a.status_code if a.is_success else a.json()["code"] for a in answers], len(commits)


def number(world, table):
    async def counted():
        async with world.provider.store.read() as view:
            return await view._scalar(sa.select(sa.func.count()).select_from(table))

    return world.on_loop(counted())


@pytest.fixture
def issues(world):
    """One request to lend for each of the agents, each by the same sponsor."""
    requests = []
    for name in AGENTS:
        agent = world.agent(name)
        request = issue_request(name, world.scope(), purpose="x")
        body = {"request": request, "evidence": agent.evidence("alice", request)}
        requests.append(request_of(world, "alice", "/tokens", body))
    return requests


def test_they_share_commits(world, issues):
    entries, hops = number(world, t.ledger), number(world, t.hops)
    told, commits = answers_of(world, issues)
    assert told == [201] * 6
    assert commits < 6
    assert (number(world, t.ledger), number(world, t.hops)) == (entries + 6, hops + 6)
    assert answers_of(world, issues)[0] == ["REPLAYED"] * 6
    assert number(world, t.hops) == hops + 6


def test_the_entry_of_each_has_the_trace_of_its_own_request(world, issues):
    traces = [f"{n:032x}" for n in range(1, 7)]
    for (_, _, headers), trace in zip(issues, traces, strict=True):
        headers["traceparent"] = f"00-{trace}-00f067aa0ba902b7-01"
    told, commits = answers_of(world, issues)
    assert told == [201] * 6
    assert commits < 6

    async def written():
        async with world.provider.store.read() as view:
            return await view._connection.scalars(sa.select(t.ledger.c.line).order_by(t.ledger.c.seq.desc()).limit(6))

    entries = [json.loads(line)["body"] for line in world.on_loop(written())]
    by_agent = {entry["agent"]: entry["trace_id"] for entry in entries}
    assert by_agent == dict(zip(AGENTS, traces, strict=True))


def test_the_refusal_of_one_is_no_other_ones(world, issues):
    refused = issue_request(AGENTS[2], world.scope(), purpose="y")
    issues[2] = request_of(world, "alice", "/tokens", {"request": refused, "evidence": "x.y.z"})
    issues[4] = issues[3]  # the very same bytes twice
    told, commits = answers_of(world, issues)
    assert told[:3] == [201, 201, "ATTESTATION_INVALID"]
    assert ({*told[3:5]}, told[5]) == ({201, "REPLAYED"}, 201)
    assert commits < 6
    assert answers_of(world, issues[2:3])[0] == ["REPLAYED"]


def test_an_error_of_ours_is_its_commands_alone(world, issues, monkeypatch):
    make_token = type(world.provider)._make_token

    def over(self, command, events):
        if command.agent == AGENTS[1]:
            raise ZeroDivisionError
        return make_token(self, command, events)

    hops = number(world, t.hops)
    with monkeypatch.context() as patched:
        patched.setattr(type(world.provider), "_make_token", over)
        assert answers_of(world, issues)[0] == [201, "INTERNAL", 201, 201, 201, 201]
    assert number(world, t.hops) == hops + 5


def test_where_several_cannot_be_done_together_each_is_done_alone(world, issues, monkeypatch):
    append_each, tried = Transaction.append_each, []

    async def one_at_most(self, made, *, at_ms):
        tried.append(len(made))
        if len(made) > 2:  # a nonce and a token of each
            raise OnceOnlyError
        return await append_each(self, made, at_ms=at_ms)

    hops = number(world, t.hops)
    with monkeypatch.context() as patched:
        patched.setattr(Transaction, "append_each", one_at_most)
        assert answers_of(world, issues)[0] == [201] * 6
    assert max(tried) > 2 and tried.count(2) == 6
    assert number(world, t.hops) == hops + 6


def test_a_store_that_fails_is_told_to_all(world, issues, monkeypatch):
    append_each = Transaction.append_each

    async def fails(self, made, *, at_ms):
        await append_each(self, made, at_ms=at_ms)
        raise StoreUnavailableError

    before = {table: number(world, table) for table in (t.ledger, t.hops)}
    with monkeypatch.context() as patched:
        patched.setattr(Transaction, "append_each", fails)
        assert answers_of(world, issues)[0] == ["STORE_UNAVAILABLE"] * 6
    assert before == {table: number(world, table) for table in before}
    assert answers_of(world, issues)[0] == ["REPLAYED"] * 6  # used up, by itself, before its answer left


def test_revocations_at_once_have_epochs_in_one_order(world):
    ids = [f"{n:032x}" for n in range(5)]
    requests = [
        request_of(world, "dan", "/revocations", {"kind": "hop", "id": id_, "reason": "x"}) for id_ in (*ids, ids[0])
    ]
    answers = at_once(world, requests)
    index = world.people["alice"]
    assert all(answer.is_success for answer in answers), [answer.text for answer in answers]
    assert number(world, t.revocations) == 5
    assert {answer.json()["known"] for answer in answers} == {False}
    epochs = [answer.json()["epoch"] for answer in answers]
    assert sorted(epochs[:5]) == [1, 2, 3, 4, 5] and epochs[5] >= epochs[0]
    assert index.revoke("hop", "a" * 32, "x") == 6


def test_a_suspended_agent_is_refused_beside_others(world, issues):
    world.people["dan"].suspend_agent(AGENTS[0], "x")
    told, _ = answers_of(world, issues)
    assert told == ["AGENT_SUSPENDED", *[201] * 5]


def test_one_that_comes_when_the_last_has_just_been_answered_is_done():
    """Its queue was empty, and the task that had worked on it was not yet known to have ended."""

    async def together(works):
        return {work: (work.command, None) for work in works}

    async def asked():
        queue = JointWork(together, None, at_once=1)
        nobody = Locks(frozenset(), frozenset())
        return [(await queue.done(Work(n, None, nobody, nobody, "", None, None)))[0] for n in range(3)]

    assert asyncio.run(asyncio.wait_for(asked(), 20)) == [0, 1, 2]


def test_while_one_stands_still_others_are_done_beside_it_and_else_one_after_the_other():
    async def asked():
        go, running, most = asyncio.Event(), [], []

        async def together(works):
            running.append(works)
            most.append(len(running))
            if works[0].command == 0:
                await go.wait()
            await asyncio.sleep(0)
            running.remove(works)
            return {work: (work.command, None) for work in works}

        queue, nobody = JointWork(together, None, at_once=2, still_s=0.05), Locks(frozenset(), frozenset())

        async def done(n):
            return (await queue.done(Work(n, None, nobody, nobody, "", None, None)))[0]

        quick = [asyncio.create_task(done(n)) for n in range(1, 5)]
        await asyncio.sleep(0)
        quick += [asyncio.create_task(done(n)) for n in range(5, 9)]
        assert await asyncio.gather(*quick) == [*range(1, 9)]
        assert max(most) == 1
        held = asyncio.create_task(done(0))
        while not running:
            await asyncio.sleep(0)
        assert [await done(n) for n in range(1, 4)] == [1, 2, 3]
        assert max(most) == 2 and not held.done()
        go.set()
        assert await held == 0
        assert not queue._began and not queue._waiting

    asyncio.run(asyncio.wait_for(asked(), 20))


def test_questions_at_once_are_asked_together_and_an_error_is_for_all_of_them():
    asked = []

    async def answer(questions):
        asked.append(list(questions))
        if "c" in questions:
            raise StoreUnavailableError
        return [question.upper() for question in questions]

    async def all_of(together, questions):
        return await asyncio.gather(*map(together.ask, questions), return_exceptions=True)

    async def three_times():
        together = AskedTogether(answer)
        return [await all_of(together, questions) for questions in ("ab", "cd", "e")]

    first, second, third = asyncio.run(asyncio.wait_for(three_times(), 20))
    assert (first, third) == (["A", "B"], ["E"])
    assert [type(one) for one in second] == [StoreUnavailableError] * 2
    assert asked == [["a", "b"], ["c", "d"], ["e"]]
