"""Faults of a policy or a policy set.

Each is found when the set is made, never when it decides.
"""

from __future__ import annotations

from enum import StrEnum


class PolicyFault(StrEnum):
    """Codes of `PolicyError`."""

    TOO_LARGE = "TOO_LARGE"
    NOT_TOML = "NOT_TOML"
    UNKNOWN_FORMAT = "UNKNOWN_FORMAT"
    """The text is of a form that this version does not read."""
    TOO_DEEP = "TOO_DEEP"
    UNKNOWN_SET = "UNKNOWN_SET"
    UNKNOWN_KEY = "UNKNOWN_KEY"
    MISSING_KEY = "MISSING_KEY"
    WRONG_TYPE = "WRONG_TYPE"
    NOT_FINITE = "NOT_FINITE"
    OUT_OF_RANGE = "OUT_OF_RANGE"
    UNKNOWN_VALUE = "UNKNOWN_VALUE"
    NAME_MALFORMED = "NAME_MALFORMED"
    """The registry takes no such name, so the policy would never speak of it."""
    EMPTY = "EMPTY"
    DUPLICATE_ID = "DUPLICATE_ID"
    DUPLICATE_VALUE = "DUPLICATE_VALUE"
    UNKNOWN_PRIMITIVE = "UNKNOWN_PRIMITIVE"
    WRONG_POINT = "WRONG_POINT"
    """The policy names a primitive at an enforcement point where that primitive has no evidence."""
    LOOSENS = "LOOSENS"
    """A failing check would make the answer milder: `not` in a PERMIT, a bare primitive in a DENY or DEFER."""
    NO_RECORD = "NO_RECORD"
    """A PERMIT without the obligation to record."""
    BOUND_WITHOUT_GATE = "BOUND_WITHOUT_GATE"
    """PITBound and TEA-4 come together or not at all."""
    UNKNOWN_BASE = "UNKNOWN_BASE"
    """The set that is extended is neither shipped nor a file that can be read."""
    BASE_CYCLE = "BASE_CYCLE"
    """A set extends itself, maybe through others."""
    UNKNOWN_ID = "UNKNOWN_ID"
    """The set that is extended has no policy of that id."""
    LOSES_DENIAL = "LOSES_DENIAL"
    """A policy or number may deny less than in the extended set, and `loosens` does not say so."""
    LOOSENS_NOTHING = "LOOSENS_NOTHING"
    """`loosens` names what is as strict as in the extended set: it would hide a later change."""
    NOT_MONOTONE = "NOT_MONOTONE"
    """A higher tier would ask for less than a lower one."""


class PolicyError(Exception):
    """A policy that is refused.

    Attributes:
        code: the fault.
        where: place in the set, e.g. "policy[2].predicate.all[0]".
    """

    def __init__(self, code: PolicyFault, where: str, detail: str = "") -> None:
        super().__init__(f"{where}: {code}{': ' if detail else ''}{detail}")
        self.code = code
        self.where = where
        self.detail = detail
