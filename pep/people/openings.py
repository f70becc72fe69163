"""Openings: people's prior leave to ask for safety-critical acts, verified, with the uses that permitted acts took."""

from __future__ import annotations

from typing import TYPE_CHECKING

from policies.evidence.evidence import OpeningReading

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from capabilities.values.chain import Chain
    from pep.people.votes import VerifiedOpening
    from policies.evidence.model import Request


class Openings:
    """Openings of the provider's last word. The caller serialises the calls."""

    def __init__(self) -> None:
        self._known: dict[str, VerifiedOpening] = {}
        self._word_ms = 0
        self._used: dict[str, set[str]] = {}

    def __len__(self) -> int:
        """Number of known openings, over or not."""
        return len(self._known)

    def by_text(self) -> dict[str, VerifiedOpening]:
        """Those that were verified before, by their text."""
        return {leave.text: leave for leave in self._known.values()}

    def replace(self, leaves: Iterable[VerifiedOpening], *, sent_ms: int) -> None:
        """Replaces the openings in force. One that the provider tells of no more was withdrawn, or is over.

        Args:
            leaves: verified.
            sent_ms: monotonic time at which the nonce of the provider's word was sent.
        """
        self._known = {leave.opening.opening_id: leave for leave in leaves}
        self._word_ms = sent_ms

    def reading(
        self, chain: Chain, request: Request, registered: Mapping[bytes, str], *, named: str, now_s: float, at_ms: int
    ) -> OpeningReading | None:
        """The opening `named`, else the one that ends last; of those in force for this agent and act, or None.

        Args:
            chain: chain of the act.
            request: the act.
            registered: people who are registered now, by raw key.
            named: the opening that an ask rests on, or "".
            now_s: seconds since the epoch.
            at_ms: monotonic time of the evidence.
        """
        wanted = (request.audience, chain.leaf.agent, request.object, request.operation)
        age_ms = max(0, at_ms - self._word_ms)
        fit = [
            OpeningReading(opening.opening_id, opening.opener, left, opening.not_after, age_ms)
            for opening, key in ((leave.opening, leave.key) for leave in self._known.values())
            if (opening.audience, opening.agent, opening.object, opening.operation) == wanted
            and registered.get(key) == opening.opener
            and opening.not_before <= now_s <= opening.not_after
            and (left := opening.uses - len(self._used.get(opening.opening_id, ()))) >= 1
        ]
        return max(fit, key=lambda o: (o.opening_id == named, o.not_after, o.opening_id), default=None)

    def stands(self, opening_id: str, registered: Mapping[bytes, str], *, now_s: float) -> bool:
        """True while the opening is in force, with uses left or none."""
        leave = self._known.get(opening_id)
        return (
            leave is not None
            and registered.get(leave.key) == leave.opening.opener
            and leave.opening.not_before <= now_s <= leave.opening.not_after
        )

    def consume(self, opening_id: str, request_id: str) -> bool:
        """True when an act of this request may rest on the opening, and takes one of its uses."""
        leave = self._known.get(opening_id)
        if leave is None or not len(self._used.get(opening_id, ())) < leave.opening.uses:
            return False
        self.recover(opening_id, request_id)
        return True

    def recover(self, opening_id: str, request_id: str) -> None:
        """Counts a use of the opening by the request; an earlier process may have recorded it already."""
        self._used.setdefault(opening_id, set()).add(request_id)

    def give_back(self, opening_id: str, request_id: str) -> None:
        """Returns the use that the request took."""
        self._used.get(opening_id, set()).discard(request_id)
