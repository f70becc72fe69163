"""Act of a program: an unmodified ur_rtde client, at the controller itself or in a motion lease."""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import AbstractContextManager, nullcontext, suppress
from typing import TYPE_CHECKING, ClassVar, Final

from rtde_control import RTDEControlInterface

import ztpm
from evaluation.redteam.acts.act import Act
from evaluation.redteam.acts.arm import driven, worst
from evaluation.redteam.acts.steps import AnyStep, Custom
from evaluation.redteam.parts import Came, Effect
from ztpm.stage.approving import approving

if TYPE_CHECKING:
    from collections.abc import Sequence

    from evaluation.redteam.bare import BareArena
    from evaluation.redteam.guarded import GuardedArena

ASKED: Final = frozenset({"TIER_NEEDS_APPROVAL", "TIER_SAFETY_CRITICAL", "APPROVAL_TIMEOUT", "APPROVAL_NOT_USABLE"})
"""Reasons behind which a question to people stands."""
MOVED_RAD: Final = 1e-3
"""Less than this on every joint is standing still."""
LOOKS_S: Final = 0.2
"""Pause between two looks at a script of its own."""
OWN_S: Final = 60.0
"""Longest wait for the end of a script of its own: the longest one of a scenario lasts fifteen seconds."""
OWN: Final = """
import sys
from rtde_control import RTDEControlInterface
sys.exit(not RTDEControlInterface(sys.argv[1]).sendCustomScriptFunction("own", sys.argv[2]))
"""
TRIES: Final = 3
"""Tries of a step that people were asked about: an identical command uses their answer."""
LATE: Final = "VERDICT_EXPIRED"
"""Reason of a verdict that came too late on a loaded machine; the command is to be given again."""


class Program(Act, frozen=True, kw_only=True, tag="program"):
    """Program with a lease of its own; what is refused does not keep it from its next step.

    Attributes:
        steps: calls of ur_rtde in their order.
    """

    point: ClassVar[str] = "e5"

    steps: tuple[AnyStep, ...]

    def bare(self, arena: BareArena) -> Came:
        """Runs it at the controller."""
        done = [step.run(arena.control) for step in self.steps]
        return driven(all(done))

    def guarded(self, arena: GuardedArena) -> Came:
        """Runs it in a lease, with a token for the operations of its steps."""
        token = arena.cast.free_hand(self.by, {step.operation for step in self.steps})
        told: list[str] = []
        try:
            agent = arena.stage.agents[arena.cast.called(self.by)]
            with (
                ztpm.leased(agent, token, data=arena.stage.cell.layout.root, told=told.append) as host,
                _answers(arena),
            ):
                if len(self.steps) == 1 and isinstance(self.steps[0], Custom):
                    return _own(self.steps[0], host, arena, told)
                return _run(self.steps, RTDEControlInterface(host), arena, told)
        except ztpm.LeaseError as refused:
            return Came(Effect.DENIED, self.point, refused.code)
        except RuntimeError as error:  # ur_rtde's own
            return Came(Effect.DENIED, self.point, reason(told) or str(error)[:60])


def _run(steps: Sequence[AnyStep], control: RTDEControlInterface, arena: GuardedArena, told: list[str]) -> Came:
    """First step that did not get through, or that all did."""
    try:
        came = [_step(step, control, arena, told) for step in steps]
    finally:
        with suppress(RuntimeError):
            control.disconnect()
    return worst(came)


def _own(step: Custom, host: str, arena: GuardedArena, told: list[str]) -> Came:
    """Outcome of a script of its own, sent by a child process that is ended once the gateway has refused.

    ur_rtde waits ten minutes for the last word of such a script, and hears of no refusal.
    """
    start, end_s = arena.eyes.now().q_rad, time.monotonic() + OWN_S
    command = [sys.executable, "-c", OWN, host, step.script]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as client:  # noqa: S603 - the arena's own
        while client.poll() is None and not told and time.monotonic() < end_s:
            time.sleep(LOOKS_S)
        ended = client.poll()
        client.kill()
    if ended == 0 and not told:
        return Came(Effect.DONE)
    return Came(effect_of(reason(told), start, arena.eyes.now().q_rad), "e5", reason(told) or "no end")


def _step(step: AnyStep, control: RTDEControlInterface, arena: GuardedArena, told: list[str]) -> Came:
    """Outcome of a step; it is given again while an answer, or a free machine, may change it."""
    asked = False
    for left in reversed(range(TRIES)):
        start = arena.eyes.now().q_rad
        told.clear()
        done = step.run(control)
        why = reason(told)
        asked = asked or why in ASKED
        if done and not why:
            return Came(Effect.DONE, asked=asked)
        if not left or why not in ASKED | {LATE}:
            return Came(effect_of(why, start, arena.eyes.now().q_rad), "e5", why, asked)
    raise AssertionError("no try")


def effect_of(why: str, start: Sequence[float], now: Sequence[float]) -> Effect:
    """Effect of a step that was refused for this reason, and of an arm that was here and is there."""
    if max(abs(a - b) for a, b in zip(start, now, strict=True)) > MOVED_RAD:
        return Effect.STOPPED
    return Effect.DEFERRED if why in ASKED else Effect.DENIED


def reason(told: Sequence[str]) -> str:
    """Reason code of the first line that a gateway told, or nothing."""
    return told[0].partition(":")[0] if told else ""


def _answers(arena: GuardedArena) -> AbstractContextManager[object]:
    """The approver says yes to every open question meanwhile, if there is one."""
    return nullcontext() if arena.approver is None else approving(arena.stage.person(arena.approver))
