"""A guarded server's word for the answers of its tools, as it passes by; the admission point judges it (CII-5)."""

from __future__ import annotations

import json
import secrets
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import jwt

from capabilities.keys.keys import public_raw
from pep.journal.replay_cache import proof_name
from pep.mcp.mapping import Misfit, to_request
from pep.mcp.provenance import RECEIPT, RESPONSE

if TYPE_CHECKING:
    from collections.abc import Mapping

    import httpx2

    from capabilities.keys.keys import PrivateKey
    from pep.base.operation_row import Operation

ASKED: Final[dict[str, Any]] = {RECEIPT: True}
"""`_meta` of a call whose answer is to be vouched for."""
KEPT: Final = 16
"""Most answers that wait to be judged: an agent's model calls few tools at once."""


@dataclass
class Witness:
    """Answers that were vouched for, by tool, until they are judged.

    Args:
        key: of the agent that calls.
        audience: canonical URL of the tools.
        rows: their operations, by name.
    """

    key: PrivateKey
    audience: str
    rows: Mapping[str, Operation]
    _answers: list[tuple[str, dict[str, Any]]] = field(default_factory=list)

    async def hear(self, response: httpx2.Response) -> None:
        """Keeps what a response says of the call that it answers; a hook of an `httpx2.AsyncClient`."""
        if response.status_code != 200 or b'"tools/call"' not in response.request.content:
            return
        await response.aread()
        for line in response.text.splitlines():
            try:
                said = json.loads(line.removeprefix("data:"))
                meta, content = said["result"]["_meta"], said["result"]["structuredContent"]
                tool = json.loads(response.request.content)["params"]["name"]
                word, receipt = meta[RESPONSE], meta[RECEIPT]
            except (ValueError, KeyError, TypeError):
                continue
            # The proof was made here, a moment ago; its id is read, not believed.
            jti = jwt.decode(response.request.headers["dpop"], options={"verify_signature": False})["jti"]
            proof = proof_name(public_raw(self.key), jti).hex()
            kept = {"value": content, "response": word, "receipts": [receipt], "proof": proof}
            self._answers = [*self._answers, (tool, kept)][-KEPT:]

    def question(self, tool: str, arguments: Mapping[str, Any]) -> dict[str, Any] | None:
        """The question to the admission point about the last answer of a tool; None where there is none.

        Args:
            tool: name of it.
            arguments: of the call.
        """
        found = next((kept for name, kept in reversed(self._answers) if name == tool), None)
        if found is None:
            return None
        self._answers = [each for each in self._answers if each[1] is not found]
        at = time.time()
        request = to_request(
            self.rows[tool], arguments, request_id=secrets.token_hex(16), audience=self.audience, at=at
        )
        return (
            None
            if isinstance(request, Misfit)
            else {**found, "audience": self.audience, "tool": tool, "request": request.digest}
        )
