"""Functions and HTTP endpoints of a program behind the same gate: decided arguments, and a record before and after."""

import asyncio
import json
import os
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from typing import Annotated, Any

import httpx2
import pytest
from capabilities.statements.registry import ToolEntry
from capabilities.statements.revocation import RevocationView
from capabilities.values.scope import Grant, Limit, Range, Tier
from fastapi import Depends, FastAPI
from pep.base.clock import SystemClock
from pep.base.declaration import declared
from pep.base.errors import DeclarationError, JournalError, PepFault
from pep.point import deciding_point
from pep.point.guard_config import GuardConfig
from pep.point.guarded_functions import GuardedFunctions, NotPermittedError, function_pins, permitted
from pep.request.authority import PresentedRequest
from tests.pep.kit import AUDIENCE, FakeIssuer, agent, full_scope, issuer_keys
from tests.pep.mcp.campaign.interposed import Moment, Points, counted, factory
from tests.pep.point.alive import at_once
from tests.pep.point.test_guarded_server import PASSPHRASE, written  # noqa: F401 - a fixture

from capabilities.keys import keys
from pep import Within, operation

pytestmark = pytest.mark.real_time
URL = AUDIENCE.removesuffix("/mcp") + "/valve"


@operation("valve-7", base_tier=1)
def open_valve(percent: Annotated[float, Within(0, 1_000, "permille", scale=10, above={800: 3})]) -> float:
    """Open the valve."""
    if percent == 13:
        raise OSError("stuck")
    return percent


@operation("plant", base_tier=1)
async def vent() -> str:
    """Vent the plant."""
    aired()
    return "vented"


def aired():
    """An effect that tests may look at."""


class Program:
    """The point of a program, its provider on the wire, and an agent that holds a token."""

    def __init__(self, path):
        config = GuardConfig.read(path)
        made, trust = issuer_keys()
        (path.parent / "trust.json").write_bytes(trust.to_json())
        entries = [ToolEntry(p.name, p.definition_digest, p.operation, p.base_tier) for p in function_pins(FUNCTIONS)]
        pep_key = keys.from_pem(config.pep_key_file.read_bytes(), PASSPHRASE.encode())
        clock = SystemClock()
        self.issuer = FakeIssuer(made, clock, tools=entries, pep_key=keys.public_raw(pep_key))
        self.point = at_once(GuardedFunctions(config, FUNCTIONS))
        for part in (self.point.follower, self.point.shipper, self.point._asking):
            part._http = self.issuer.client()
        limit = Limit(declared(open_valve).parameters[0], Range(0, 900))
        grants = (Grant("plant", "vent"), Grant("valve-7", "open_valve", (limit,)))
        self.holder = agent(made, clock.wall_s(), scope=replace(full_scope(clock.wall_s()), grants=grants))

    def presented(self, *, body=b"{}", url=AUDIENCE):
        proof = self.holder.proof(body, at=self.point.clock.wall_s(), url=url)
        return PresentedRequest(self.holder.text, proof, "POST", url, body)

    def records(self):
        return [(r["kind"], r["body"].get("outcome")) for r in self.point.journal.records() if r["kind"] != "incident"]


FUNCTIONS = [open_valve, vent]
NOBODY = PresentedRequest(None, None, "POST", AUDIENCE, b"{}")


@asynccontextmanager
async def living(path):
    program = Program(path)
    async with program.point.living():
        yield program


def test_a_point_that_serves_leaves_what_it_built_out_of_collections(written, monkeypatch):  # noqa: F811
    spared = []
    monkeypatch.setattr(deciding_point, "spare_what_stands", lambda: spared.append(True))

    async def go():
        async with living(written()):
            assert spared == [True]

    asyncio.run(go())


def test_an_enforced_function_gets_what_was_decided(written):  # noqa: F811
    async def go():
        async with living(written()) as program:
            valve, air = program.point.enforced(open_valve), program.point.enforced(vent)
            assert await valve(program.presented(), percent=45.04) == 45.0
            assert await air(program.presented()) == "vented"
            with pytest.raises(OSError, match="stuck"):
                await valve(program.presented(), percent=13)
            assert program.records() == [
                ("decision", None), ("outcome", "done"), ("decision", None), ("outcome", "done"),
                ("decision", None), ("outcome", "failed"),
            ]  # fmt: skip

    asyncio.run(go())


@pytest.mark.parametrize(
    ("percent", "decision", "reason"),
    [
        (95, "DENY", "LIMIT_EXCEEDED_BY_REQUEST"),
        (85, "DEFER", "TIER_NEEDS_APPROVAL"),
        (float("nan"), "DENY", "NOT_FINITE"),
        ("much", "DENY", "NOT_A_NUMBER"),
    ],
)
def test_what_is_not_permitted_does_not_happen(written, percent, decision, reason):  # noqa: F811
    async def go():
        async with living(written()) as program:
            with pytest.raises(NotPermittedError) as refused:
                await program.point.enforced(open_valve)(program.presented(), percent=percent)
            assert (refused.value.told["decision"], refused.value.told["reason"]) == (decision, reason)
            assert ("outcome", "done") not in program.records()

    asyncio.run(go())


def test_arguments_that_fit_no_row_are_on_record(written):  # noqa: F811
    async def go():
        async with living(written()) as program:
            valve = program.point.enforced(open_valve)
            for presented, arguments, told, found in (
                (program.presented(), {"percent": "1"}, ("NOT_A_NUMBER", "percent"), ("NOT_A_NUMBER", "percent")),
                (program.presented(), {}, ("PARAMETERS_WRONG", "percent"), ("PARAMETERS_WRONG", "percent")),
                (program.presented(), {"percent": 1, "x": 1}, ("PARAMETERS_WRONG", ""), ("PARAMETERS_WRONG", "")),
                (NOBODY, {"percent": "1"}, ("TOKEN_MISSING", None), ("TOKEN_MISSING", "percent")),
            ):
                with pytest.raises(NotPermittedError) as refused:
                    await valve(presented, **arguments)
                assert (refused.value.told["reason"], refused.value.told.get("argument")) == told
                record = [each for each in program.point.journal.records() if each["kind"] != "incident"][-1]
                assert (record["kind"], record["body"]["effect"]) == ("refusal", "DENY")
                assert (record["body"]["reason"], record["body"]["where"]["argument"]) == found

            def full(kind, body):
                raise JournalError(PepFault.JOURNAL_BROKEN)

            program.point.gate._journal.append = full
            with pytest.raises(NotPermittedError) as refused:
                await valve(program.presented(), percent="1")
            assert refused.value.told["reason"] == "RECORD_FAILED"

    asyncio.run(go())


def test_a_revocation_after_the_decision_still_counts(written):  # noqa: F811
    async def go():
        async with living(written()) as program:
            journal, follower = program.point.gate._journal, program.point.follower
            append, revoked = journal.append, RevocationView(9, 0, frozenset({("agent", program.holder.name)}))

            def revoking(kind, body):
                done = append(kind, body)
                if kind == "decision":
                    follower.view = lambda: revoked
                return done

            journal.append = revoking
            with pytest.raises(NotPermittedError) as refused:
                await program.point.enforced(vent)(program.presented())
            assert refused.value.told["reason"] == "REVOKED"
            assert program.records() == [("decision", None), ("outcome", "refused")]

    asyncio.run(go())


def test_a_revocation_at_any_await_point_before_the_act_counts(written, monkeypatch):  # noqa: F811
    async def go():
        asyncio.get_running_loop().set_task_factory(factory)
        async with living(written()) as program:
            follower, done, at = program.point.follower, [], 0
            view, revoked = follower.view, RevocationView(9, 0, frozenset({("agent", program.holder.name)}))
            monkeypatch.setitem(vent.__globals__, "aired", lambda: done.append(points.changed))
            while True:
                at += 1
                for moment in Moment:
                    points = Points(at, moment, lambda: setattr(follower, "view", lambda: revoked))
                    with counted(points), suppress(NotPermittedError):
                        await asyncio.create_task(program.point.enforced(vent)(program.presented()))
                    follower.view = view
                assert True not in done, f"at point {at}"
                if not points.changed:
                    assert done
                    return

    asyncio.run(go())


def test_an_act_waits_for_its_decisions_disk_and_its_answer_for_none(written, monkeypatch):  # noqa: F811
    async def go():
        async with living(written()) as program:
            journal, order, sync = program.point.journal, [], os.fdatasync
            monkeypatch.setattr(os, "fdatasync", lambda fd: (order.append("sync"), sync(fd))[1])
            monkeypatch.setitem(vent.__globals__, "aired", lambda: order.append("aired"))
            await program.point.enforced(vent)(program.presented())
            order.append("answered")
            assert program.records() == [("decision", None), ("outcome", "done")]
            async with asyncio.timeout(10):
                while not journal.settled:
                    await asyncio.sleep(0.01)
            assert order == ["sync", "aired", "answered", "sync"]

            # what cannot be settled lets nothing happen any more
            def full(fd):
                raise OSError("no space")

            monkeypatch.setattr(os, "fdatasync", full)
            with pytest.raises(NotPermittedError) as refused:
                await program.point.enforced(vent)(program.presented())
            assert refused.value.told["reason"] == "RECORD_FAILED"
            assert order.count("aired") == 1

    asyncio.run(go())


def test_an_acts_conduct_counts_in_what_is_asked_next(written):  # noqa: F811
    async def go():
        async with living(written()) as program:
            conduct, holder = program.point.gate.conduct, program.holder.name
            for count in (1, 2, 3):
                await program.point.enforced(vent)(program.presented())
                assert conduct.behaviour(holder, at=program.point.clock.wall_s()).samples == count
            await program.point.enforced(vent)(program.presented())
            async with asyncio.timeout(10):
                while conduct._unheard:
                    await asyncio.sleep(0.01)
            assert conduct._behaviour.careers[holder].acts == 4, "and when nothing is asked"

    asyncio.run(go())


def test_a_proof_is_good_for_one_act(written):  # noqa: F811
    async def go():
        async with living(written()) as program:
            presented, valve = program.presented(), program.point.enforced(open_valve)
            await valve(presented, percent=1)
            for again, reason in ((presented, "REPLAYED"), (replace(presented, token=None), "TOKEN_MISSING")):
                with pytest.raises(NotPermittedError) as refused:
                    await valve(again, percent=1)
                assert refused.value.told["reason"] == reason

    asyncio.run(go())


def test_an_endpoint_runs_inside_its_permit(written):  # noqa: F811
    async def go():
        async with living(written()) as program:
            app = FastAPI()

            @app.post("/valve")
            async def valve(decided: Annotated[dict[str, Any], Depends(permitted(program.point, open_valve))]) -> Any:
                return decided

            async def ask(content):
                sent = program.presented(body=content, url=URL)
                headers = {"authorization": f"DPoP {sent.token}", "dpop": sent.proof}
                return await http.post("/valve", content=content, headers=headers)

            transport = httpx2.ASGITransport(app=app)
            async with httpx2.AsyncClient(transport=transport, base_url=URL.removesuffix("/valve")) as http:
                opened = await ask(b'{"percent": 45.04}')
                assert (opened.status_code, opened.json()) == (200, {"percent": 45.0})
                refused = await ask(b'{"percent": 95}')
                assert refused.status_code == 403
                assert json.loads(refused.json()["detail"])["reason"] == "LIMIT_EXCEEDED_BY_REQUEST"
                assert (await ask(b'{"percent": 85}')).status_code == 409
                for body, reason in (
                    (b'{"percent": 1, "percent": 2}', "BODY_MALFORMED"), (b"[]", "BODY_MALFORMED"),
                    (b'{"percent": NaN}', "NOT_FINITE"), (b'{"percent": "%s"}' % (b"1" * 2**20), "BODY_TOO_LARGE"),
                ):  # fmt: skip
                    refused = await ask(body)
                    assert (refused.status_code, refused.json()["detail"]) == (400, reason)
                    recorded = [each["body"] for each in program.point.journal.records() if each["kind"] == "refusal"]
                    assert recorded[-1]["reason"] == reason
                assert (await http.post("/valve", content=b'{"percent": 1}')).status_code == 403
            assert program.records()[:2] == [("decision", None), ("outcome", "done")]

    asyncio.run(go())


def test_a_function_that_is_not_as_approved_ends_the_start(written):  # noqa: F811
    async def go():
        program = Program(written())
        program.issuer.tools = tuple(
            ToolEntry(t.name, "ab" * 32 if t.name == "vent" else t.definition_digest, t.operation, Tier(t.base_tier))
            for t in program.issuer.tools
        )
        with pytest.raises(DeclarationError) as refused:
            async with program.point.living():
                pass
        assert (refused.value.code, refused.value.detail) == (PepFault.TOOL_DEFINITION_CHANGED, "vent")

    asyncio.run(go())
