"""Access token of an OAuth client, judged against the capability behind it: clauses [OAT-3] to [OAT-5]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Self

from capabilities.keys.keys import thumbprint
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import EvidenceKind
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Tier

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.values.chain import Chain

TOKEN_BYTES: Final = 8_192
"""Longest access token that is looked at [OAT-1]."""
HIGHEST: Final = Tier(DEFAULT.client_evidence_ceiling)
"""Highest ceiling under an access token [OAT-5]."""
_DOTS: Final = 2


@dataclass(frozen=True, slots=True)
class Looked:
    """Answer of the identity provider about an access token.

    Attributes:
        jti, audience, sponsor: of the token.
        actors: agents of its nested `act`, the holder first.
        expires_at: its end, seconds since the epoch.
        jkt: thumbprint of the key that it is bound to, or None.
        capability: text of the capability behind it.
    """

    jti: str
    audience: str
    sponsor: str
    actors: tuple[str, ...]
    expires_at: int
    jkt: str | None
    capability: str

    def __repr__(self) -> str:
        return f"Looked(jti={self.jti!r}, sponsor={self.sponsor!r}, actors={self.actors!r})"

    @classmethod
    def read(cls, answer: Mapping[str, object]) -> Self | None:
        """The answer of introspection, or None for one of another form."""
        cnf, actors = answer.get("cnf", {}), _actors(answer.get("act"))
        jkt = cnf.get("jkt") if isinstance(cnf, dict) else False
        texts = tuple(answer.get(member) for member in ("jti", "aud", "sub", "ztpm_capability"))
        expires = answer.get("exp")
        if actors is None or not isinstance(expires, int) or isinstance(expires, bool):
            return None
        if ("cnf" in answer and not isinstance(jkt, str)) or not (jkt is None or isinstance(jkt, str)):
            return None
        match texts:
            case (str(jti), str(audience), str(sponsor), str(capability)):
                return cls(jti, audience, sponsor, actors, expires, jkt, capability)
            case _:
                return None


def is_access_token(text: str) -> bool:
    """True for a text with the two dots of a JWT, which no token of ours has."""
    return text.count(".") == _DOTS


def disagreement(looked: Looked, chain: Chain, *, audience: str) -> Fault | None:
    """The fault of a capability that is not this access token's, or is more than a client may have.

    Args:
        looked: the provider's answer.
        chain: the verified capability of that answer.
        audience: of this enforcement point.
    """
    # [OAT-3] the very chain that the token names
    same = (
        looked.audience == audience
        and looked.jti == chain.leaf.hop_id
        and looked.sponsor == chain.sponsor.subject
        and looked.actors == tuple(hop.agent for hop in reversed(chain.hops))
    )
    if not same:
        return Fault(FaultCode.WRONG_PROFILE, "OAT-3", "the capability is another than the access token's")
    if chain.scope.ceiling > HIGHEST:
        return Fault(FaultCode.WRONG_PROFILE, "OAT-3", f"the ceiling is above {int(HIGHEST)}")
    # [OAT-4] a hop of an agent is used with the agent's own key, a client's with whatever key the token is bound to
    if chain.leaf.attestation.kind is EvidenceKind.CLIENT:
        return None
    if looked.jkt is None:
        return Fault(FaultCode.PROOF_MISSING, "OAT-4", "an agent's access token is bound to its key")
    if looked.jkt != thumbprint(chain.leaf.key):
        return Fault(FaultCode.PROOF_WRONG_KEY, "OAT-4", "not bound to the holder's key")
    return None


def _actors(act: object) -> tuple[str, ...] | None:
    found: list[str] = []
    while act is not None:
        if not isinstance(act, dict) or not isinstance(act.get("sub"), str):
            return None
        found.append(act["sub"])
        act = act.get("act")
    return tuple(found) or None
