"""Loader from strict TOML to a policy set: an unknown, missing or bad member is refused with code and place.

A set that loads can decide. Nothing is filled in silently but the parameters' defaults, and those are printed by `ztpm
policy check`. A set that extends another one states what differs (policies.decision.extend).
"""

from __future__ import annotations

import tomllib
from importlib import resources
from typing import TYPE_CHECKING, Final

from policies.decision.extend import EXTENDING, Written, extended, floor_of
from policies.decision.policy import PolicySet
from policies.decision.policy_text import LATCH, latch_of, parameters_of, policy_of
from policies.decision.table import NAME_LIMIT, Table, table_of
from policies.words.errors import PolicyError, PolicyFault

if TYPE_CHECKING:
    from collections.abc import Callable

    # Text of a set that another one extends, and its place, of its name and the place of the other.
    Reader = Callable[[str, str], tuple[str, str]]

FORMAT: Final = 1
"""The form of the text that is read here; a text that states none is of this form."""
TEXT_LIMIT: Final = 262_144
"""Most characters of a policy set: a person could still read them."""
BASES_LIMIT: Final = 8
"""Most sets that one extends, one through the other; ours: a person could still follow them."""
SHIPPED: Final = ("paper-default", "strict", "tools")
"""The sets that come with the package."""


def load_shipped(name: str) -> PolicySet:
    """The shipped set of that name.

    Raises:
        PolicyError: `UNKNOWN_SET` when no such set is shipped.
    """
    if name not in SHIPPED:
        raise PolicyError(PolicyFault.UNKNOWN_SET, "name")
    return load(_shipped(name))


def load(text: str, *, place: str = "", read: Reader | None = None) -> PolicySet:
    """The policy set that `text` states.

    Args:
        text: TOML; `policies/sets/paper-default.toml` shows every key.
        place: of the text, as `read` names places; "" where it has none.
        read: gives text and place of a set that is extended and not shipped, of its name and the place of the set that
            names it; it raises `OSError` or `UnicodeDecodeError`. None: only shipped sets can be extended.

    Raises:
        PolicyError: with the fault and the place in the text.
    """
    return _load(text, place, read, within=())[0]


def _load(text: str, place: str, read: Reader | None, *, within: tuple[str, ...]) -> tuple[PolicySet, Written]:
    if not isinstance(text, str):
        raise PolicyError(PolicyFault.WRONG_TYPE, "text")
    if len(text) > TEXT_LIMIT:
        raise PolicyError(PolicyFault.TOO_LARGE, "text", f"over {TEXT_LIMIT} characters")
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise PolicyError(PolicyFault.NOT_TOML, "text", str(error)[:NAME_LIMIT]) from error
    top = Table(document, "")
    extends = "extends" in document
    if extends:
        top.expect("name", "version", "extends", optional=("format", "parameters", *LATCH, *EXTENDING))
    else:
        top.expect("name", "version", "policy", optional=("format", "parameters", *LATCH))
    if "format" in document and top.integer("format", 0, 2**31 - 1) != FORMAT:
        raise PolicyError(PolicyFault.UNKNOWN_FORMAT, "format", f"this version reads {FORMAT}")
    numbers = top.table("parameters") if "parameters" in document else Table({}, "parameters")
    parameters_of(numbers)  # a number that is out of its range is this text's, not one of what it extends
    base = _base(top, place, read, within=within) if extends else None
    if base is None:
        stated = Written(numbers, tuple(table_of(each, f"policy[{i}]") for i, each in enumerate(top.list("policy"))))
    else:
        stated = extended(base[1], top, numbers)
    parameters = parameters_of(stated.parameters)
    policies = tuple(policy_of(table, parameters) for table in stated.policies)
    name, version = top.text("name"), top.integer("version", 1, 2**31 - 1)
    floor = None if base is None else floor_of(*base, top, policies, parameters)
    latch = latch_of(top) | (frozenset() if base is None else base[0].latch)  # what a base latches stays latched
    return PolicySet(name, version, policies, parameters, floor, latch), stated


def _base(top: Table, place: str, read: Reader | None, *, within: tuple[str, ...]) -> tuple[PolicySet, Written]:
    """The set that the text extends, and what is written in it.

    Raises:
        PolicyError: also `UNKNOWN_BASE` and `BASE_CYCLE`; the place of a fault in the base begins with `extends`.
    """
    name = top.text("extends")
    above = (*within, place)
    if len(above) > BASES_LIMIT:
        raise PolicyError(PolicyFault.TOO_DEEP, "extends", f"over {BASES_LIMIT} sets")
    if name in SHIPPED:
        return _load(_shipped(name), "", None, within=above)
    shipped = ", ".join(SHIPPED)
    if read is None or not name.endswith(".toml"):
        raise PolicyError(PolicyFault.UNKNOWN_BASE, "extends", f"neither a shipped set ({shipped}) nor a .toml file")
    try:
        text, found = read(name, place)
    except (OSError, UnicodeDecodeError) as error:
        raise PolicyError(PolicyFault.UNKNOWN_BASE, "extends", f"{name}: {type(error).__name__}") from error
    if found in above:
        raise PolicyError(PolicyFault.BASE_CYCLE, "extends", f"{name} extends this set itself")
    try:
        return _load(text, found, read, within=above)
    except PolicyError as error:
        raise PolicyError(error.code, f"extends({name}).{error.where}", error.detail) from error


def _shipped(name: str) -> str:
    return resources.files("policies").joinpath("sets", f"{name}.toml").read_text(encoding="utf-8")
