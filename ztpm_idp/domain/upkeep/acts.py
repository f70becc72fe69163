"""Commands and events by which enforcement points, sensors, tools and keys are kept up."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class PartKind(StrEnum):
    """Kind of a part that an administrator may suspend."""

    PEP = "pep"
    SENSOR = "sensor"


class ToolAct(StrEnum):
    """Act on a registered tool."""

    SUSPEND = "suspend"
    RESTORE = "restore"
    RETIRE = "retire"


@dataclass(frozen=True, slots=True)
class SuspendPart:
    """An administrator suspends an enforcement point or sensor until one restores it."""

    by: str
    kind: PartKind
    id: str
    reason: str


@dataclass(frozen=True, slots=True)
class RestorePart:
    """An administrator restores an enforcement point or sensor that was suspended."""

    by: str
    kind: PartKind
    id: str
    reason: str


@dataclass(frozen=True, slots=True)
class RetirePart:
    """An administrator retires an enforcement point or sensor, for ever."""

    by: str
    kind: PartKind
    id: str
    reason: str


@dataclass(frozen=True, slots=True)
class ReplaceKey:
    """A person gives an agent, enforcement point or sensor another key; the one before is revoked.

    `kind` is the word of the party's kind, "agent", "pep" or "sensor".
    """

    by: str
    kind: str
    id: str
    key: bytes
    reason: str


@dataclass(frozen=True, slots=True)
class ChangeTool:
    """An administrator suspends, restores or retires a tool of an audience."""

    by: str
    audience: str
    name: str
    act: ToolAct
    reason: str


UpkeepCommand = SuspendPart | RestorePart | RetirePart | ReplaceKey | ChangeTool


@dataclass(frozen=True, slots=True)
class PartSuspended:
    """A part is in no registry of these audiences and may not call, from now on."""

    kind: PartKind
    id: str
    reason: str
    audiences: frozenset[str]


@dataclass(frozen=True, slots=True)
class PartRestored:
    """A part stands as it stood before it was suspended."""

    kind: PartKind
    id: str
    reason: str
    audiences: frozenset[str]


@dataclass(frozen=True, slots=True)
class KeyReplaced:
    """A party has this key from now on, in place of `before`.

    `audiences` are those whose registry has its key.
    """

    kind: str
    id: str
    key: bytes
    before: bytes
    reason: str
    audiences: frozenset[str]


@dataclass(frozen=True, slots=True)
class ToolChanged:
    """A tool is suspended, restored or retired."""

    audience: str
    name: str
    act: ToolAct
    reason: str


UpkeepEvent = PartSuspended | PartRestored | KeyReplaced | ToolChanged
