"""The campaigns of `ztpm eval tokens`, in the order in which they run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from evaluation.tokens.campaigns import edges, hostile, load, samples, searches, wycheproof

if TYPE_CHECKING:
    from evaluation.harness.campaign import Campaign

CAMPAIGNS: Final[list[Campaign]] = [
    searches.MUTANTS,
    searches.ENCODINGS,
    samples.CAMPAIGN,
    wycheproof.CAMPAIGN,
    searches.ATTENUATION,
    hostile.CAMPAIGN,
    load.CAMPAIGN,
    edges.CAMPAIGN,
    searches.LATTICE,
]
