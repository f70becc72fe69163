"""The guard hands a declared tool what was decided, says what it rounded, and nothing after a revocation."""

import asyncio
from dataclasses import replace
from types import SimpleNamespace

import pytest
from capabilities.values.scope import Grant, Limit, Range, Tier
from mcp_types import CallToolRequestParams, CallToolResult, TextContent, Tool
from pep.base.declaration import row
from pep.base.stated_values import Within
from pep.base.ports import RegisteredTool
from pep.mcp.guard import DECISION_META, Guard
from pep.mcp.http_request import CREDENTIALS
from pep.mcp.tool_digest import definition_digest
from policies.decision.load import load_shipped
from tests.pep.kit import AUDIENCE, Rig, full_scope

VALVE = row("valve-7", "open_valve", {"percent": Within(0, 1_000, "permille", scale=10)}, base_tier=1, exact=False)
TOOL = Tool(name="open_valve", input_schema={"type": "object", "properties": {"percent": {"type": "number"}}})


class Valve(Rig):
    """A rig without a robot, behind a guard whose tool remembers its arguments."""

    def start(self):
        self.policies = load_shipped("tools")
        self.build()
        self.gate._robot = None
        self.registry.tools = {
            "open_valve": RegisteredTool("open_valve", definition_digest(TOOL), "open_valve", Tier(1))
        }
        grant = Grant("valve-7", "open_valve", (Limit(VALVE.parameters[0], Range(0, 1_000)),))
        self.holder = self.agent(scope=replace(full_scope(self.clock.wall_s()), grants=(grant,)))
        self.calls = []
        return self

    def use(self, **arguments):
        async def own(ctx, params):
            self.calls.append(params.arguments)
            return CallToolResult(content=[TextContent(type="text", text="open")])

        async def served(ctx, name):
            return [TOOL]

        guard = Guard(
            call=own, served=served, gate=self.gate, registry=self.registry, tools={"open_valve": VALVE},
            asks=self.asks, readiness=None, audience=AUDIENCE, clock=self.clock,
        )  # fmt: skip
        ctx = SimpleNamespace(request=SimpleNamespace(scope={CREDENTIALS: self.credentials(self.holder)}))
        answer = asyncio.run(guard(ctx, CallToolRequestParams(name="open_valve", arguments=arguments)))
        return answer.meta[DECISION_META]


@pytest.fixture
def valve(tmp_path):
    made = Valve(tmp_path).start()
    yield made
    made.gate.close()
    made.journal.close()


@pytest.mark.parametrize(("given", "sent"), [(45.04, 45.0), (45.0, 45.0), (0.05, 0.0), (45, 45.0)])
def test_the_tool_gets_the_decided_number_and_the_caller_is_told(valve, given, sent):
    told = valve.use(percent=given)
    assert told["decision"] == "PERMIT"
    assert valve.calls == [{"percent": sent}]
    assert told.get("rounded", {}) == ({} if given == sent else {"percent": sent})
    (decision,) = valve.records("decision")
    assert decision["body"]["request"]["values"] == [["percent", "permille", int(sent * 10)]]


def test_a_revocation_after_the_decision_still_counts(valve):
    append = valve.gate._journal.append

    def revoking(kind, body):
        done = append(kind, body)
        valve.feed.revoke("agent", valve.holder.name)
        return done

    valve.gate._journal.append = revoking
    told = valve.use(percent=1)
    assert (told["decision"], told["reason"], valve.calls) == ("DENY", "REVOKED", [])
    assert valve.records()[-1]["body"]["outcome"] == "refused"


def test_what_is_no_number_is_refused_with_its_argument(valve):
    told = valve.use(percent="much")
    assert (told["reason"], told["argument"], valve.calls) == ("NOT_A_NUMBER", "percent", [])
