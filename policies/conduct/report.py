"""Report of one enforcement point about one concluded request; trust and behaviour are made of nothing else.

The shell around it checks the signature and that `reporter` is the enforcement point whose key signed. A `Report` that
exists is in bounds, so the reducers (policies.conduct.trust, policies.conduct.behaviour) take any of them, in any
order, any number of times.

**The agent of a report.** `agent` is the one that *acted*: the holder whose proof of possession was verified (e4, e5),
the sender of a message (e2), the holder that asked for a delegation and was refused (the identity provider is a
reporter too). Where no agent was proven to have acted, there is no report.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from policies.words.canonical import EXACT

if TYPE_CHECKING:
    from collections.abc import Mapping

EFFECTS: Final = frozenset({"PERMIT", "DENY", "DEFER"})
OUTCOMES: Final = frozenset({"done", "failed", "refused", "none"})
"""Outcomes of a PERMIT: the act happened as decided; it did not; nothing was sent. "none" for every other effect."""
TEXT_MAX: Final = 256
"""Characters of any name in a report: capabilities.values.caps text_bytes."""
PARTIES_MAX: Final = 10
"""Sponsor, first holder, and as many hops as capabilities.values.caps allows."""
VALUES_MAX: Final = 64
"""Values of one request: an operation has at most 32 parameters (capabilities.values.caps), some given per axis."""


class ReportError(ValueError):
    """A report or stored state that is malformed. `where` names the field."""

    def __init__(self, where: str) -> None:
        super().__init__(f"{where} is not what it has to be")
        self.where = where


class Edge(NamedTuple):
    """One party's trust in one other; it belongs to this pair and to no other."""

    delegator: str
    delegate: str


@dataclass(frozen=True, slots=True)
class Report:
    """One concluded request, as its enforcement point saw it. Making one checks every bound.

    Attributes:
        reporter: id of the enforcement point.
        request_id: unique for this reporter; the same in every retransmission.
        agent: who acted.
        delegators: the chain's parties: the sponsor first, then each hop's agent, `agent` last; nobody twice.
        at: when it was concluded, seconds since the epoch, by the reporter's clock.
        operation: e.g. "move_joint".
        base_tier, runtime_tier: 0 to 4, or None when not known.
        effect: "PERMIT", "DENY" or "DEFER".
        reason: the code that leads the decision, or the code of the outcome when that is not "done".
        outcome: one of `OUTCOMES`.
        values: (name, integer) of every parameter, in the operation's order.
        near_permille: how close the closest parameter, or its physics, is to its limit: 0 far, 1000 at the bound;
            None when it has none or it was not worked out.

    Raises:
        ReportError: a field is out of bounds.
    """

    reporter: str
    request_id: str
    agent: str
    delegators: tuple[str, ...]
    at: int
    operation: str
    base_tier: int | None
    runtime_tier: int | None
    effect: str
    reason: str
    outcome: str
    values: tuple[tuple[str, int], ...]
    near_permille: int | None

    def __post_init__(self) -> None:
        for name in ("reporter", "request_id", "agent", "operation", "reason"):
            _require(is_text(getattr(self, name)), name)
        parties = self.delegators
        _require(2 <= len(parties) <= PARTIES_MAX, "delegators")
        _require(all(is_text(party) for party in parties) and len(set(parties)) == len(parties), "delegators")
        _require(parties[-1] == self.agent, "delegators")
        _require(is_count(self.at, EXACT), "at")
        for name in ("base_tier", "runtime_tier"):
            tier = getattr(self, name)
            _require(tier is None or is_count(tier, 4), name)
        _require(is_text(self.effect) and self.effect in EFFECTS, "effect")
        _require(is_text(self.outcome) and self.outcome in OUTCOMES, "outcome")
        _require(self.outcome == "none" or self.effect == "PERMIT", "outcome")
        _require(len(self.values) <= VALUES_MAX, "values")
        _require(all(is_text(name) and is_whole(value) for name, value in self.values), "values")
        _require(self.near_permille is None or is_count(self.near_permille, 1000), "near_permille")

    @property
    def edge(self) -> Edge:
        """Edge into the agent that acted: the only subject of this report (policies.conduct.trust says why)."""
        return Edge(self.delegators[-2], self.delegators[-1])

    @property
    def tier(self) -> int | None:
        """The runtime tier where it is known, else the registered one."""
        return self.base_tier if self.runtime_tier is None else self.runtime_tier

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of the report: texts, integers, lists."""
        return {
            "reporter": self.reporter,
            "request_id": self.request_id,
            "agent": self.agent,
            "delegators": list(self.delegators),
            "at": self.at,
            "operation": self.operation,
            "base_tier": self.base_tier,
            "runtime_tier": self.runtime_tier,
            "effect": self.effect,
            "reason": self.reason,
            "outcome": self.outcome,
            "values": [list(entry) for entry in self.values],
            "near_permille": self.near_permille,
        }

    @classmethod
    def from_json(cls, body: object) -> Report:
        """The report that `to_json` wrote.

        Raises:
            ReportError: a key is missing, unknown, of another type or out of bounds.
        """
        fields = keyed(body, set(cls.__slots__), "report")
        parties, values = listed(fields["delegators"], "delegators"), listed(fields["values"], "values")
        pairs = tuple(tuple(listed(entry, "values")) for entry in values)
        if not all(len(pair) == 2 for pair in pairs):
            raise ReportError("values")
        return cls(**{**fields, "delegators": tuple(parties), "values": pairs})


def is_text(value: object) -> bool:
    """True where the value is a name: 1 to `TEXT_MAX` characters that UTF-8 can write."""
    if type(value) is not str or not 1 <= len(value) <= TEXT_MAX:
        return False
    return value.isascii() or not any("\ud800" <= letter <= "\udfff" for letter in value)


def is_count(value: object, high: int) -> bool:
    """True where the value is an integer (no bool) from 0 to `high`."""
    return type(value) is int and 0 <= value <= high


def is_whole(value: object) -> bool:
    """True where the value is an integer (no bool) that every JSON reader keeps."""
    return type(value) is int and -EXACT <= value <= EXACT


def keyed(body: object, keys: set[str], where: str) -> Mapping[str, Any]:
    """`body` when it is an object with exactly these keys.

    Raises:
        ReportError: it is not.
    """
    if type(body) is not dict or set(body) != keys:
        raise ReportError(where)
    return body


def listed(body: object, where: str) -> list[Any]:
    """`body` when it is a list.

    Raises:
        ReportError: it is not.
    """
    if type(body) is not list:
        raise ReportError(where)
    return body


def _require(holds: bool, where: str) -> None:  # noqa: FBT001 - an assertion with a name
    if not holds:
        raise ReportError(where)
