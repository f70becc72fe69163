"""Deferrals of an enforcement point, composed; and what a gate remembers of an earlier process."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from capabilities.values.caps import DEFAULT as CAPS
from pep.gate import records
from pep.people.ask_composer import Asker
from pep.people.asks import Asks
from pep.provider.ask_client import AskClient

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.keys.keys import PrivateKey
    from capabilities.keys.trust import TrustBundle
    from pep.base.ports import Journal, Pictures
    from pep.gate.gate import Gate
    from pep.journal.file_journal import FileJournal
    from pep.point.parts import PointParts


@dataclass(frozen=True, slots=True)
class Deferrals:
    """Asks to people, and the client that puts them."""

    asks: Asks
    asking: AskClient

    @classmethod
    def of(
        cls,
        parts: PointParts,
        *,
        journal: Journal,
        timeout_ms: int,
        trust: TrustBundle,
        key: PrivateKey,
        pictures: Pictures | None,
    ) -> Deferrals:
        """Deferrals over the parts of a point.

        Args:
            parts: of the point.
            journal: takes each ask and answer before it counts.
            timeout_ms: time for which a deferral waits for people.
            trust: the issuer's public keys.
            key: of this PEP.
            pictures: of motions; None for a point without a robot.
        """
        config = parts.config
        asker = Asker(pep=config.pep_id, audience=config.audience, issuer=config.issuer, key=key, pictures=pictures)
        asks = Asks(
            clock=parts.clock,
            journal=journal,
            timeout_ms=timeout_ms,
            asker=asker,
            approvers=parts.follower,
            caps=CAPS,
        )
        asking = AskClient(
            asks, parts.http, asker=asker, trust=trust, caps=CAPS, clock=parts.clock, incident=parts.feed_incident
        )
        parts.follower.trusts.followers.append(asking.renew)
        return cls(asks, asking)


def recover_gate(journal: FileJournal, *, gate: Gate, asks: Asks, proofs: Callable[[], None]) -> None:
    """Remembers what an earlier process left, and records an end for the permits that it left open.

    Args:
        journal: of both.
        gate: of this one.
        asks: likewise.
        proofs: remembers accepted proofs.
    """
    permits = records.unfinished(journal.records())
    asks.recover(journal.records())
    gate.conduct.recall(journal.records())
    proofs()
    for request_id, digest in permits:
        journal.append("outcome", {"request_id": request_id, "decision": digest, "outcome": "unknown"})
    asks.expire()
