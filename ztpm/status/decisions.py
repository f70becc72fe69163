"""The newest decisions and the open questions of a PEP, followed through its journal as it grows."""

from __future__ import annotations

import json
from collections import OrderedDict, deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from policies.evidence.model import ObligationKind

if TYPE_CHECKING:
    from pathlib import Path

KEPT: Final = 20
"""Newest decisions that are kept."""
OPEN_KEPT: Final = 256
"""Open questions that are kept; the oldest is forgotten first."""
FIRST_BYTES: Final = 4_194_304
"""Part of an old journal that is read at first: some hundred decisions with their evidence."""
READ_BYTES: Final = 4_194_304
"""Part that is read at once afterwards."""

OWED: Final = frozenset({ObligationKind.NOTIFY, ObligationKind.REATTEST, ObligationKind.LOWER_TRUST})
"""Obligations that other parts than the enforcement point fulfil; their words stand in `texts.toml`."""


@dataclass(frozen=True, slots=True)
class Decided:
    """One decision, refusal or stop as it is on record.

    Attributes:
        at_ms: wall clock, milliseconds since the epoch.
        request_id: of a decision; "" for a refusal before there was a request.
        agent: leaf of the verified chain, or "".
        operation: the asked operation, as far as it is known.
        effect, reason: PERMIT, DENY or DEFER, and why.
        tier: or None.
        outcome: outcome of a PERMIT: "done", "failed", "refused", "cancelled", "unknown"; "" when there is none yet.
        owed: duties of people or the identity provider because of it, each of `OWED`.
    """

    at_ms: int
    request_id: str
    agent: str
    operation: str
    effect: str
    reason: str
    tier: int | None
    outcome: str = ""
    owed: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class OpenAsk:
    """A deferral that waits for people.

    Attributes:
        ask_id: its id.
        agent, operation, reason, tier: of the decision that deferred.
        expires_at_ms: time of denial by silence, milliseconds since the epoch.
    """

    ask_id: str
    agent: str
    operation: str
    reason: str
    tier: int | None
    expires_at_ms: int


class Decisions:
    """Follower of one journal, which it reads and never locks or changes; an unknown record is passed over.

    Args:
        path: of the journal.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._at: int | None = None
        self._newest: deque[Decided] = deque(maxlen=KEPT)
        self._asks: OrderedDict[str, OpenAsk] = OrderedDict()

    def newest(self) -> tuple[Decided, ...]:
        """The newest decisions, newest first."""
        return tuple(reversed(self._newest))

    def open_asks(self, *, at_ms: int) -> tuple[OpenAsk, ...]:
        """The questions that are still open, oldest first.

        Args:
            at_ms: wall clock now, milliseconds since the epoch.
        """
        return tuple(ask for ask in self._asks.values() if at_ms < ask.expires_at_ms)

    def follow(self) -> None:
        """Takes in the records appended since the last call.

        Raises:
            OSError: when the journal cannot be read.
        """
        with self._path.open("rb") as file:
            size = file.seek(0, 2)
            if self._at is None:
                self._at = max(0, size - FIRST_BYTES)
                file.seek(self._at)
                if self._at:  # in the middle of a line
                    self._at += len(file.readline())
            while self._at < size:
                file.seek(self._at)
                chunk = file.read(READ_BYTES)
                whole = chunk.rfind(b"\n") + 1
                if not whole:
                    if len(chunk) < READ_BYTES:
                        return  # a line that is being written
                    whole = len(chunk)  # no record is as long as this
                for line in chunk[:whole].splitlines():
                    self._take(line)
                self._at += whole

    def _take(self, line: bytes) -> None:
        try:
            record: Any = json.loads(line)
            kind, body, at_ms = record["kind"], record["body"], int(record["at_ms"])
            match kind:
                case "decision":
                    self._decision(body, at_ms)
                case "refusal":
                    self._newest.append(_refusal(body, at_ms))
                case "outcome":
                    self._outcome(body, at_ms)
                case "ask-answered" | "ask-expired" | "ask-refused":
                    self._asks.pop(str(body["ask_id"]), None)
                case _:
                    pass
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return

    def _decision(self, body: dict[str, Any], at_ms: int) -> None:
        decision, request = body["decision"], body["request"]
        decided = Decided(
            at_ms=at_ms,
            request_id=str(request["id"]),
            agent=_agent(body.get("evidence")),
            operation=str(request["operation"]),
            effect=str(decision["effect"]),
            reason=str(decision["reason"]),
            tier=decision.get("tier"),
            owed=tuple(kind for kind in map(str, decision.get("obligations", ())) if kind in OWED),
        )
        self._newest.append(decided)
        ask = body.get("ask")
        if isinstance(ask, dict) and decided.effect == "DEFER":
            ask_id = str(ask["ask_id"])
            self._asks[ask_id] = OpenAsk(
                ask_id, decided.agent, decided.operation, decided.reason, decided.tier, int(ask["expires_at_ms"])
            )
            while len(self._asks) > OPEN_KEPT:
                self._asks.popitem(last=False)

    def _outcome(self, body: dict[str, Any], at_ms: int) -> None:
        outcome = str(body["outcome"])
        if body["request_id"] == "stop":
            stop = body.get("stop") or {}
            caller = stop.get("caller")
            agent = "" if caller is None else str(caller)
            operation = str(stop.get("operation", "stop"))
            self._newest.append(Decided(at_ms, "stop", agent, operation, "PERMIT", "PERMITTED", 0, outcome))
            return
        for place, decided in enumerate(self._newest):
            if decided.request_id == body["request_id"] and decided.effect == "PERMIT":
                self._newest[place] = replace(decided, outcome=outcome)


def _refusal(body: dict[str, Any], at_ms: int) -> Decided:
    where = body.get("where") or {}
    operation = str(where.get("tool") or where.get("path") or "")
    return Decided(at_ms, "", _agent(body.get("evidence")), operation, str(body["effect"]), str(body["reason"]), None)


def _agent(evidence: Any) -> str:
    """The leaf of the chain in a record's evidence, or ""."""
    chain = evidence.get("chain") if isinstance(evidence, dict) else None
    hops = chain.get("hops") if isinstance(chain, dict) else None
    return str(hops[-1]["agent"]) if hops else ""
