"""Questions of an agent to the admission point, each under the agent's own token and proof."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

import httpx2

from cobot_claw.errors import ClawError
from cobot_claw.telemetry import carried

if TYPE_CHECKING:
    from ztpm_idp.client import Agent

WAIT_S: Final = 30.0
"""Longest wait for one answer of the admission point."""


@dataclass(frozen=True, slots=True)
class Admissions:
    """The admission point as one agent asks it, under one token.

    Attributes:
        agent: who asks.
        token: under which.
        audience: canonical URL of the point.
    """

    agent: Agent
    token: str
    audience: str

    async def ask(self, name: str, /, **question: object) -> dict[str, Any]:
        """The answer to one question; `admitted` in it says whether there is anything for the model.

        Raises:
            ClawError: `POINT_UNREACHABLE`, or `CONTEXT_REFUSED` where the question itself was refused.
        """
        parts = urlsplit(self.audience)
        url = f"{parts.scheme}://{parts.netloc}/context/{name}"
        try:
            async with httpx2.AsyncClient(timeout=WAIT_S, trust_env=False) as http:
                answer = await http.post(url, json=question, headers=carried(), auth=self.agent.auth(self.token))
                told = answer.json()
        except (httpx2.HTTPError, ValueError) as error:
            raise ClawError("POINT_UNREACHABLE", f"{url}: {type(error).__name__}.") from error
        if answer.status_code != 200 or not isinstance(told, dict):
            raise ClawError("CONTEXT_REFUSED", f"{name}: {told.get('code')} ({told.get('detail')}).")
        return told

    async def admitted(self, name: str, /, **question: object) -> Any:
        """The admitted value.

        Raises:
            ClawError: `CONTEXT_REFUSED` with the decision's reason, and as `ask`.
        """
        told = await self.ask(name, **question)
        if not told["admitted"]:
            raise ClawError("CONTEXT_REFUSED", f"{name}: {told['reason']} ({told['primitive']}).")
        return told["value"]
