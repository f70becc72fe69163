"""Bounds of a stream's values under a lease, which may be renewed while the stream goes on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capabilities.values.chain import Chain
from pep.rtde.command.stream_bounds import StreamBounds
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capabilities.values.scope import Grant
    from pep.base.operation_row import Operation
    from pep.request.authority import Credentials
    from pep.rtde.robot.judge_port import ProgramOwner


class LeaseBounds:
    """Bounds of one stream: those it was opened in, which are on record, and those of the lease's token now.

    Args:
        operation: that the stream is of.
        grant: of the chain that it was decided by, for that operation.
        lease: that it is of; its credentials may become others at any time.
        credentials: by which it was decided.

    Attributes:
        operation, grant: the same.
    """

    def __init__(
        self, operation: Operation, grant: Grant, lease: ProgramOwner, credentials: Credentials | None
    ) -> None:
        self.operation = operation
        self.grant = grant
        self._opened = StreamBounds(operation, grant)
        self._lease = lease
        # One place for both, which the loop and the watch's thread replace whole.
        self._newest: tuple[Credentials | None, StreamBounds | None] = credentials, self._opened

    def outside(self, numbers: Sequence[float]) -> Reason | None:
        """Reason why a value is outside, as `StreamBounds.outside`; `NOT_GRANTED` where the token has no such grant."""
        now = self._lease.credentials
        seen, newest = self._newest
        if now is not seen:
            newest = self._of(now)
            self._newest = now, newest
        if newest is self._opened:
            return self._opened.outside(numbers)
        if newest is None:
            return Reason.NOT_GRANTED
        return self._opened.outside(numbers) or newest.outside(numbers)

    def _of(self, credentials: Credentials) -> StreamBounds | None:
        chain = credentials.chain
        if not isinstance(chain, Chain):
            return None
        grant = chain.scope.find(self.operation.object, self.operation.name)
        return None if grant is None else StreamBounds(self.operation, grant)
