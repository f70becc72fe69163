"""Language of the dashboard as a closed grammar: the meaning of a line, and its one spelling.

A controller's dashboard hands parts of a line to its own shell (CVE-2026-8153), so nothing of a client's text is ever
passed on: a line is read into a row of the table and an argument of safe characters, and written anew from them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import Mapping

MAX_LINE: Final = 256
"""Bytes of a line without its end; the longest line of the grammar has fewer."""


class LineClass(Enum):
    """Treatment of a line."""

    ALLOW = "allow"
    """Passed on for every client: it ends motion, or takes a notice away."""
    READ = "read"
    """Passed on: it only asks."""
    DECIDE = "decide"
    """Passed on when a decision permits it."""
    HUMAN = "human"
    """Never from an agent: a person looks at the robot first."""
    DENY = "deny"
    """Never."""
    LOCAL = "local"
    """Answered here; the connection ends."""


class ArgumentKind(Enum):
    """Argument behind the words; never a shell's option, or a way up."""

    NONE = r""
    FILE = r"(?:[A-Za-z0-9_][A-Za-z0-9_-]*/)*[A-Za-z0-9_][A-Za-z0-9_-]*(?:\.[A-Za-z0-9_-]+)*"
    TEXT = r"[A-Za-z0-9](?:[A-Za-z0-9 .,:_-]*[A-Za-z0-9.,:_-])?"
    ROLE = r"none|operator|programmer|locked|restricted"
    MODE = r"manual|automatic"
    REPORT = r"controller|software|system"


@dataclass(frozen=True, slots=True)
class LineRow:
    """One command of the dashboard.

    Attributes:
        words: beginning of the line.
        line_class: treatment of the line.
        argument: kind of its argument.
    """

    words: str
    line_class: LineClass
    argument: ArgumentKind = ArgumentKind.NONE


@dataclass(frozen=True, slots=True)
class DashboardLine:
    """Content of a client's line.

    Attributes:
        row: the command.
        argument: its argument, of the row's characters; empty when the row has none.
    """

    row: LineRow
    argument: str

    def render(self) -> bytes:
        """Line with this content, with its end."""
        return f"{self.row.words} {self.argument}".rstrip(" ").encode("ascii") + b"\n"


_ALLOW, _READ, _DECIDE = LineClass.ALLOW, LineClass.READ, LineClass.DECIDE
_HUMAN, _DENY = LineClass.HUMAN, LineClass.DENY
# UR's dashboard server manual for e-Series, and what UR's own clients send.
_ROWS: Final = (
    LineRow("stop", _ALLOW),
    LineRow("pause", _ALLOW),
    LineRow("power off", _ALLOW),
    LineRow("close popup", _ALLOW),
    LineRow("running", _READ),
    LineRow("robotmode", _READ),
    LineRow("get loaded program", _READ),
    LineRow("isProgramSaved", _READ),
    LineRow("programState", _READ),
    LineRow("PolyscopeVersion", _READ),
    LineRow("version", _READ),
    LineRow("getUserRole", _READ),
    LineRow("get operational mode", _READ),
    LineRow("safetymode", _READ),
    LineRow("safetystatus", _READ),
    LineRow("is in remote control", _READ),
    LineRow("get serial number", _READ),
    LineRow("get robot model", _READ),
    LineRow("popup", _DECIDE, ArgumentKind.TEXT),
    LineRow("addToLog", _DECIDE, ArgumentKind.TEXT),
    LineRow("power on", _DECIDE),
    LineRow("brake release", _DECIDE),
    LineRow("unlock protective stop", _HUMAN),
    LineRow("close safety popup", _HUMAN),
    LineRow("restart safety", _HUMAN),
    LineRow("play", _DENY),
    LineRow("load", _DENY, ArgumentKind.FILE),
    LineRow("load installation", _DENY, ArgumentKind.FILE),
    LineRow("shutdown", _DENY),
    LineRow("setUserRole", _DENY, ArgumentKind.ROLE),
    LineRow("set operational mode", _DENY, ArgumentKind.MODE),
    LineRow("clear operational mode", _DENY),
    LineRow("generate flight report", _DENY, ArgumentKind.REPORT),
    LineRow("generate support file", _DENY, ArgumentKind.FILE),
    LineRow("saveLog", _DENY),
    LineRow("quit", LineClass.LOCAL),
)
LINES: Final[Mapping[str, LineRow]] = MappingProxyType({row.words: row for row in _ROWS})
"""Every command by its words."""

_BY_LENGTH: Final = sorted(_ROWS, key=lambda row: -len(row.words))


def parse_line(line: bytes) -> DashboardLine | InputRefusal:
    """Content of a line. Never raises.

    Args:
        line: without its line feed; one carriage return before it is taken for part of the end.

    Returns:
        Refused as `BODY_TOO_LARGE` for a line that is too long, as `TOOL_UNKNOWN` for words that are no command, and as
        `PARAMETERS_WRONG` for an argument that is missing, too much, or of other characters than the row's.
    """
    if len(line) > MAX_LINE:
        return InputRefusal(Reason.BODY_TOO_LARGE, "dashboard line")
    text = line.removesuffix(b"\r").decode("latin-1")
    for row in _BY_LENGTH:
        if text != row.words and not text.startswith(row.words + " "):
            continue
        if row.argument is ArgumentKind.NONE:
            if text == row.words:
                return DashboardLine(row, "")
        elif re.fullmatch(row.argument.value, argument := text[len(row.words) + 1 :]):
            return DashboardLine(row, argument)
        return InputRefusal(Reason.PARAMETERS_WRONG, row.words)
    return InputRefusal(Reason.TOOL_UNKNOWN, "dashboard line")
