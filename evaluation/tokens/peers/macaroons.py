"""Macaroons: a floor. Who checks them holds the secret that makes them, so a chain costs one HMAC a caveat."""

from __future__ import annotations

import base64
import json
from typing import TYPE_CHECKING, Any, ClassVar, Final

from evaluation.harness.absent import package
from evaluation.harness.timing import Verdict
from evaluation.tokens.peers.plain import Ask, PlainPeer

if TYPE_CHECKING:
    from evaluation.tokens.workload import Workload

_KEY: Final = "a shared secret of the benchmark"


class Macaroons(PlainPeer):
    """See the module."""

    name = "macaroons"
    checks: ClassVar[str] = "one HMAC a caveat under a shared secret; limits by our callback (no keys, no attestation)"
    checks_seen: ClassVar[str] = "the decoded macaroon: as from the wire"

    def __init__(self) -> None:
        super().__init__()
        self._library, self.version = package("pymacaroons", "pymacaroons")
        self._invalid = package("pymacaroons.exceptions", "pymacaroons")[0].MacaroonException

    def mint(self, workload: Workload, serial: int) -> Any:
        """A macaroon with one caveat over the operations that are lent."""
        made = self._library.Macaroon(location="ur3e", identifier=f"token {serial}", key=_KEY)
        made.add_first_party_caveat(_caveat(workload, 0, serial))
        return made

    def attenuate(self, made: Any, workload: Workload, hop: int, serial: int) -> Any:
        """One caveat more, with the bounds that are tightened."""
        narrower = made.copy()
        narrower.add_first_party_caveat(_caveat(workload, hop, serial))
        return narrower

    def wire(self, made: Any) -> str:
        """The serialised text."""
        return str(made.serialize())

    def size(self, token: Any) -> int:
        """Bytes before base64."""
        return len(base64.urlsafe_b64decode(token + "=" * (-len(token) % 4)))

    def read(self, token: Any) -> Any:
        """The decoded macaroon."""
        return self._library.Macaroon.deserialize(token)

    def decide(self, token: Any, ask: Ask) -> Verdict:
        """Read, then ask."""
        return self.decide_read(self.read(token), ask)

    def decide_read(self, kept: Any, ask: Ask) -> Verdict:
        """Every HMAC, and our callback on every caveat."""
        verifier = self._library.Verifier()
        verifier.satisfy_general(lambda caveat: _permits(caveat, ask))
        try:
            verifier.verify(kept, _KEY)
        except self._invalid:
            return Verdict.REFUSED
        return Verdict.ALLOWED


def _caveat(workload: Workload, hop: int, serial: int) -> str:
    """JSON: by operation the parameters in order, each with its bounds where this hop states them."""
    return json.dumps(
        {
            operation: {
                limit.name: [limit.low, limit.high]
                if hop == 0 or (operation, limit.name) in workload.tightened
                else None
                for limit in limits
            }
            for operation, limits in workload.numbers(hop, serial)
        },
        separators=(",", ":"),
    )


def _permits(caveat: str, ask: Ask) -> bool:
    bounds = json.loads(caveat).get(ask.operation)
    if bounds is None or bounds.keys() != ask.arguments.keys():
        return False
    return all(bound is None or bound[0] <= ask.arguments[name] <= bound[1] for name, bound in bounds.items())
