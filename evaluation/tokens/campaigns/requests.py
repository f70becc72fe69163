"""Requests to a family of chains, most of them at a boundary that one of its blocks drew."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.arguments import is_of
from capabilities.values.scope import Tier
from capabilities.values.units import Parameter, Quantity, Unit
from evaluation.tokens.campaigns import kinds, twin
from evaluation.tokens.campaigns.families import KEPT, RANGE, ROLE, SET, beside, lay_over, narrower, too_much
from evaluation.tokens.campaigns.issuer import CELLS
from evaluation.tokens.campaigns.kinds import given
from evaluation.tokens.campaigns.twin import Lend, TriedAct

if TYPE_CHECKING:
    from random import Random

    from capabilities.values.arguments import Value
    from capabilities.values.scope import Limit
    from evaluation.tokens.campaigns.families import Family

_BOUNDS: Final = ("ranges", "sets", *kinds.DIMENSIONS)
ACTING: Final = ("grants", *_BOUNDS, "ceiling", "audience", "window")
LENDING: Final = ("delegates", "depth", "budgets")
DIMENSIONS: Final = (*ACTING, *LENDING)
_ODD: Final = 0.05
"""Probability that a request has other parameters than the operation."""


def act(of: Family, dimension: str, chance: Random) -> TriedAct:
    """A request to act that is inside one of the chains but, perhaps, for this dimension."""
    blocks = of.blocks[: chance.randint(1, len(of.blocks))]
    grants = list(blocks[0].grants or ())
    if dimension in _BOUNDS:
        grants = [each for each in grants if (each.object, each.operation) == KEPT[dimension in kinds.DIMENSIONS]]
    grant = chance.choice(grants)
    pair = grant.object, grant.operation
    values = [given(x.parameter, _within(blocks, pair, x, chance)) for x in grant.limits]
    held = of.chains[len(blocks) - 1].scope
    fair = TriedAct(
        *pair,
        tuple(values),
        Tier(chance.randint(0, held.ceiling)),
        chance.choice((held.not_before, held.not_after - 1)),
        CELLS[0],
    )
    if chance.random() < _ODD:
        return replace(fair, values=_odd(values, chance))
    return _at_boundary(of, dimension, fair, chance)


def _within(blocks: Any, pair: tuple[str, str], limit: Limit, chance: Random) -> Any:
    """A value that all the blocks allow, at an end of one of them; where none does, any end."""
    bounds = twin.stated(blocks, pair, limit.parameter)
    found = sorted(set(twin.points(*bounds)))
    ends = [end for end in found if is_of(limit.parameter.kind, given(limit.parameter, end))] or found
    allowed = [end for end in ends if all(twin.inside(bound, end) for bound in bounds)]
    return chance.choice(allowed or ends)


def _at_boundary(of: Family, dimension: str, fair: TriedAct, chance: Random) -> TriedAct:
    """The request with this dimension at a line that some block drew, or a step beside it."""
    block = chance.choice([each for each in of.blocks if _states(each, dimension)])
    match dimension:
        case "grants":
            grants = [g for each in of.blocks for g in each.grants or ()]
            one, other = chance.choice(grants), chance.choice(grants)
            if chance.random() < 0.6:
                return fair
            pair = chance.choice(
                (
                    (one.object, other.operation),
                    (one.operation, one.object),
                    (one.object, one.operation + "x"),
                    (one.object.upper(), one.operation),
                    (one.object, ""),
                )
            )
            return replace(fair, object=pair[0], operation=pair[1])
        case "ranges" | "sets":
            wanted = RANGE if dimension == "ranges" else SET
            return _with(of, KEPT[0], wanted, fair, chance)
        case _ if dimension in kinds.DIMENSIONS:
            return _with(of, KEPT[1], kinds.DIMENSIONS[dimension], fair, chance)
        case "ceiling":
            return replace(fair, base_tier=Tier((block.ceiling or 0) + chance.choice((0, 1))))
        case "audience":
            near = (CELLS[0] + "/", CELLS[0].upper(), CELLS[0] + "/x", CELLS[0][:-1], "")
            return replace(fair, audience=chance.choice(near) if chance.random() < 0.3 else chance.choice(CELLS))
        case "window":
            end = chance.choice([t for t in (block.not_before, block.not_after) if t is not None])
            return replace(fair, at=end + chance.choice((-1, 0, 0, 1)))
        case _:
            raise ValueError(dimension)


def _with(of: Family, pair: tuple[str, str], wanted: Parameter, fair: TriedAct, chance: Random) -> TriedAct:
    """The request with a value of this parameter at a line that some block drew."""
    bounds = twin.stated(of.blocks, pair, wanted)
    value = given(wanted, chance.choice(twin.points(chance.choice(bounds))))
    return replace(fair, values=tuple(value if each.name == wanted.name else each for each in fair.values))


def _states(block: Any, dimension: str) -> bool:
    match dimension:
        case "ceiling":
            return block.ceiling is not None
        case "window":
            return block.not_before is not None or block.not_after is not None
        case _:
            return True


def _odd(values: list[Value], chance: Random) -> tuple[Value, ...]:
    """Other parameters: one less, one more, another order, another kind, a value of another type or spelling."""
    if not values:
        return (Quantity("p0", Unit.COUNT, 0),)
    at = chance.randrange(len(values))
    one = values[at]
    rest = [*values[:at], *values[at + 1 :]]
    strange: Any = chance.choice((None, 1.0, float("nan"), b"/a", ["/a"], "/a/", "/a/../b", "https://A.example", -0.0))
    return tuple(
        chance.choice(
            (
                rest,
                [*values, one],
                [*reversed(values), *(() if len(values) > 1 else (one,))],
                [*values[:at], given(Parameter(one.name, Unit.GRAM), one.value), *values[at + 1 :]],
                [*values[:at], replace(one, name="other"), *values[at + 1 :]],
                [*values[:at], replace(one, value=strange), *values[at + 1 :]],
            )
        )
    )


# --- lending ---------------------------------------------------------------------------------------------------------


def lend(of: Family, dimension: str, chance: Random) -> Lend:
    """Request to delegate the scope of one of the holders, or a little more of this dimension."""
    able = [n for n, chain in enumerate(of.chains) if chain.scope.depth > 0]
    held = of.chains[chance.choice(able)].scope
    scope = lay_over(held, narrower(held, (), chance))
    names = sorted({name for block in of.blocks for name in block.delegates or ()})
    if dimension == "depth":
        depths = [twin.depth(of.blocks[: n + 1]) for n in range(len(of.blocks))]
        scope = replace(scope, depth=chance.choice(depths) + chance.choice((-2, -1, -1, 0)))
        agent, role = chance.choice(sorted(held.delegates - {f"role:{ROLE}"}) or names), ""
    elif dimension == "budgets":
        lines = [g.budgets for block in of.blocks for g in block.grants or () if g.budgets]
        own = beside(chance.choice(lines), chance)
        grants = tuple(replace(g, budgets=own) if (g.object, g.operation) == KEPT[0] else g for g in scope.grants)
        scope = replace(scope, grants=grants)
        agent, role = chance.choice(sorted(held.delegates - {f"role:{ROLE}"}) or names), ""
    else:
        agent, role = _delegate(names, chance)
        if chance.random() < 0.3:
            scope = replace(scope, delegates=scope.delegates | {chance.choice(names)})
    if chance.random() < 0.25:
        what = chance.choice((*_BOUNDS, "budgets", "ceiling", "audience", "window", "grants"))
        scope = lay_over(held, too_much(what, held, chance))
    return Lend(agent, role, scope)


def _delegate(names: list[str], chance: Random) -> tuple[str, str]:
    """Agent and role that a block names, or a name that is only like one."""
    name = chance.choice(names)
    if chance.random() < 0.3:
        return "stranger", chance.choice((ROLE, "", "plan", name.removeprefix("role:")))
    if name.startswith("role:"):
        return "anybody", ROLE
    return (name if chance.random() < 0.8 else name + chance.choice(("x", "-1", "0"))), ""
