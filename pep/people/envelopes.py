"""Envelopes: approvals of people beforehand, verified, with the uses that permitted acts took.

An act inside an envelope is permitted as if people had just approved it; any act outside of all of them is asked as
before. The identity provider carries envelopes and cannot make one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.values.units import Quantity
from policies.evidence.evidence import ApprovalReading, DeclaredImpact, ImpactReading
from policies.evidence.tiers import FRESH

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from capabilities.statements.people.envelope import Envelope, Side
    from capabilities.values.chain import Chain
    from pep.people.votes import VerifiedEnvelope
    from policies.evidence.evidence import Evidence
    from policies.evidence.model import Request

RESERVED_MS: Final = 5_000
"""Longest reservation of a use (DESIGN section 6)."""
NO_ROBOT: Final[tuple[int, ...]] = ()


class Envelopes:
    """Envelopes of the provider's last word. The caller serialises the calls."""

    def __init__(self) -> None:
        self._known: dict[str, VerifiedEnvelope] = {}
        self._word_ms = 0
        self._used: dict[str, dict[int, str]] = {}
        self._reserved: dict[str, dict[int, tuple[str, int]]] = {}

    def __len__(self) -> int:
        """Number of known envelopes, over or not."""
        return len(self._known)

    def by_text(self) -> dict[str, VerifiedEnvelope]:
        """Those that were verified before, by their text."""
        return {known.text: known for known in self._known.values()}

    def replace(self, envelopes: Iterable[VerifiedEnvelope], *, sent_ms: int) -> None:
        """Replaces the envelopes in force. One that the provider tells of no more was revoked, or is over.

        Args:
            envelopes: verified.
            sent_ms: monotonic time at which the nonce of the provider's word was sent.
        """
        self._known = {known.envelope.envelope_id: known for known in envelopes}
        self._word_ms = sent_ms

    def reading(
        self, chain: Chain, request: Request, evidence: Evidence, registered: Mapping[bytes, str], *, now_s: float
    ) -> ApprovalReading | None:
        """The approval by the envelope around this very act that ends last, with a use reserved; None outside of all.

        Args:
            chain: chain of the act.
            request: the act.
            evidence: all that is known of it, its impact included.
            registered: people who are registered now, by raw key.
            now_s: seconds since the epoch.
        """
        fit = [
            known.envelope
            for known in self._known.values()
            if registered.get(known.key) == known.envelope.approver
            and keys.thumbprint(known.key) != keys.thumbprint(chain.leaf.key)
            and known.envelope.not_before <= now_s <= known.envelope.not_after
            and _of(known.envelope, chain, request)
            and _around(known.envelope, request, evidence)
        ]
        for envelope in sorted(fit, key=lambda found: (found.not_after, found.envelope_id), reverse=True):
            left, use = self._next_use(envelope, request.request_id, evidence.at_ms)
            if use:
                self._reserved.setdefault(envelope.envelope_id, {})[use] = (
                    request.request_id,
                    evidence.at_ms + RESERVED_MS,
                )
                return self._approval(envelope, evidence, left, use)
        return None

    def stands(self, envelope_id: str, registered: Mapping[bytes, str], *, now_s: float) -> bool:
        """True while the envelope is in force, with uses left or none."""
        known = self._known.get(envelope_id)
        return (
            known is not None
            and registered.get(known.key) == known.envelope.approver
            and known.envelope.not_before <= now_s <= known.envelope.not_after
        )

    def _approval(self, envelope: Envelope, evidence: Evidence, left: int, use: int) -> ApprovalReading:
        impact = evidence.impact
        return ApprovalReading(
            ask_id=envelope.envelope_id,
            state="granted",
            reasons=frozenset(envelope.reasons),
            tier=envelope.tier,
            index_milli=min(envelope.index_milli, impact.index_milli) if isinstance(impact, ImpactReading) else 0,
            contributors=frozenset((seen.kind, seen.object) for seen in envelope.seen),
            start_urad=impact.start_urad if isinstance(impact, ImpactReading) else NO_ROBOT,
            model_digest=envelope.model_digest,
            policy_digest=envelope.policy_digest,
            approvers=(envelope.approver,),
            sponsor=envelope.sponsor,
            opening_id="",
            sees_clear=False,
            uses_left=left,
            use=use,
            not_after=envelope.not_after,
            age_ms=max(0, evidence.at_ms - self._word_ms),
        )

    def _next_use(self, envelope: Envelope, request_id: str, now_ms: int) -> tuple[int, int]:
        """(number of uses left to this request, the next of them or 0); reservations that are over lapse."""
        id_, used = envelope.envelope_id, self._used.get(envelope.envelope_id, {})
        held = {use: by for use, by in self._reserved.get(id_, {}).items() if now_ms <= by[1]}
        self._reserved[id_] = held
        free = [
            use
            for use in range(1, envelope.uses + 1)
            if use not in used and (use not in held or held[use][0] == request_id)
        ]
        return len(free), free[0] if free else 0

    def consume(self, envelope_id: str, request_id: str, use: int, now_ms: int) -> bool:
        """True when the use was reserved for this request, in time, and is its own from now on."""
        held = self._reserved.get(envelope_id, {}).get(use)
        if envelope_id not in self._known or held is None or held[0] != request_id or not now_ms <= held[1]:
            return False
        del self._reserved[envelope_id][use]
        self.recover(envelope_id, request_id, use)
        return True

    def release(self, request_id: str) -> None:
        """Frees the uses that were only reserved for the request."""
        self._reserved = {
            id_: {use: by for use, by in held.items() if by[0] != request_id} for id_, held in self._reserved.items()
        }

    def recover(self, envelope_id: str, request_id: str, use: int) -> None:
        """Counts a use by the request; an earlier process may have recorded it already."""
        self._used.setdefault(envelope_id, {})[use] = request_id

    def give_back(self, envelope_id: str, request_id: str, use: int) -> None:
        """Returns the use, if it was this request's."""
        if self._used.get(envelope_id, {}).get(use) == request_id:
            del self._used[envelope_id][use]


def _of(envelope: Envelope, chain: Chain, request: Request) -> bool:
    """True where the envelope is for acts of this kind, by this agent, for this sponsor, here."""
    leaf = chain.leaf
    mine = (request.audience, chain.sponsor.subject, leaf.agent, keys.thumbprint(leaf.key))
    theirs = (envelope.audience, envelope.sponsor, envelope.agent, envelope.agent_key)
    return mine == theirs and (request.object, request.operation) == (envelope.object, envelope.operation)


def _around(envelope: Envelope, request: Request, evidence: Evidence) -> bool:
    """True where the act, as it is assessed now, is inside every bound of the envelope ([ENV-2])."""
    # every parameter a quantity, each inside its side, and none without one
    quantities = {value.name: value.value for value in request.values if isinstance(value, Quantity)}
    if len(quantities) != len(request.values) or not _inside(envelope.box, quantities):
        return False
    seen = {(seen.kind, seen.object) for seen in envelope.seen}
    match evidence.impact:
        case DeclaredImpact() as impact:
            return not envelope.start_urad and impact.tier == envelope.tier and impact.contributors <= seen
        case ImpactReading() as impact:
            start = {f"joint{number}": angle for number, angle in enumerate(impact.start_urad)}
            return (
                impact.perception == FRESH
                and not impact.violations
                and impact.tier == envelope.tier
                and impact.index_milli <= envelope.index_milli
                and impact.tcp_speed_um_s <= envelope.speed_um_s
                and impact.model_digest == envelope.model_digest
                and {(c.kind, c.object) for c in impact.contributions} <= seen
                and bool(start)
                and _inside(envelope.start_urad, start)
            )
        case _:
            return False


def _inside(sides: tuple[Side, ...], values: Mapping[str, int]) -> bool:
    bounds = {side.name: side for side in sides}
    return bounds.keys() == values.keys() and all(
        bounds[name].low <= value <= bounds[name].high for name, value in values.items()
    )
