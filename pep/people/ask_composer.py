"""Composition of asks out of a decision and its evidence. Pure."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.statements.people import ask, picture
from capabilities.statements.people.ask import APPROVERS_OF_TIER, CONTRIBUTORS, NO_ROBOT, Ask, AskedFact, Contributor
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.chain import Chain
from capabilities.values.units import Unit
from policies.evidence.evidence import DeclaredImpact, ImpactReading, prior_leave
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from capabilities.keys.keys import PrivateKey
    from pep.base.ports import Pictures
    from policies.evidence.evidence import Evidence
    from policies.evidence.model import Decision, Request

NOTHING: Final = hashlib.sha256(b"").hexdigest()
"""Stands for model and scene where no physics was computed."""
ABOUT_AN_ANSWER: Final = frozenset({Reason.APPROVAL_USED, Reason.APPROVAL_NOT_USABLE})
"""Reasons of a deferral that say only that an older answer does not count."""


@dataclass(frozen=True, slots=True)
class Asker:
    """Author of asks: this PEP, with its audience, its key and its identity provider.

    `pictures` gives what people are shown of a motion; None for a point where nothing moves.
    """

    pep: str
    audience: str
    issuer: str
    key: PrivateKey
    pictures: Pictures | None = None

    def page(self, ask_id: str) -> str:
        """URL of the provider's page on which people see the ask."""
        return f"{self.issuer}/approvals/{ask_id}/page"


def reasons_of(decision: Decision) -> tuple[str, ...]:
    """The deferral reasons that an approval would have to resolve, in order, each once."""
    return tuple(dict.fromkeys(str(f.reason) for f in decision.findings if f.reason not in ABOUT_AN_ANSWER))


def compose(
    request: Request,
    evidence: Evidence,
    decision: Decision,
    *,
    asker: Asker,
    nonce: str,
    asked_at: int,
    expires_at: int,
) -> tuple[Ask, str, str]:
    """The ask and its signed text, readable as one, and the text of the picture that it names, or "".

    Args:
        request: that was deferred.
        evidence: on which.
        decision: the DEFER.
        asker: this PEP.
        nonce: 32 random hex digits.
        asked_at: seconds since the epoch.
        expires_at: likewise, later.

    Raises:
        ValueError: for evidence without a verified chain or tier: nothing that people could be asked.
        StatementError: when a name or number has no place in a statement.
    """
    chain, impact = evidence.chain, evidence.impact
    if not isinstance(chain, Chain) or decision.tier is None:
        raise ValueError("nothing that people could be asked")
    seen = impact if isinstance(impact, ImpactReading) else None
    shown = "" if seen is None or asker.pictures is None else asker.pictures.shown(request.request_id) or ""
    unseen = NO_ROBOT if isinstance(impact, DeclaredImpact) else "missing"
    wanted = APPROVERS_OF_TIER.get(decision.tier, 1)
    leave = prior_leave(evidence) if wanted > 1 else None
    asked = Ask(
        ask_id=request.request_id,
        nonce=nonce,
        pep=asker.pep,
        audience=asker.audience,
        issuer=chain.sponsor.issuer,
        sponsor=chain.sponsor.subject,
        token_id=chain.token_id,
        agent=chain.leaf.agent,
        agent_key=keys.thumbprint(chain.leaf.key),
        object=request.object,
        operation=request.operation,
        values=request.values,
        request_digest=request.digest,
        start_urad=() if seen is None else seen.start_urad,
        model_digest=NOTHING if seen is None else seen.model_digest,
        policy_digest=decision.policy_digest,
        scene_digest=NOTHING if seen is None else seen.scene_digest,
        tier=decision.tier,
        index_milli=decision.index or 0,
        reasons=reasons_of(decision),
        contributors=tuple(
            Contributor(c.kind, c.link, c.object, c.index_milli, c.clearance_um, c.speed_um_s, c.source)
            for c in (() if seen is None else seen.contributions[:CONTRIBUTORS])
        ),
        perception=unseen if seen is None else seen.perception,
        perception_age_ms=None if seen is None else seen.perception_age_ms,
        approvers=wanted,
        opening_id="" if leave is None else leave.opening_id,
        asked_at=asked_at,
        expires_at=expires_at,
        mandate_id=chain.mandate_id or "",
        facts=_facts(impact) if isinstance(impact, DeclaredImpact) else (),
        picture_digest=picture.digest_of(shown) if shown else "",
    )
    text = ask.sign(asked, asker.key)
    # an unreadable question must not be asked
    return ask.open(text, [keys.public_raw(asker.key)], CAPS), text, shown


def _facts(impact: DeclaredImpact) -> tuple[AskedFact, ...]:
    """The facts that rows depended on, as people are shown them."""
    return tuple(
        AskedFact(f.fact, f.state, Unit(f.unit), f.value, f.age_ms, f.fact in impact.raised_by) for f in impact.facts
    )
