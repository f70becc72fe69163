"""Errors of a PEP: one small tree with reason codes.

An error that is raised before an effect denies the request.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from policies.words.reason_table import Reason


class PepFault(StrEnum):
    """Reasons that concern the PEP's own machinery; a caller sees a `policies.words.reason_table.Reason` instead."""

    JOURNAL_CORRUPT = "JOURNAL_CORRUPT"
    JOURNAL_LOCKED = "JOURNAL_LOCKED"
    JOURNAL_BROKEN = "JOURNAL_BROKEN"
    REPLAY_STORE_FULL = "REPLAY_STORE_FULL"
    FEED_UNREACHABLE = "FEED_UNREACHABLE"
    FEED_UNTRUSTED = "FEED_UNTRUSTED"
    FEED_WRONG_NONCE = "FEED_WRONG_NONCE"
    FEED_WRONG_ISSUER = "FEED_WRONG_ISSUER"
    FEED_WRONG_RANGE = "FEED_WRONG_RANGE"
    FEED_ROLLED_BACK = "FEED_ROLLED_BACK"
    FEED_FORKED = "FEED_FORKED"
    FEED_RESTORING = "FEED_RESTORING"
    ANSWERS_WRONG_AUDIENCE = "ANSWERS_WRONG_AUDIENCE"
    ASK_NOT_TAKEN = "ASK_NOT_TAKEN"
    LATCH_NOT_TAKEN = "LATCH_NOT_TAKEN"
    PICTURE_CROWDED = "PICTURE_CROWDED"
    PICTURE_IMPOSSIBLE = "PICTURE_IMPOSSIBLE"
    PICTURE_DRAWER_ENDED = "PICTURE_DRAWER_ENDED"
    PICTURE_NOT_TAKEN = "PICTURE_NOT_TAKEN"
    REGISTRY_WRONG_AUDIENCE = "REGISTRY_WRONG_AUDIENCE"
    REGISTRY_ROLLED_BACK = "REGISTRY_ROLLED_BACK"
    STATE_UNREADABLE = "STATE_UNREADABLE"
    CLOCK_SET_BACK = "CLOCK_SET_BACK"
    CONFIG_INVALID = "CONFIG_INVALID"
    ROBOT_UNREACHABLE = "ROBOT_UNREACHABLE"
    NOT_SIMULATED = "NOT_SIMULATED"
    ROBOT_STALLED = "ROBOT_STALLED"
    GRIPPER_UNREACHABLE = "GRIPPER_UNREACHABLE"
    GRIPPER_INACTIVE = "GRIPPER_INACTIVE"
    OUTPUT_UNCONFIRMED = "OUTPUT_UNCONFIRMED"
    LEDGER_REFUSED = "LEDGER_REFUSED"
    UPSTREAM_UNREACHABLE = "UPSTREAM_UNREACHABLE"
    # declarations of tools, at start
    UNIT_UNKNOWN = "UNIT_UNKNOWN"
    SCALE_INVALID = "SCALE_INVALID"
    BOUND_EMPTY = "BOUND_EMPTY"
    ROW_LOWERS = "ROW_LOWERS"
    DECLARATION_MALFORMED = "DECLARATION_MALFORMED"
    TOOL_TWICE = "TOOL_TWICE"
    TOOL_UNDECLARED = "TOOL_UNDECLARED"
    TOOL_SCHEMA_DIFFERS = "TOOL_SCHEMA_DIFFERS"
    TOOL_UNKNOWN = "TOOL_UNKNOWN"
    TOOL_DEFINITION_CHANGED = "TOOL_DEFINITION_CHANGED"


class PepError(Exception):
    """Root of the tree. `code` is the reason; `detail` is for the record."""

    def __init__(self, code: PepFault, detail: str = "") -> None:
        super().__init__(f"{code}: {detail}" if detail else str(code))
        self.code = code
        self.detail = detail


class JournalError(PepError):
    """A record that could not be made durable, or a journal that must not be continued."""


class ReplayStoreError(PepError):
    """A replay store that cannot answer."""


class FeedError(PepError):
    """A feed answer that is refused, or none at all."""


class ConfigError(PepError):
    """A configuration that is refused."""


class DeclarationError(PepError):
    """A tool whose declaration is refused; `detail` names tool and place."""


class RobotError(PepError):
    """A robot or gripper that cannot be read or driven."""


class ActuationRefusedError(Exception):
    """A command that was not sent. `reason` says why; nothing has moved."""

    def __init__(self, reason: Reason, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else str(reason))
        self.reason = reason
        self.detail = detail


class UpstreamError(PepError):
    """Server behind the gateway that cannot be reached, or whose connection ended before its answer."""

    def __init__(self, name: str, detail: str) -> None:
        super().__init__(PepFault.UPSTREAM_UNREACHABLE, f"{name}: {detail}")
