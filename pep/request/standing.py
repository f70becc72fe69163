"""Standing of the authority behind a permitted request while its effect lasts, also after its holder has renewed it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.values.chain import Refusal
from capabilities.values.errors import Fault, FaultCode
from pep.base.operations import touchable

if TYPE_CHECKING:
    from capabilities.values.chain import Chain
    from capabilities.values.scope import Tier
    from pep.base.ports import Clock
    from pep.request.authority import Authority, Credentials
    from pep.request.call import Call

CLAUSE: Final = "LSD-10"


class StandingAuthority:
    """Standing of one permitted request's authority: steps 1 to 9 as of each call.

    Where other credentials have taken the place of those it was decided by, these count, and they have to permit the
    request too: with its values, at its tier, and all that it may touch.

    Args:
        call: that was permitted.
        authority: verifies.
        lease_ms: oldest acceptable view of revocations.
        tier: of the decision; None where it had none.
        touch: objects that the arm may touch under the permit.
        clock: the wall clock counts.
    """

    def __init__(
        self,
        call: Call,
        authority: Authority,
        *,
        lease_ms: int,
        tier: Tier | None,
        touch: frozenset[str],
        clock: Clock,
    ) -> None:
        self._call = call
        self._authority = authority
        self._lease_ms = lease_ms
        self._tier = tier
        self._touch = touch
        self._clock = clock
        self._compared: tuple[Credentials, Fault | None] | None = None

    def __call__(self) -> Fault | None:
        """Fault of the authority now; None while it stands."""
        call = self._call
        now = call.credentials if call.renewed is None else call.renewed()
        chain = self._authority.standing(now, lease_ms=self._lease_ms)
        if isinstance(chain, Fault):
            return chain
        if now is call.credentials:
            return None
        if self._compared is None or self._compared[0] is not now:
            self._compared = now, self._lacks(chain)
        return self._compared[1]

    def _lacks(self, chain: Chain) -> Fault | None:
        """Fault of a chain that does not permit what was decided; None where it does."""
        request, base_tier = self._call.request, self._call.tool.base_tier
        if base_tier is None:
            return Fault(FaultCode.NOT_GRANTED, CLAUSE, "no registered tool")
        refused = self._authority.verifier.check_request(
            chain,
            object=request.object,
            operation=request.operation,
            values=request.values,
            base_tier=base_tier,
            at=self._clock.wall_s(),
        )
        if isinstance(refused, Refusal):
            return Fault(refused.code, CLAUSE, refused.parameter or refused.detail)
        if refused is not None:
            return refused
        if self._tier is not None and not self._tier <= chain.scope.ceiling:
            return Fault(FaultCode.ABOVE_CEILING, CLAUSE)
        if not self._touch <= touchable(chain):
            return Fault(FaultCode.NOT_GRANTED, CLAUSE, "to touch what it may have touched")
        return None
