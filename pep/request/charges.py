"""Charges of a request: its part of every budget on its chain, at the point where it is enforced."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pep.journal.budget_store import Charge

if TYPE_CHECKING:
    from capabilities.values.chain import Chain
    from capabilities.values.scope import Budget
    from policies.evidence.model import Request


def charges(chain: Chain, request: Request) -> tuple[Charge, ...]:
    """Charges of a request, from the sponsor's own hop downwards.

    A budget that a hop only keeps from its parent is the parent's: all that is below that hop is below the parent.

    Args:
        chain: verified, and grants the request.
        request: to be charged, at its audience; budgets at others are spent there.
    """
    found: list[Charge] = []
    above: tuple[Budget, ...] = ()
    for hop in chain.hops:
        grant = hop.scope.find(request.object, request.operation)
        stated = () if grant is None else grant.budgets
        for budget in stated:
            amount = _amount(budget, request)
            if budget.audience == request.audience and budget not in above and amount:
                holder = promise(chain) if hop.index == 0 else hop.hop_id
                account = _account(holder, request, budget)
                found.append(Charge(account, amount, budget.most, budget.window_s, hop.index, budget.parameter))
        above = stated
    return tuple(found)


def promise(chain: Chain) -> str:
    """Name of the sponsor's promise, the mandate or the token, to which all that is drawn from it is charged."""
    return chain.mandate_id or chain.token_id


def _account(holder: str, request: Request, budget: Budget) -> str:
    # No name, id or URL holds a blank, so no two accounts have one text.
    parts = holder, request.object, request.operation, budget.parameter, budget.audience, str(budget.window_s)
    return " ".join(parts)


def _amount(budget: Budget, request: Request) -> int:
    """Part of a budget that the request takes: one act, or its own value of the quantity."""
    if not budget.parameter:
        return 1
    for value in request.values:
        if value.name == budget.parameter and type(value.value) is int and value.value >= 0:
            return value.value
    raise ValueError("a budget of a parameter that the request does not give")
