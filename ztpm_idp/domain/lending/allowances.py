"""Allowances: how much of each thing one sponsor may have at the provider, so that no sponsor fills it alone.

They are counted over rows in a command's own transaction. Commands that run side by side do not see each other, so a
sponsor may be over by as many as run at once, and far below an allowance a count may be a second old; agents and asks
are never over.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Final

from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.events import TokenDelegated, TokenIssued
from ztpm_idp.domain.lending.amounts import Allowances, Used

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ztpm_idp.domain.events import Event
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State, Wanted

_WORDS: Final = {
    "live_tokens": "tokens that are live",
    "tokens_an_hour": "tokens made within an hour",
    "delegations": "hops of one token and all that were made of it",
    "mandates": "mandates in force",
    "agents": "living agents",
    "asks": "asks that wait",
}


def spent(rules: Rules, sponsor: str, used: Used, *names: str) -> Refusal | None:
    """Refusal where one of these allowances has nothing left."""
    most = rules.allowances.of(sponsor)
    for name in names:
        if not getattr(used, name) < getattr(most, name):
            return Refusal(IdpCode.ALLOWANCE_SPENT, _told(name, sponsor, getattr(used, name), getattr(most, name)))
    return None


def of_token(rules: Rules, state: State, sponsor: str) -> Refusal | None:
    """Refusal where the sponsor may have no further token now."""
    return spent(rules, sponsor, state.used, "live_tokens", "tokens_an_hour")


def of_agent(rules: Rules, state: State, sponsor: str) -> Refusal | None:
    """Refusal where the sponsor may have no further agent; the state holds its crowd."""
    return spent(rules, sponsor, Used(agents=state.crowd), "agents")


def after(state: State, needed: Wanted, made: Iterable[Event]) -> State:
    """The state after tokens and hops that other commands have made in the same transaction."""
    if needed.lent_by is None and needed.tree is None:
        return state
    tokens = hops = 0
    for event in made:
        match event:
            case TokenIssued(sponsor=sponsor) if sponsor.subject == needed.lent_by:
                tokens += 1
            case TokenDelegated(chain=chain) if chain.token_id == needed.tree:
                hops += 1
            case _:
                continue
    used = state.used
    more = replace(
        used,
        live_tokens=used.live_tokens + tokens,
        tokens_an_hour=used.tokens_an_hour + tokens,
        delegations=used.delegations + hops,
    )
    return replace(state, used=more)


def names() -> tuple[str, ...]:
    """Name of each allowance, as settings and answers spell it."""
    return tuple(each.name for each in fields(Allowances))


def _told(name: str, sponsor: str, used: int, most: int) -> str:
    return f"{name}: {sponsor} has {used} {_WORDS[name]}, of {most}; who runs the provider can raise it in [allowances]"
