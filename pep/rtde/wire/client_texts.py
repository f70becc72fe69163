"""What a program is told of why something was refused: one line of text, its reason code first, said once."""

from __future__ import annotations

from typing import Final

from pep.rtde.wire.codec import MAX_TEXT
from policies.words.reason_table import REASONS, Reason

TOLD_BYTES: Final = MAX_TEXT
"""Of one such line, in a text message of the controller's protocol and in a word of the carriage alike."""
CUT: Final = "..."
"""In place of what there was no room for."""


def told(reason: Reason, detail: str = "") -> str:
    """`REASON: text (detail)`, as long as there is room for it."""
    return fitted(f"{reason}: {REASONS[reason].text}" + (f" ({detail})" if detail else ""))


def said(reason: Reason, text: str) -> str:
    """`REASON: text`, of a text that begins with its reason already, or does not."""
    return fitted(text if text.startswith(f"{reason}: ") else f"{reason}: {text}")


def fitted(text: str) -> str:
    """That text in printable ASCII and at most `TOLD_BYTES`; one that is longer ends after a word."""
    plain = "".join(sign if _prints(sign) else "?" for sign in text)
    if len(plain) <= TOLD_BYTES:
        return plain
    room = TOLD_BYTES - len(CUT)
    return (plain[: room + 1].rpartition(" ")[0] or plain[:room]) + CUT


def fits(text: str) -> bool:
    """Whether it is such a line."""
    return 0 < len(text) <= TOLD_BYTES and all(map(_prints, text))


def _prints(sign: str) -> bool:
    return " " <= sign <= "~"
