"""Deferrals, answers and uses as the journal of an earlier process tells them. Pure."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from capabilities.statements.people import ask as ask_statement
from capabilities.values.errors import StatementError
from pep.people.deferral import AskState

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from capabilities.values.caps import Caps


@dataclass(slots=True)
class RecoveredAsk:
    """A deferral as the journal left it, with the request of each use that it consumed."""

    question: ask_statement.Ask
    text: str
    reason: str
    expires_at: float
    state: AskState = AskState.OPEN
    not_after: int = 0
    used: dict[int, str] = field(default_factory=dict)
    trace_id: str = ""


@dataclass(frozen=True, slots=True)
class RecoveredState:
    """All of them, oldest first.

    Attributes:
        asks: those that are open or answered.
        opening_uses: (opening id, request id) of every act that rested on an opening.
        envelope_uses: (envelope id, use, request id) of every act inside an envelope.
        high_s: the latest wall time in the journal, seconds since the epoch.
    """

    asks: tuple[RecoveredAsk, ...]
    opening_uses: frozenset[tuple[str, str]]
    envelope_uses: frozenset[tuple[str, int, str]]
    high_s: float


def reopen(records: Iterable[Mapping[str, Any]], keys: Collection[bytes], caps: Caps) -> RecoveredState:
    """State of the deferrals that an earlier process left.

    A use counts as consumed from the record of its PERMIT on, unless the outcome says that it was returned: that
    nothing was sent, and nothing could be any more.

    Args:
        records: of the whole journal, oldest first.
        keys: this PEP's; an ask that no such key signed is no question of ours.
        caps: bounds on statements.
    """
    asks: dict[str, RecoveredAsk] = {}
    over: set[str] = set()
    inside: dict[tuple[str, int], str] = {}
    high_ms = 0
    for record in records:
        body = record["body"]
        high_ms = max(high_ms, record["at_ms"])
        match record["kind"]:
            case "ask":
                try:
                    question = ask_statement.open(body["ask"], keys, caps)
                except StatementError:
                    continue
                asks[question.ask_id] = RecoveredAsk(
                    question, body["ask"], body["reason"], body["expires_at_ms"] / 1000
                )
                asks[question.ask_id].trace_id = body.get("trace_id", "")
            case "ask-answered" if body["ask_id"] in asks:
                asks[body["ask_id"]].state = AskState(body["state"])
                asks[body["ask_id"]].not_after = body["not_after"]
            case "ask-expired" | "ask-refused":
                over.add(body["ask_id"])
            case "decision" if (use := body.get("approval")) is not None and use["ask_id"] in asks:
                # only a PERMIT names one
                asks[use["ask_id"]].used[use["use"]] = body["request"]["id"]
            case "outcome" if (use := body.get("returned")) is not None and use["ask_id"] in asks:
                used = asks[use["ask_id"]].used
                if used.get(use["use"]) == body["request_id"]:
                    del used[use["use"]]
            case "decision" if (use := body.get("approval")) is not None:
                # of no ask, so of an envelope
                inside[use["ask_id"], use["use"]] = body["request"]["id"]
            case "outcome" if (use := body.get("returned")) is not None:
                if inside.get((use["ask_id"], use["use"])) == body["request_id"]:
                    del inside[use["ask_id"], use["use"]]
            case _:
                pass
    uses = {(left.question.opening_id, request_id) for left in asks.values() for request_id in left.used.values()}
    return RecoveredState(
        asks=tuple(left for ask_id, left in asks.items() if ask_id not in over),
        opening_uses=frozenset((opening_id, request_id) for opening_id, request_id in uses if opening_id),
        envelope_uses=frozenset((id_, use, request_id) for (id_, use), request_id in inside.items()),
        high_s=high_ms / 1000,
    )
