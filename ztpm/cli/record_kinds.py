"""Kinds of the ledger's entries and of a journal's records: the words that `ztpm audit show --kind` takes."""

from __future__ import annotations

from difflib import get_close_matches
from typing import Final

from ztpm.cli.output import fail

LEDGER: Final = (
    "agent-attested", "agent-registered", "agent-restored", "agent-suspended", "ask-refused", "ask-taken",
    "change-confirmed", "change-declined", "change-ended", "change-proposed", "closing-refused", "delegation-refused",
    "opening-closed", "opening-made", "opening-refused", "pep-record", "pep-registered", "person-key-added",
    "person-registered", "refusals-spent", "revoked", "sensor-registered", "suspension-ended", "token-delegated",
    "token-issued", "tool-registered", "trust-stated", "vote-cast", "vote-refused",
)  # fmt: skip
"""Kinds of entries."""
JOURNAL: Final = (
    "ask", "ask-answered", "ask-expired", "ask-refused", "decision", "incident", "lease", "lease-ended", "outcome",
    "refusal", "stream", "stream-values", "ticket",
)  # fmt: skip
"""Kinds of records, which the ledger holds as a `pep-record` each."""


def check_kind(word: str) -> None:
    """Ends the command for a word that is no kind, and names the near ones."""
    every = sorted({*LEDGER, *JOURNAL})
    if word not in every:
        near = get_close_matches(word, every, n=3) or every
        fail("USAGE", f"--kind {word}: no such kind; there is {', '.join(near)}")
