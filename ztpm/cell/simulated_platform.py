"""Simulated platform of an embedded cell: it attests the software behind each key.

On a real host this is a workload attestor such as a SPIRE agent: it looks at the process that asks (its image, its
user, its node) and measures it itself. This one is told: it signs what the cell's own composition gives it. So in the
embedded cell evidence of kind `jwt` shows how the parts fit; that the measurement does not come from the agent is what
a real platform adds.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.statements import workload
from capabilities.values.caps import DEFAULT

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.keys.keys import PrivateKey

TRUST_DOMAIN: Final = "cell.local"
"""Name of an embedded cell's platform; `.local` (RFC 6762) is nobody's on any network."""


def workload_id(agent: str) -> str:
    """Workload id of an agent on the cell's platform."""
    return f"spiffe://{TRUST_DOMAIN}/{agent}"


@dataclass(frozen=True, slots=True)
class Attestor:
    """Signs workload tokens.

    Attributes:
        key: the platform's, of that role alone.
        issuer: of the identity provider, the one audience of every token.
        now: wall clock, seconds since the epoch.
    """

    key: PrivateKey
    issuer: str
    now: Callable[[], float]

    def token(self, agent: str, key: bytes, measurement: bytes) -> str:
        """Token for this agent's workload, bound to its key, for the whole life of the profile.

        Args:
            agent: its id.
            key: its raw public key.
            measurement: SHA-256 over what it runs.
        """
        at = int(self.now())
        said = workload.Workload(
            id=workload_id(agent),
            audience=self.issuer,
            key_thumbprint=keys.thumbprint(key),
            measurement=measurement,
            issued_at=at,
            expires_at=at + DEFAULT.workload_token_lifetime_s,
            token_id=secrets.token_hex(16),
        )
        return workload.sign(said, self.key)

    def source(self, agent: str, key: bytes, measurement: bytes) -> Callable[[], str]:
        """Source of such a token at each call, for the `workload` of `ztpm_idp.client.Agent`."""
        return lambda: self.token(agent, key, measurement)
