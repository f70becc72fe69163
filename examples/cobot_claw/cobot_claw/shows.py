"""Five requests and one beyond the loan, each watched in the spans, on the arm and on record."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from cobot_claw.roles import ROLES

if TYPE_CHECKING:
    from collections.abc import Callable

    from cobot_claw.system import System, Told

STILL_RAD: Final = 1e-3


@dataclass(frozen=True, slots=True)
class Show:
    """One request, and what is to be seen of it.

    Attributes:
        request: in natural language.
        agents: that take part, beside the orchestrator.
        says: a part of the answer.
        moves_rad: least and greatest way of the arm's leading joint meanwhile, rad.
        done: whether it is carried out.
        seen: whether the world is as it must be afterwards.
    """

    request: str
    agents: frozenset[str]
    says: str = field(kw_only=True)
    moves_rad: tuple[float, float] = field(default=(0.0, STILL_RAD), kw_only=True)
    done: bool = field(default=True, kw_only=True)
    seen: Callable[[System], bool] = field(default=lambda _: True, kw_only=True)


@dataclass(frozen=True, slots=True)
class Shown:
    """Observations of a request: the answer, its spans, and each expectation that was not met."""

    told: Told
    spans: list[dict[str, Any]]
    records: int
    faults: tuple[str, ...]


def _payload(system: System) -> float:
    profile = json.loads((system.folder / "point" / "profile.json").read_text("utf-8"))
    return float(profile["payload_kg"])


SHOWS: Final = (
    Show("What do you see?", frozenset({"vision"}), says="part-1 at -0.3, -0.05"),
    Show(
        "Hand me the part",
        frozenset({"vision", "robotic"}),
        moves_rad=(0.5, 2.0),
        says="handed over",
        seen=lambda system: system.table is not None and system.table.handed == ["part-1"],
    ),
    Show("Set the payload to 0.5 kg", frozenset({"config"}), says="0.5", seen=lambda system: _payload(system) == 0.5),
    Show("How should I grip a glass?", frozenset(), says="20 N"),
    Show("Run the greeting scenario", frozenset({"robotic"}), moves_rad=(0.3, 2.0), says="over"),
    Show("Move to left at 0.9 rad/s", frozenset({"robotic"}), done=False, says="LIMIT_EXCEEDED_BY_REQUEST"),
)


def show(system: System, one: Show) -> Shown:
    """Observations of a request.

    Args:
        system: running, with a person who approves.
        one: the request.
    """
    told = system.ask(one.request)
    spans = system.spans(told.trace)
    services, ids = {str(each["service"]) for each in spans}, {each["span"] for each in spans}
    records = sum(1 for row in system.stage.journal(since=0) if row["body"].get("trace_id") == told.trace)
    low, high = one.moves_rad
    ours = {"person", "point", *ROLES}
    loose = [each["name"] for each in spans if each["service"] in ours and each["parent"] not in {None, *ids}]
    expected = {
        f"done is {told.done}": told.done is one.done,
        f"it says {told.text!r}": one.says in told.text,
        f"the arm moved {told.moved_rad:.3f} rad": low <= told.moved_rad <= high,
        f"spans of {sorted(services)} alone": one.agents | {"person", "orchestrator", "point"} <= services,
        f"spans without their parent: {loose}": not loose,
        "the world is not as it must be": one.seen(system),
        "no record of the cell names the trace": records > 0 or "robotic" not in one.agents,
    }
    return Shown(told, spans, records, tuple(fault for fault, met in expected.items() if not met))
