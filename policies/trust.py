"""Trust belongs to one edge, is capped by the policy's prior, and a chain is as trusted as its weakest edge.

A statement can only lower trust: what is not stated is the prior, what is stated above it is the prior, and nothing
flows along the chain (CATP-1). So no statement, true or forged, makes an agent more trusted than one that nobody
knows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from policies.evidence import TrustReading

if TYPE_CHECKING:
    from collections.abc import Iterable

    from policies.parameters import Parameters


def edge_trust(stated_permille: int | None, parameters: Parameters) -> int:
    """Trust in one edge, 0 to the prior, in permille.

    Args:
        stated_permille: what the signed registry states about the edge's delegate, or None when it states nothing.
            Anything that is not an integer from 0 to 1000 is no statement that can be believed, and gives 0.
        parameters: of the policy set.
    """
    if stated_permille is None:
        return parameters.trust_prior_permille
    if type(stated_permille) is not int or not 0 <= stated_permille <= 1000:
        return 0
    return min(stated_permille, parameters.trust_prior_permille)


def chain_trust(stated_permille: Iterable[int | None], parameters: Parameters) -> TrustReading:
    """The reading for a chain: the weakest of its edges.

    Args:
        stated_permille: one entry for each hop, the authority block's agent first; a chain without edges has no trust
            at all.
        parameters: of the policy set.
    """
    return TrustReading(min((edge_trust(stated, parameters) for stated in stated_permille), default=0))
