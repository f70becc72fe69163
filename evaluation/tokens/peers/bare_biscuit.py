"""Biscuit alone, as a lower bound of ours: a holder appends checks, and there is neither attestation nor proof."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from importlib import metadata
from typing import TYPE_CHECKING, Any, ClassVar, Final

import biscuit_auth

from evaluation.harness.timing import Verdict
from evaluation.tokens.peers.plain import Ask, PlainPeer

if TYPE_CHECKING:
    from evaluation.tokens.workload import Workload

_library: Any = biscuit_auth
_EXPIRES: Final = datetime(2100, 1, 1, tzinfo=UTC)
_LIMIT: Final = timedelta(seconds=1)
"""Time for one evaluation: the library's 1 ms refuses valid tokens on a busy machine."""


class BareBiscuit(PlainPeer):
    """See the module."""

    name = "biscuit"
    checks: ClassVar[str] = "a signature for each block, limits, expiry (no attestation, canonical bytes or revocation)"
    checks_seen: ClassVar[str] = "the parsed token: limits, expiry"

    def __init__(self) -> None:
        super().__init__()
        self.version = metadata.version("biscuit-python")
        self._root = _library.KeyPair()

    def mint(self, workload: Workload, serial: int) -> Any:
        """A Biscuit whose authority block has one check over the operations that are lent."""
        text, bound = _check(workload, 0, serial)
        text += "check if time($t), $t < {expires};"
        return _library.BiscuitBuilder(text, {**bound, "expires": _EXPIRES}).build(self._root.private_key)

    def attenuate(self, made: Any, workload: Workload, hop: int, serial: int) -> Any:
        """One block more, with the operations that are kept and the bounds that are tightened."""
        return made.append(_library.BlockBuilder(*_check(workload, hop, serial)))

    def wire(self, made: Any) -> bytes:
        """The bytes."""
        return bytes(made.to_bytes())

    def size(self, token: Any) -> int:
        """Its bytes."""
        return len(token)

    def read(self, token: Any) -> Any:
        """The parsed token; its signatures hold."""
        return _library.Biscuit.from_bytes(token, self._root.public_key)

    def decide(self, token: Any, ask: Ask) -> Verdict:
        """Read, then ask."""
        try:
            kept = self.read(token)
        except _library.BiscuitValidationError:
            return Verdict.REFUSED
        return self.decide_read(kept, ask)

    def decide_read(self, kept: Any, ask: Ask) -> Verdict:
        """Answer of the authorizer to the request as one fact."""
        builder = _library.AuthorizerBuilder("allow if true;")
        limits = builder.limits()
        limits.max_time = _LIMIT
        builder.set_limits(limits)
        values = {f"v{i}": value for i, value in enumerate(ask.arguments.values())}
        terms = ", ".join(["{operation}", *(f"{{{name}}}" for name in values)])
        builder.add_fact(_library.Fact(f"req({terms})", {"operation": ask.operation, **values}))
        builder.add_fact(_library.Fact("time({now})", {"now": datetime.now(tz=UTC)}))
        try:
            builder.build(kept).authorize()
        except _library.AuthorizationError:
            return Verdict.REFUSED
        return Verdict.ALLOWED


def _check(workload: Workload, hop: int, serial: int) -> tuple[str, dict[str, Any]]:
    """Check over the operations that hold from this hop on.

    A later hop states only the bounds that it tightens.
    """
    alternatives: list[str] = []
    bound: dict[str, Any] = {}
    for operation, limits in workload.numbers(hop, serial):
        name = f"o{len(bound)}"
        bound[name] = operation
        parts = [f"req({', '.join([f'{{{name}}}', *(f'$v{i}' for i in range(len(limits)))])})"]
        for i, limit in enumerate(limits):
            if hop == 0 or (operation, limit.name) in workload.tightened:
                low, high = f"l{len(bound)}", f"h{len(bound)}"
                bound[low], bound[high] = limit.low, limit.high
                parts.append(f"$v{i} >= {{{low}}}, $v{i} <= {{{high}}}")
        alternatives.append(", ".join(parts))
    return f"check if {' or '.join(alternatives)};", bound
