"""AIP: Biscuit chains with tool names, a budget and a depth. It reads its blocks by regular expression, twice."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING, Any, ClassVar, Final

from evaluation.harness.absent import package
from evaluation.harness.timing import Verdict
from evaluation.tokens.peers.plain import Ask, PlainPeer

if TYPE_CHECKING:
    from evaluation.tokens.workload import Workload

_OVERRUN: Final = "execution limits"
"""Part of the peer's text when Biscuit's 1 ms ran out.

The peer never sets another limit, and reports this one as a lack of scope.
"""
_TTL_S: Final = 3_600


class Aip(PlainPeer):
    """See the module."""

    name = "aip"
    checks: ClassVar[str] = "a signature for each block, tool names, budget, depth, expiry (no parameter at all)"
    checks_seen: ClassVar[str] = "the parsed chain, which it parses again: as from the wire"
    limits: ClassVar[bool] = False

    def __init__(self) -> None:
        super().__init__()
        chained, self.version = package("aip_token.chained", "agent-identity-protocol")
        crypto, _ = package("aip_core.crypto", "agent-identity-protocol")
        error, _ = package("aip_token.error", "agent-identity-protocol")
        self._chained, self._refused = chained.ChainedToken, error.TokenError
        self._root = crypto.KeyPair.generate()
        self._public = self._root.public_key_bytes()

    def mint(self, workload: Workload, serial: int) -> Any:
        """A chain whose authority lends tools."""
        return self._chained.create_authority(
            f"aip:web:cell.example/o{serial}", _tools(workload, 0), 500, 8, _TTL_S, self._root
        )

    def attenuate(self, made: Any, workload: Workload, hop: int, serial: int) -> Any:
        """One delegation; the first drops tools, each lowers the budget."""
        holder = f"aip:web:cell.example/a{serial}-{hop}"
        parent = f"aip:web:cell.example/a{serial}-{hop - 1}"
        return made.delegate(parent, holder, _tools(workload, hop), 500 - hop, "pick the red part")

    def wire(self, made: Any) -> str:
        """The base64 text, its only form."""
        return str(made.to_base64())

    def size(self, token: Any) -> int:
        """Bytes of the Biscuit inside."""
        return len(base64.urlsafe_b64decode(token + "=" * (-len(token) % 4)))

    def read(self, token: Any) -> Any:
        """The parsed chain."""
        return self._chained.from_base64(token, self._public)

    def decide(self, token: Any, ask: Ask) -> Verdict:
        """Read, then ask."""
        try:
            kept = self.read(token)
        except self._refused:
            return Verdict.REFUSED
        return self.decide_read(kept, ask)

    def decide_read(self, kept: Any, ask: Ask) -> Verdict:
        """Answer of its `authorize` to the tool; it takes no parameters."""
        try:
            kept.authorize("tool:" + ask.operation, self._public)
        except self._refused as error:
            return Verdict.OVERRUN if _OVERRUN in str(error) else Verdict.REFUSED
        return Verdict.ALLOWED


def _tools(workload: Workload, hop: int) -> list[str]:
    return ["tool:" + operation for operation, _ in workload.lent(hop, 0)]
