"""A Robotiq 2F-85 behind its URCap's socket: fingers of finite speed, and the register protocol on port 63352.

Register meanings, value ranges and the text protocol: Robotiq 2F-85 instruction manual and the URCap's own preamble.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

STROKE_M: Final = 0.085  # opening of the 2F-85
CLOSED_POSITION: Final = 228  # position register when the fingers touch each other; 0 is open, 255 is never reached
SPEED_LOW_M_S, SPEED_HIGH_M_S = 0.020, 0.150  # finger speed at SPE 0 and SPE 255
ACKNOWLEDGED: Final = "ack"
MAX_LINE: Final = 256  # characters of a command
WRITABLE: Final = {"ACT": 1, "GTO": 1, "ATR": 1, "ARD": 1, "FOR": 255, "SPE": 255, "POS": 255}
READABLE: Final = frozenset([*WRITABLE, "PRE", "OBJ", "STA", "FLT", "COU", "PCO", "NCY", "DST", "MOD"])


class Contact(IntEnum):
    """The OBJ register."""

    MOVING = 0
    STOPPED_OPENING = 1
    STOPPED_CLOSING = 2
    AT_POSITION = 3


class Gripper:
    """Fingers and registers.

    Args:
        object_width_m: width of the object between the fingers, or None when they are empty.
    """

    def __init__(self, *, object_width_m: float | None = None) -> None:
        self.object_width_m = object_width_m
        self.registers = dict.fromkeys(WRITABLE, 0)
        self.position = 0.0  # in register units, 0 open
        self.contact = Contact.AT_POSITION
        self._closed_once = False
        self._active = False

    @property
    def width_m(self) -> float:
        """Distance between the fingers."""
        return STROKE_M * (1.0 - self.position / CLOSED_POSITION)

    def tick(self, dt_s: float) -> None:
        """The fingers move for `dt_s`."""
        registers = self.registers
        if not registers["ACT"]:
            self._active = self._closed_once = False
            return
        if not self._active:
            self._activate(SPEED_HIGH_M_S * dt_s * CLOSED_POSITION / STROKE_M)
            return
        if not registers["GTO"]:
            return
        goal = min(registers["POS"], CLOSED_POSITION)
        if self.contact is Contact.STOPPED_CLOSING and goal >= self.position:
            return
        speed_m_s = SPEED_LOW_M_S + (SPEED_HIGH_M_S - SPEED_LOW_M_S) * registers["SPE"] / 255
        reach = speed_m_s * dt_s * CLOSED_POSITION / STROKE_M
        wanted = self.position + max(-reach, min(reach, goal - self.position))
        held = self._held_at()
        if held is not None and self.position <= held <= wanted and goal > held:
            self.position, self.contact = held, Contact.STOPPED_CLOSING
            return
        self.position = wanted
        self.contact = Contact.AT_POSITION if wanted == goal else Contact.MOVING

    def _activate(self, reach: float) -> None:
        """One tick of the full stroke by which the gripper learns its ends: closed, or against something, then open."""
        held = self._held_at()
        closed = CLOSED_POSITION if held is None or held < self.position else held
        if not self._closed_once:
            self.position = min(closed, self.position + reach)
            self._closed_once = self.position >= closed
            return
        self.position = max(0.0, self.position - reach)
        self._active, self.contact = self.position == 0.0, Contact.AT_POSITION

    def _held_at(self) -> float | None:
        if self.object_width_m is None:
            return None
        return CLOSED_POSITION * (1.0 - self.object_width_m / STROKE_M)

    def answer(self, line: str) -> str:
        """The reply to one command line: `SET NAME VALUE [NAME VALUE ...]` or `GET NAME`; `?` to anything else."""
        words = line.split()
        match words:
            case ["SET", *pairs] if pairs and len(pairs) % 2 == 0:
                changes: dict[str, int] = {}
                for name, text in zip(pairs[::2], pairs[1::2], strict=True):
                    if name not in WRITABLE or not (text.isascii() and text.isdigit() and len(text) <= 3):
                        return "?"
                    if int(text) > WRITABLE[name]:
                        return "?"
                    changes[name] = int(text)
                self._apply(changes)
                return ACKNOWLEDGED
            case ["GET", name] if name in READABLE:
                return f"{name} {self._read(name)}"
            case _:
                return "?"

    def _apply(self, changes: dict[str, int]) -> None:
        self.registers |= changes
        if changes.keys() & {"POS", "GTO"} and self._active and self.registers["GTO"]:
            goal = min(self.registers["POS"], CLOSED_POSITION)
            still_held = self.contact is Contact.STOPPED_CLOSING and goal >= self.position
            if goal != self.position and not still_held:
                self.contact = Contact.MOVING  # seen at once: a client polls right after its command

    def _read(self, name: str) -> int:
        match name:
            case "POS" | "PCO":
                return round(self.position)
            case "PRE":
                return self.registers["POS"]
            case "OBJ":
                return self.contact
            case "STA":
                return 3 if self._active else int(bool(self.registers["ACT"]))
            case _:
                return self.registers.get(name, 0)
