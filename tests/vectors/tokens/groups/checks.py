"""[TOK-6], item 3: a check has one of two forms."""

from __future__ import annotations

from dataclasses import replace

from capabilities.values.errors import FaultCode
from tests.vectors.tokens.cases import Group, faults, group
from tests.vectors.tokens.ordinary import (
    GRIPPER,
    LESS,
    NOW,
    SLOWER,
    SMALL,
    Texts,
    authority,
    hop,
    message,
    replaced,
)
from tests.vectors.tokens.sealing import Sealed, cut, inner, put, varint

WIDTH = "$v0 >= 0, $v0 <= 85000"
FORCE = "{10, 20, 40}.contains($v1)"
HEAD = 'req("ur3e", "gripper_move", $v0, $v1)'
CONTEXT = "req_ctx($time, $tier)"
START, END, CEILING = f"$time >= {NOW - 60}", f"$time < {NOW + 600}", "$tier <= 1"
ONE = replace(SMALL, grants=(GRIPPER,))

BROKEN: dict[str, Texts] = {
    "No check over the request": lambda checks: checks[1:],
    "No check over its context": lambda checks: checks[:1],
    "No check at all": lambda _: [],
    "The context before the request": lambda checks: checks[::-1],
    "An upper end alone": replaced("$v0 >= 0, ", ""),
    "A lower end alone": replaced(", $v0 <= 85000", ""),
    "Ends in another order": replaced(WIDTH, "$v0 <= 85000, $v0 >= 0"),
    "A strict upper end": replaced("$v0 <= 85000", "$v0 < 85000"),
    "A strict lower end": replaced("$v0 >= 0", "$v0 > 0"),
    "Sides exchanged": replaced("$v0 >= 0", "0 <= $v0"),
    "Arithmetic": replaced("$v0 >= 0", "$v0 + 1 >= 0"),
    "Brackets": replaced("$v0 >= 0", "($v0) >= 0"),
    "A negation": replaced("$v0 >= 0", "!($v0 < 0)"),
    "A range of two parameters": replaced("$v0 <= 85000", "$v1 <= 85000"),
    "A range against a parameter": replaced("$v0 <= 85000", "$v0 <= $v1"),
    "A range against a text": replaced("$v0 <= 85000", '$v0 <= "a"'),
    "A range of a constant": replaced(WIDTH, "5 >= 0, 5 <= 85000"),
    "A range against a date": replaced("$v0 <= 85000", "$v0 <= 2027-01-15T08:00:00Z"),
    "A limit twice": replaced(WIDTH, f"{WIDTH}, {WIDTH}"),
    "A range and a set": replaced(FORCE, f"$v1 >= 10, $v1 <= 40, {FORCE}"),
    "Limits in another order": replaced(f"{WIDTH}, {FORCE}", f"{FORCE}, {WIDTH}"),
    "Another name for a parameter": replaced(f"{HEAD}, {WIDTH}", HEAD.replace("$v0", "$w") + ", $w >= 0, $w <= 85000"),
    "Parameters exchanged": replaced(
        f"{HEAD}, {WIDTH}, {FORCE}",
        'req("ur3e", "gripper_move", $v1, $v0), $v1 >= 0, $v1 <= 85000, {10, 20}.contains($v0)',
    ),
    "A number left out": replaced(
        f"{HEAD}, {WIDTH}, {FORCE}",
        'req("ur3e", "gripper_move", $v0, $v2), $v0 >= 0, $v0 <= 85000, {10, 20}.contains($v2)',
    ),
    "One variable twice": replaced(f"{HEAD}, {WIDTH}, {FORCE}", f'req("ur3e", "gripper_move", $v0, $v0), {WIDTH}'),
    "A constant parameter": replaced(f"{HEAD}, {WIDTH}", 'req("ur3e", "gripper_move", 5, $v1)'),
    "A list for a set": replaced(FORCE, "[10, 20, 40].contains($v1)"),
    "A set of texts": replaced(FORCE, '{"a", "b"}.contains($v1)'),
    "An empty set": replaced(FORCE, "{,}.contains($v1)"),
    "A set for another parameter besides": replaced(FORCE, f"{FORCE}, {{10}}.contains($v0)"),
    "A demand of no parameter": replaced(FORCE, f"{FORCE}, $v2 >= 0, $v2 <= 1"),
    "A condition without parameter": replaced(FORCE, f"{FORCE}, true"),
    "A second fact in an alternative": replaced(HEAD, f"{HEAD}, hop($a, $b, $c, $d, $e, $f)"),
    "The context in an alternative": replaced(HEAD, f"{HEAD}, {CONTEXT}"),
    "No operation": replaced(f"{HEAD}, {WIDTH}, {FORCE}", 'req("ur3e")'),
    "An operation that is bytes": replaced('"gripper_move"', "hex:00"),
    "An object that is a number": replaced('"ur3e", "gripper_move"', '5, "gripper_move"'),
    "Any operation": replaced('"gripper_move"', "$op"),
    "Any object": replaced('"ur3e", "gripper_move"', '$o, "gripper_move"'),
    "Another predicate for the request": replaced("req(", "request("),
    "An alternative over the context": replaced("check if req(", f"check if {CONTEXT} or req("),
    "An alternative that is always true": replaced("check if req(", "check if true or req("),
    "A check over nothing": replaced(f"check if {CONTEXT}, {START}, {END}, {CEILING}", "check if true"),
    "Terms of the context exchanged": replaced(CONTEXT, "req_ctx($tier, $time)"),
    "A term of the context more": replaced(CONTEXT, "req_ctx($time, $tier, $place)"),
    "A term of the context less": replaced(f"{CONTEXT}, {START}, {END}, {CEILING}", f"req_ctx($time), {START}, {END}"),
    "A constant in the context": replaced(
        f"{CONTEXT}, {START}, {END}, {CEILING}", f"req_ctx($time, 1), {START}, {END}"
    ),
    "Another predicate for the context": replaced("req_ctx(", "context("),
    "Conditions of the context in another order": replaced(f"{START}, {END}", f"{END}, {START}"),
    "The ceiling first": replaced(f"{START}, {END}, {CEILING}", f"{CEILING}, {START}, {END}"),
    "A ceiling twice": replaced(CEILING, f"{CEILING}, $tier <= 4"),
    "A start twice": replaced(START, f"{START}, {START}"),
    "An inclusive end": replaced(END, END.replace("<", "<=")),
    "An exclusive start": replaced(START, START.replace(">=", ">")),
    "A strict ceiling": replaced(CEILING, "$tier < 4"),
    "A least tier": replaced(CEILING, "$tier >= 1"),
    "A ceiling on the time": replaced(CEILING, "$time <= 3"),
    "A window of dates": replaced(START, "$time >= 2027-01-15T08:00:00Z"),
    "Two alternatives of the context": replaced(CEILING, f"{CEILING} or {CONTEXT}, $tier <= 4"),
    "A context that demands nothing": replaced(f"{CONTEXT}, {START}, {END}, {CEILING}", CONTEXT),
}
OTHER_VERSION = frozenset({"A check all for the request", "A scope"})
"""Those of a version of Datalog that no block has; the others are of that of functions."""
LATER: dict[str, Texts] = {
    "An equation": replaced("$v0 >= 0", "$v0 == 0"),
    "Two conditions in one": replaced(WIDTH, "$v0 >= 0 && $v0 <= 85000"),
    "A reject for the request": replaced("check if req(", "reject if req("),
    "A check all for the request": replaced("check if req(", "check all req("),
    "A condition on the type of a tier": replaced(CEILING, f'{CEILING}, $tier.type() == "integer"'),
    "A set in a comparison": replaced(FORCE, "$v1.intersection({10}) == {10}"),
    "A scope": replaced(CEILING, f"{CEILING} trusting previous"),
}


def in_check(position: int, change) -> Sealed:
    """A token whose check at this position has other bytes."""

    def rewrite(fields):
        checks = [i for i, (number, _) in enumerate(fields) if number == 6]
        at = checks[position]
        return [(n, put(6, change(inner(raw))) if i == at else raw) for i, (n, raw) in enumerate(fields)]

    return authority(ONE, payload=message(rewrite))


def in_query(change):
    """A check whose first query has other bytes."""

    def rewrite(check: bytes) -> bytes:
        (_, first), *rest = cut(check)
        return put(1, change(inner(first))) + b"".join(raw for _, raw in rest)

    return rewrite


def more(extra: bytes):
    return lambda found: found + extra


def deep(raw: bytes, path: list[int], change) -> bytes:
    """The message with the last field of each number on this path changed, lengths and all."""
    if not path:
        return change(raw)
    fields = cut(raw)
    at = max(i for i, (number, _) in enumerate(fields) if number == path[0])
    changed = put(path[0], deep(inner(fields[at][1]), path[1:], change))
    return b"".join(changed if i == at else each for i, (_, each) in enumerate(fields))


def first_longer(found: bytes) -> bytes:
    """The length of the first field in a byte more than it needs."""
    (_, first), *rest = cut(found)
    body = inner(first)
    return first[:1] + varint(len(body), pad=1) + body + b"".join(raw for _, raw in rest)


def unsorted(check: bytes) -> bytes:
    """The set's members in another order."""
    members = [put(1, put(2, number)) for number in (10, 20, 40)]
    assert b"".join(members) in check
    return check.replace(b"".join(members), b"".join(members[::-1]))


def doubled(check: bytes) -> bytes:
    """A member of the set twice, for another one."""
    members = [put(1, put(2, number)) for number in (10, 20, 40)]
    return check.replace(b"".join(members), members[0] + members[0] + members[2])


CHECKS = group(
    "checks",
    "Checks of a trusted signer that Biscuit evaluates and the profile has not.",
    faults(
        FaultCode.CHAIN_BROKEN,
        "TOK-6",
        {title: lambda change=change: authority(ONE, texts=change) for title, change in BROKEN.items()},
    ),
    [
        case
        for title, change in LATER.items()
        for case in faults(
            FaultCode.WRONG_PROFILE if title in OTHER_VERSION else FaultCode.CHAIN_BROKEN,
            "TOK-6",
            {title: lambda change=change: authority(ONE, texts=change)},
        )
    ],
    faults(
        FaultCode.CHAIN_BROKEN,
        "TOK-6",
        {
            "A kind that says check if": lambda: in_check(0, more(put(2, 0))),
            "An unknown field in a check": lambda: in_check(0, more(put(9, 1))),
            "An unknown field in a query": lambda: in_check(0, in_query(more(put(9, 1)))),
            "A longer length in a check": lambda: in_check(1, first_longer),
            "A longer length in a query": lambda: in_check(1, in_query(first_longer)),
            "A function of the host beside an operation": lambda: in_check(
                1, lambda check: deep(check, [1, 3, 1, 3], more(put(2, 1024)))
            ),
            "An unknown field in a condition": lambda: in_check(1, lambda check: deep(check, [1, 3], more(put(9, 1)))),
            "An unknown field in a term": lambda: in_check(1, lambda check: deep(check, [1, 2, 2], more(put(15, 1)))),
            "A longer number in an operation": lambda: in_check(
                1, lambda check: deep(check, [1, 3, 1, 3], lambda found: found[:1] + varint(found[1], pad=1))
            ),
            "A set out of order": lambda: in_check(0, unsorted),
            "A member of a set twice": lambda: in_check(0, doubled),
            "A query with another head": lambda: in_check(
                1, lambda check: check.replace(b"\x0a\x02\x08\x1b", b"\x0a\x02\x08\x1a")
            ),
            "A text that the block does not have": lambda: in_check(
                1, lambda check: check.replace(varint(1024 + 7), varint(1024 + 99))
            ),
            "No query": lambda: in_check(1, lambda _: b""),
        },
    ),
    faults(
        FaultCode.CHAIN_BROKEN,
        "TOK-6",
        {
            "A hop with an upper end alone": lambda: hop(authority(), SLOWER, texts=replaced("$v2 >= 1, ", "")),
            "A hop that exchanges the ends": lambda: hop(
                authority(), SLOWER, texts=replaced("$v2 >= 1, $v2 <= 500000", "$v2 <= 500000, $v2 >= 1")
            ),
            "A hop with a strict ceiling": lambda: hop(
                authority(SMALL), LESS, parent=SMALL, texts=replaced("$tier <= 0", "$tier < 1")
            ),
            "A hop with a context that demands nothing": lambda: hop(
                authority(SMALL), LESS, parent=SMALL, texts=replaced(", $tier <= 0", "")
            ),
            "A hop with a scope": lambda: hop(
                authority(SMALL), LESS, parent=SMALL, texts=replaced("$tier <= 0", "$tier <= 0 trusting previous")
            ),
            "A hop with a check all": lambda: hop(
                authority(SMALL), LESS, parent=SMALL, texts=replaced("check if req_ctx", "check all req_ctx")
            ),
            "A hop with an operation on bits": lambda: hop(
                authority(SMALL), LESS, parent=SMALL, texts=replaced("$tier <= 0", "$tier & 7 <= 0")
            ),
            "A hop with an inequation": lambda: hop(
                authority(SMALL), LESS, parent=SMALL, texts=replaced("$tier <= 0", "$tier !== 3")
            ),
            "A hop with the context before the request": lambda: hop(
                authority(), SLOWER, texts=lambda found: found[::-1]
            ),
        },
    ),
)

GROUPS: tuple[Group, ...] = (CHECKS,)
