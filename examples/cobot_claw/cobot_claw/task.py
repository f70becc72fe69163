"""One task under way: the authority behind a model's tools, the run, and its failures by name."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import httpx2
from pydantic_ai import Agent as ModelAgent
from pydantic_ai import ModelSettings, RunContext, Tool, ToolFailed, UsageLimits
from pydantic_ai.exceptions import (
    AgentRunError,
    ModelAPIError,
    ModelConnectionError,
    ModelHTTPError,
    UnexpectedModelBehavior,
    UsageLimitExceeded,
)
from pydantic_ai.mcp import MCPToolset

from cobot_claw import roles
from cobot_claw.errors import ClawError
from cobot_claw.witness import ASKED, Witness
from cobot_claw.words import COLLECTIONS
from ztpm_idp.client import Deferred, raise_refused, refusal_in

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pydantic_ai.models import Model
    from pydantic_ai.toolsets import AbstractToolset

    from cobot_claw.agent import Holder
    from cobot_claw.asking import Admissions

STEPS_MOST: Final = 16
"""Most turns of a model in one task; one that needs more goes in circles."""
MODEL_S: Final = 45.0
"""Longest wait for one answer of a model's endpoint; its client tries three times."""
CALL_S: Final = 120.0
"""Longest answer to one call of a tool, which may be a motion's end."""
LATE_TRIES: Final = 4
"""Tries of a call whose verdict came too late on a loaded machine, as its reason advises."""
PATIENCE_S: Final = 60.0
"""Longest wait for people who are asked about one call."""
_LOG: Final = logging.getLogger("cobot_claw")


@dataclass(slots=True)
class Work:
    """Authority and results of one task under way, which the model is never shown."""

    holder: Holder
    token: str
    intent: str
    admissions: Admissions
    refusals: list[str] = field(default_factory=list)
    unfinished: dict[str, str] = field(default_factory=dict)

    def noted(self, tool: str, answer: Any) -> Any:
        """The answer, once it is noted whether the call came to its end: a motion may be stopped under way."""
        self.unfinished.pop(tool, None)
        if isinstance(answer, dict) and answer.get("outcome", "reached") != "reached":
            self.unfinished[tool] = f"{answer['outcome']} ({answer.get('reason')})"
        return answer

    @property
    def done(self) -> bool:
        """True where nothing was refused, and nothing was left unfinished."""
        return not self.refusals and not self.unfinished


async def run(
    model: Model, role: str, text: str, *, work: Work | None, toolsets: Sequence[AbstractToolset[Any]] = ()
) -> str:
    """The words with which a model ends a task.

    Args:
        model: behind the agent.
        role: of the agent.
        text: the admitted task.
        work: what its tools rest on.
        toolsets: of tool servers.

    Raises:
        ClawError: the model is down, slow, talks nonsense or goes in circles, or a tool server is gone.
    """
    agent = ModelAgent(
        model,
        deps_type=Work,
        instructions=roles.OF[role].instructions,
        toolsets=list(toolsets),
        tools=TOOLS[role],
        name=role,
        model_settings=ModelSettings(timeout=MODEL_S),
    )
    try:
        found = await agent.run(text, deps=work, usage_limits=UsageLimits(request_limit=STEPS_MOST))  # type: ignore[arg-type]
    except Exception as error:
        raise named(error, role) from error
    return str(found.output)


def named(error: Exception, role: str) -> Exception:
    """The failure of a model's run in our words; any other error as it is."""
    match error:
        case ClawError():
            return error
        case UsageLimitExceeded():
            return ClawError("AGENT_LOOPS", f"{role}: more than {STEPS_MOST} steps.")
        case TimeoutError() | httpx2.TimeoutException():
            return ClawError("MODEL_SLOW", f"{role}: {type(error).__name__}.")
        case ModelConnectionError():
            slow = "Timeout" in type(error).__name__
            return ClawError("MODEL_SLOW" if slow else "MODEL_UNREACHABLE", f"{role}: {type(error).__name__}.")
        case ModelHTTPError(status_code=status):
            return ClawError("MODEL_REFUSED", f"{role}: HTTP status {status}.")
        case ModelAPIError() if any(isinstance(each, ValueError) for each in _inside(error)):
            return ClawError("MODEL_NONSENSE", f"{role}: no JSON.")
        case ModelAPIError():
            return ClawError("MODEL_UNREACHABLE", f"{role}: {type(error).__name__}.")
        case UnexpectedModelBehavior() | AgentRunError():
            return ClawError("MODEL_NONSENSE", f"{role}: {type(error).__name__}.")
        case _ if (inner := next((each for each in _inside(error) if isinstance(each, ClawError)), None)) is not None:
            return inner
        case _:
            _LOG.exception("a run of %s failed", role)
            return ClawError("TOOLS_UNREACHABLE", f"{role}: {type(error).__name__}.")


def _inside(error: BaseException) -> list[BaseException]:
    held = error.exceptions if isinstance(error, BaseExceptionGroup) else ()
    found = [error, *(deeper for each in held for deeper in _inside(each))]
    return found + (_inside(error.__cause__) if error.__cause__ is not None else [])


async def _believed(work: Work, witness: Witness, tool: str, arguments: dict[str, Any]) -> None:
    """Has the answer of a tool admitted: its server's word on this very call.

    Raises:
        ToolFailed: it must not reach the model.
    """
    question = witness.question(tool, arguments)
    told = None if question is None else await work.admissions.ask("respond", **question)
    if told is None or not told["admitted"]:
        reason = "NOT_VOUCHED" if told is None else told["reason"]
        work.refusals.append(reason)
        raise ToolFailed(f"What {tool} answered must not be believed: {reason}.")


def guarded_tools(auth: httpx2.Auth, url: str, witness: Witness) -> MCPToolset[Work]:
    """Tools of a guarded server under the token of this task; a refusal reaches the model in words, once.

    Args:
        auth: of the task.
        url: of the server.
        witness: of its answers.
    """

    async def in_words(context: RunContext[Work], call: Any, tool: str, arguments: dict[str, Any]) -> Any:
        late, patient_until = 0, time.monotonic() + PATIENCE_S
        while True:
            try:
                answer = await call(tool, arguments, metadata=ASKED)
            except Exception as error:
                refused = refusal_in(error)
                if refused is None:
                    context.deps.unfinished[tool] = str(error)
                    raise
                waits = isinstance(refused, Deferred) and time.monotonic() < patient_until
                late += refused.reason == "VERDICT_EXPIRED"
                if not waits and (refused.reason != "VERDICT_EXPIRED" or late >= LATE_TRIES):
                    context.deps.refusals.append(refused.words)
                    raise ToolFailed(refused.words) from error
            else:
                await _believed(context.deps, witness, tool, arguments)
                return context.deps.noted(tool, answer)
            # Exactly the same call again: it uses an answer of people, once, or is decided anew.
            await asyncio.sleep(refused.retry_after_s if isinstance(refused, Deferred) else 0.0)

    http = httpx2.AsyncClient(
        auth=auth,
        event_hooks={"response": [raise_refused, witness.hear]},
        timeout=httpx2.Timeout(30.0, read=CALL_S),
        trust_env=False,
    )
    return MCPToolset(
        url, id=url, http_client=http, process_tool_call=in_words, max_retries=0, tool_error_behavior="failed"
    )


# --- tools of the orchestrator: the other agents, and what may be known ---------------------------------------------


async def ask_vision(context: RunContext[Work], task: str) -> str:
    """Ask the Vision agent to look. Say what it is to find."""
    return await context.deps.holder.hand_on(context.deps, "vision", task)


async def ask_robotic(context: RunContext[Work], task: str) -> str:
    """Ask the Robotic agent to move the arm or the gripper. Say each step with its numbers and units."""
    return await context.deps.holder.hand_on(context.deps, "robotic", task)


async def ask_config(context: RunContext[Work], task: str) -> str:
    """Ask the Config agent to read or change the motion profile."""
    return await context.deps.holder.hand_on(context.deps, "config", task)


async def search_handbook(context: RunContext[Work], query: str) -> str:
    """Search the handbook of the arm; only what its curator signed is found."""
    return await _found(context.deps, query, "document")


async def search_scenarios(context: RunContext[Work], query: str) -> str:
    """Search the library of scenarios; only what its curator signed is found."""
    return await _found(context.deps, query, "scenario")


async def remember(context: RunContext[Work], name: str, value: dict[str, Any]) -> str:
    """Remember something under a name, for later requests."""
    told = await context.deps.admissions.ask("remember", name=name, value=value)
    if not told["admitted"]:
        raise ToolFailed(f"Nothing was remembered: {told['reason']}.")
    return "Remembered."


async def recall(context: RunContext[Work], name: str) -> str:
    """Recall what was remembered under a name."""
    told = await context.deps.admissions.ask("recall", name=name)
    return json.dumps(told["value"]) if told["admitted"] else f"Nothing may be recalled: {told['reason']}."


async def joints_for(x_m: float, y_m: float, z_m: float) -> dict[str, Any]:
    """Joint angles with the middle of the fingers at a place in metres (base frame), pointing down."""
    from cobot_claw.reach import OutOfReachError, joints_at

    try:
        return {"q_rad": await asyncio.to_thread(joints_at, x_m, y_m, z_m)}
    except OutOfReachError as error:
        raise ToolFailed(f"{error}. Nothing has happened.") from error


async def _found(work: Work, query: str, content: str) -> str:
    told = await work.admissions.ask("retrieve", query=query, collection=COLLECTIONS[content])
    texts = [str(each["value"]) for each in told["items"] if each["admitted"]]
    return "\n\n".join(texts) or "Nothing was found that may be believed."


TOOLS: Final[dict[str, list[Any]]] = {
    "orchestrator": [
        Tool(each, max_retries=0)
        for each in (ask_vision, ask_robotic, ask_config, search_handbook, search_scenarios, remember, recall)
    ],
    "robotic": [Tool(joints_for, max_retries=0)],
    "vision": [],
    "config": [],
}
"""Tools of each role beside those of the servers."""
