"""Authority that is lent in a run: the scope of every token, and access tokens that were made before it."""

from __future__ import annotations

import secrets
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.token.mint import HopGrant, mint
from capabilities.token.token_text import token_to_text
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Attestation, EvidenceKind, Sponsor
from capabilities.values.scope import Grant, Limit, Range, Scope, Tier
from capabilities.values.units import Parameter, Unit
from ztpm_idp.domain.events import SignedRequest, TokenIssued
from ztpm_idp.domain.oauth.events import AccessMade
from ztpm_idp.domain.oauth.records import AccessRecord

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    from capabilities.keys.keys import PrivateKey

AUDIENCE: Final = "https://plant.example/mcp"
LIFETIME_S: Final = 900
ACCESS: Final = 200
"""Access tokens, each of which is asked about once in a round of as many requests."""
ACCESS_LIFETIME_S: Final = 3_600
"""As long as the evidence of a key carries: no run lasts longer."""
TURN, SPEED = Parameter("q0", Unit.MICRORADIAN), Parameter("speed", Unit.MICRORADIAN_PER_SECOND)
ROLE: Final = "worker"


def scope_now() -> Scope:
    """Scope that a sponsor lends: a motion with two limits, and the stop."""
    now = int(time.time())
    return Scope(
        grants=(
            Grant(
                "arm",
                "move_joint",
                (Limit(TURN, Range(-3_000_000, 3_000_000)), Limit(SPEED, Range(0, 1_000_000))),
            ),
            Grant("arm", "stop"),
        ),
        ceiling=Tier.CONSEQUENTIAL,
        audiences=frozenset({AUDIENCE}),
        delegates=frozenset({f"role:{ROLE}"}),
        depth=3,
        not_before=now - 5,
        not_after=now + LIFETIME_S,
    )


def access_records(
    sponsors: Sequence[tuple[str, PrivateKey]],
    agents: Sequence[tuple[str, PrivateKey]],
    root: Ed25519PrivateKey,
    *,
    issuer: str,
) -> list[tuple[TokenIssued, AccessMade]]:
    """Access tokens of agents, as `client_credentials` makes them, each with the capability behind it."""
    now, made = int(time.time()), list[tuple[TokenIssued, AccessMade]]()
    scope = replace(scope_now(), ceiling=Tier.REVERSIBLE, not_after=now + ACCESS_LIFETIME_S)
    for number in range(ACCESS):
        place = 2 * number % len(agents)
        (agent, key), (sponsor, _) = agents[place], sponsors[place // 2 % len(sponsors)]
        lender = Sponsor(issuer=issuer, subject=sponsor, method="operator-key", authenticated_at=now)
        hop = HopGrant(
            hop_id=secrets.token_hex(16),
            agent=agent,
            key=keys.public_raw(key),
            delegator=sponsor,
            purpose="benchmark",
            request_digest=bytes(32),
            attestation=Attestation(EvidenceKind.KEY, bytes(32), now),
            role=ROLE,
        )
        token_id = keys.b64u(secrets.token_bytes(16))
        token = mint(root=root, root_key_id=1, token_id=token_id, sponsor=lender, hop=hop, scope=scope, caps=DEFAULT)
        access = AccessRecord(
            jti=hop.hop_id,
            token_id=token_id,
            family=None,
            client_id=agent,
            actors=(agent,),
            sponsor=sponsor,
            authenticated_at=now,
            audience=AUDIENCE,
            scope="",
            jkt=None,
            issued_at=now,
            not_after=scope.not_after,
            capability=token_to_text(token),
        )
        signed = SignedRequest("POST", issuer, "", "")
        made.append((TokenIssued(token_id, lender, hop, scope, "", signed, None), AccessMade(access)))
    return made
