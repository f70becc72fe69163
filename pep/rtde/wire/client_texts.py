"""Text for a program about a refusal: one line, its reason code first, said once."""

from __future__ import annotations

from typing import Final

from pep.rtde.wire.codec import MAX_TEXT
from policies.words.reason_table import REASONS, Reason

TOLD_BYTES: Final = MAX_TEXT
"""Most bytes of one such line, in the controller's text messages and in messages of the lease."""
CUT: Final = "..."
"""Mark in place of a part without room."""


def told(reason: Reason, detail: str = "") -> str:
    """Line `REASON: text (detail)`, as long as there is room for it."""
    return fitted(f"{reason}: {REASONS[reason].text}" + (f" ({detail})" if detail else ""))


def said(reason: Reason, text: str) -> str:
    """Line `REASON: text`, also for a text that begins with its reason already."""
    return fitted(text if text.startswith(f"{reason}: ") else f"{reason}: {text}")


def fitted(text: str) -> str:
    """Text in printable ASCII and at most `TOLD_BYTES`; a longer one ends after a word."""
    plain = "".join(sign if _prints(sign) else "?" for sign in text)
    if len(plain) <= TOLD_BYTES:
        return plain
    room = TOLD_BYTES - len(CUT)
    return (plain[: room + 1].rpartition(" ")[0] or plain[:room]) + CUT


def fits(text: str) -> bool:
    """True for a text that is such a line."""
    return 0 < len(text) <= TOLD_BYTES and all(map(_prints, text))


def _prints(sign: str) -> bool:
    return " " <= sign <= "~"
