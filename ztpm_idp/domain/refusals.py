"""Budget of an agent's refusals: the ledger keeps so many in a time, then one entry for all the rest."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.events import RefusalCounted, RefusalsSpent
from ztpm_idp.domain.parties import RegisteredAgent

if TYPE_CHECKING:
    from ztpm_idp.domain.state import State

WINDOW_MS: Final = 600_000
BUDGET: Final = 64
"""Most refusals of one agent that are recorded one by one in a window of ten minutes.

With bodies of at most `BODY_BYTES` that is less than 4 kB each second, for any agent.
"""
BODY_BYTES: Final = 8_192
"""Longest body of a refused request that is kept.

Of a longer one the proof is kept, which names the digest.
"""
WIDENINGS: Final = 16
"""Most places at which an attempt asked for more that are kept of it."""


def bounded(state: State, caller: str, refusal: Refusal, at_ms: int) -> Refusal:
    """The refusal, with the records that its caller's budget still allows.

    People and enforcement points have no budget here: they have few refusals, no trust, and a person who ends them.
    """
    if not refusal.recorded or not isinstance(state.parties.get(caller), RegisteredAgent):
        return refusal
    since_ms, number = state.refusals
    if not 0 <= at_ms - since_ms < WINDOW_MS:
        since_ms, number = at_ms, 0
    counted = RefusalCounted(caller, since_ms, number + 1)
    if number < BUDGET:
        return replace(refusal, recorded=(*refusal.recorded, counted))
    spent = (RefusalsSpent(caller, BUDGET, WINDOW_MS // 1_000), *refusal.charge, counted) if number == BUDGET else ()
    return Refusal(IdpCode.REFUSALS_SPENT, f"at most {BUDGET} refusals in {WINDOW_MS // 60_000} minutes", spent)
