"""Scripts that play the four models offline: what is asked and what tools answered decides the next step.

A script sees what a model sees: the text it was given, and the results of its calls so far. It holds no authority and
knows no answer beforehand.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pydantic_ai.messages import (
    ModelRequest,
    ModelResponse,
    TextPart,
    ToolCallPart,
    ToolReturnPart,
    UserPromptPart,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pydantic_ai.messages import ModelMessage
    from pydantic_ai.models.function import AgentInfo

POSES: Final = {
    "left": (-0.6, -1.62, 1.25, -1.2, -1.57, 0.0),
    "right": (0.6, -1.62, 1.25, -1.2, -1.57, 0.0),
    "front": (0.0, -1.62, 1.25, -1.2, -1.57, 0.0),
    "handover": (0.45, -1.62, 1.25, -1.2, -1.57, 0.0),
}
"""Named poses of the arm, rad."""
ABOVE_M: Final = 0.1
CLOSED_M: Final = 0.02
RETRIES: Final = 2
"""Tries more of a motion that ended early, as on a machine that is too loaded to watch it."""
ACCELERATION_RAD_S2: Final = 1.4
_SPEED: Final = re.compile(r"([\d.]+) ?rad/s")
_NUMBER: Final = r"(-?\d+(?:\.\d+)?)"


@dataclass(frozen=True, slots=True)
class Call:
    """The next call of a tool."""

    tool: str
    arguments: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Seen:
    """The result of one call: the tool, its answer, and whether it failed."""

    tool: str
    content: Any
    failed: bool

    @property
    def text(self) -> str:
        """The answer as a text."""
        return self.content if isinstance(self.content, str) else json.dumps(self.content)


Script = "Callable[[str, Sequence[Seen]], Call | str]"


def played(script: Callable[[str, Sequence[Seen]], Call | str]) -> Callable[..., ModelResponse]:
    """The script as the function of a `FunctionModel`."""

    def answer(messages: list[ModelMessage], _: AgentInfo) -> ModelResponse:
        parts = [part for message in messages if isinstance(message, ModelRequest) for part in message.parts]
        prompts = [str(part.content) for part in parts if isinstance(part, UserPromptPart)]
        seen = [
            Seen(part.tool_name, part.content, part.outcome != "success")
            for part in parts
            if isinstance(part, ToolReturnPart)
        ]
        step = script(prompts[-1] if prompts else "", seen)
        part = TextPart(step) if isinstance(step, str) else ToolCallPart(step.tool, dict(step.arguments))
        return ModelResponse(parts=[part])

    return answer


def _in_turn(calls: Sequence[Call], seen: Sequence[Seen]) -> Call | None:
    """The next of some calls, each after the one before; None when all are done."""
    return calls[len(seen)] if len(seen) < len(calls) else None


def _speed(text: str, usual: float) -> float:
    match = _SPEED.search(text)
    return float(match[1]) if match else usual


def orchestrator(text: str, seen: Sequence[Seen]) -> Call | str:
    """Plans: which agent is to do what, in which order; and says what came of it."""
    if seen and seen[-1].failed:
        return f"I could not do that. {seen[-1].text}"
    wanted = text.lower()
    if re.search(r"\b(remember|did you)\b", wanted):
        return _in_turn([Call("recall", {"name": "handed-over"})], seen) or f"I remember: {seen[-1].text}"
    if re.search(r"\b(hand|give|bring)\b.*\bpart\b", wanted):
        return _hand_over(seen)
    if re.search(r"\b(see|look|camera|where)\b", wanted):
        return _in_turn([Call("ask_vision", {"task": "Look at the table and tell what stands there."})], seen) or (
            f"The camera says: {seen[-1].text}"
        )
    if re.search(r"\b(payload|tool centre|limits?|profile)\b", wanted):
        return _in_turn([Call("ask_config", {"task": text})], seen) or seen[-1].text
    if re.search(r"\bscenario\b", wanted):
        return _scenario(wanted, seen)
    if re.search(r"\bhow\b", wanted):
        found = _in_turn([Call("search_handbook", {"query": text})], seen)
        return found or f"The handbook says: {_nearest(text, seen[-1].text)}"
    if re.search(r"\b(move|go|swing|turn)\b", wanted):
        pose = next((name for name in POSES if name in wanted), "front")
        task = f"Move to {pose} at {_speed(text, 0.5)} rad/s."
        return _in_turn([Call("ask_robotic", {"task": task})], seen) or seen[-1].text
    return "I can hand over a part, look, move the arm, change the profile, run a scenario, and search the handbook."


def _nearest(asked: str, found: str) -> str:
    """The text with most of the words that were asked for, of several with an empty line between them."""
    words = set(re.findall(r"\w{3,}", asked.lower()))
    return max(found.split("\n\n"), key=lambda text: len(words & set(re.findall(r"\w{3,}", text.lower()))))


def _hand_over(seen: Sequence[Seen]) -> Call | str:
    if not seen:
        return Call("ask_vision", {"task": "Find the part on the table and tell its position in metres."})
    if len(seen) == 1:
        place = re.search(rf"part-\d+ at {_NUMBER}, {_NUMBER}, {_NUMBER}", seen[0].text)
        if place is None:
            return f"There is no part to hand over. {seen[0].text}"
        where = f"{place[1]}, {place[2]}, {place[3]}"
        over = (
            f"Open the gripper, then go above {where} at 0.5 rad/s, then down to {where} at 0.1 rad/s, then close the "
        )
        over += f"gripper with 30 N, then go above {where} at 0.1 rad/s."
        return Call("ask_robotic", {"task": over})
    if len(seen) == 2 and "nothing is between" in seen[1].text:
        return f"I could not grip the part. {seen[1].text}"
    if len(seen) == 2:
        return Call("ask_robotic", {"task": "Move to handover at 0.4 rad/s, then open the gripper."})
    if len(seen) == 3:
        return Call("remember", {"name": "handed-over", "value": {"what": "part", "how": seen[1].text[:200]}})
    return f"The part is handed over. {seen[2].text}"


def _scenario(wanted: str, seen: Sequence[Seen]) -> Call | str:
    if not seen:
        return Call("search_scenarios", {"query": wanted})
    if len(seen) == 1:
        found = _nearest(wanted, seen[0].text)
        steps = re.findall(r"- (move to \w+ at [\d.]+ rad/s)", found, re.IGNORECASE)
        if not steps:
            return f"The library has no such scenario. {seen[0].text}"
        return Call("ask_robotic", {"task": "; then ".join(steps) + "."})
    return f"The scenario is over. {seen[-1].text}"


def _outcome(each: Seen) -> str | None:
    return each.content.get("outcome") if isinstance(each.content, dict) else None


def robotic(text: str, seen: Sequence[Seen]) -> Call | str:
    """Carries a task out step by step with the arm's tools, and stops at the first that does not happen."""
    if seen and seen[-1].failed:
        return f"Stopped after {len(seen) - 1} steps. {seen[-1].text}"
    early = [each for each in seen if _outcome(each) not in (None, "reached")]
    if early and early[-1] is seen[-1] and len(early) > RETRIES:
        return f"Stopped: the motion ended early. {seen[-1].text}"
    seen = [each for each in seen if each not in early]  # what ended early is asked for again
    calls: list[Call] = []
    speed = _speed(text, 0.4)
    for step in re.split(r";|\bthen\b", text):
        speed = _speed(step, speed)
        place = re.search(rf"(above|down to) {_NUMBER}, {_NUMBER}, {_NUMBER}", step)
        pose = next((name for name in POSES if re.search(rf"\bto {name}\b", step, re.IGNORECASE)), None)
        if place is not None:
            x, y, z = map(float, place.groups()[1:])
            z += ABOVE_M if place[1] == "above" else 0.0
            calls.append(Call("joints_for", {"x_m": x, "y_m": y, "z_m": round(z, 6)}))
            calls.append(Call("move_joint", {"q_rad": "of the last answer", "speed_rad_s": speed}))
        elif pose is not None:
            calls.append(Call("move_joint", {"q_rad": list(POSES[pose]), "speed_rad_s": speed}))
        elif "open the gripper" in step.lower():
            calls.append(Call("gripper_move", {"width_m": 0.08, "speed_m_s": 0.05, "force_n": 30.0}))
        elif "close the gripper" in step.lower():
            force = re.search(rf"{_NUMBER} N\b", step)
            width = {"width_m": CLOSED_M, "speed_m_s": 0.05, "force_n": float(force[1]) if force else 30.0}
            calls.append(Call("gripper_move", width))
    call = _in_turn(calls, seen)
    if call is not None and seen and calls[len(seen) - 1].arguments.get("width_m") == CLOSED_M:
        held = seen[-1].content
        if isinstance(held, dict) and not held.get("object"):
            return f"Stopped after {len(seen)} steps: nothing is between the fingers."
    if call is None:
        ends = [
            each.content.get("outcome") for each in seen if isinstance(each.content, dict) and "outcome" in each.content
        ]
        return f"Done in {len(ends)} steps: {', '.join(map(str, ends))}." if ends else "There was nothing to do."
    if call.tool == "move_joint":
        q_rad = call.arguments["q_rad"]
        if isinstance(q_rad, str):
            answer = seen[-1].content
            q_rad = answer["q_rad"] if isinstance(answer, dict) else json.loads(str(answer))["q_rad"]
        return Call("move_joint", {**call.arguments, "q_rad": q_rad, "acceleration_rad_s2": ACCELERATION_RAD_S2})
    return call


def vision(_: str, seen: Sequence[Seen]) -> Call | str:
    """Looks, and says where what stands."""
    if seen and seen[-1].failed:
        return f"I see nothing. {seen[-1].text}"
    if not seen:
        return Call("look", {})
    answer = seen[-1].content if isinstance(seen[-1].content, dict) else json.loads(seen[-1].text)
    things = [f"{each['id']} at {each['x_m']}, {each['y_m']}, {each['z_m']}" for each in answer["objects"]]
    people = len(answer["people"])
    return f"{'; '.join(things) or 'nothing on the table'}; {people} {'person' if people == 1 else 'people'}."


def config(text: str, seen: Sequence[Seen]) -> Call | str:
    """Changes the profile as it is told, and says what it is now."""
    if seen and seen[-1].failed:
        return f"The profile is as before. {seen[-1].text}"
    if not seen:
        return _change(text)
    return f"The profile is now {seen[-1].text}"


def _change(text: str) -> Call:
    wanted = text.lower()
    mass = re.search(rf"{_NUMBER} ?kg", wanted)
    if mass:
        return Call("set_payload", {"mass_kg": float(mass[1]), "note": text[:200]})
    centre = re.search(rf"{_NUMBER}, ?{_NUMBER}, ?{_NUMBER}", wanted)
    if centre and "tool" in wanted:
        return Call("set_tool_centre", dict(zip(("x_m", "y_m", "z_m"), map(float, centre.groups()), strict=True)))
    if "limit" in wanted and _SPEED.search(wanted):
        joint = {"speed_rad_s": _speed(wanted, 0.5), "acceleration_rad_s2": ACCELERATION_RAD_S2}
        return Call("set_limits", {"limits": {"joint": joint, "grip": {"force_n": 40.0}}})
    return Call("read_profile", {})


SCRIPTS: Final = {"orchestrator": orchestrator, "robotic": robotic, "vision": vision, "config": config}
"""The script of each role."""
