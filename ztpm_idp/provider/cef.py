"""Entries of the ledger as events of the Common Event Format (ArcSight CEF, format 0). Pure."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from ztpm_idp.domain.audit import AuditRow

VERSION: Final = "CEF:0"
VENDOR: Final = "ZTPM"
PRODUCT: Final = "ztpm_idp"
DEVICE_VERSION: Final = "1"
REASON_CHARACTERS: Final = 1_023
"""Longest `reason` and `msg` of the dictionary of CEF keys."""
_SEVERITY: Final = {"revoked": 7, "incident": 8, "agent-suspended": 7, "store-restored": 9, "refusals-spent": 6}
"""Severity by kind, 0 to 10."""
_EFFECT_SEVERITY: Final = {"PERMIT": 2, "DENY": 5, "DEFER": 4, "unknown": 6, "failed": 5}
"""Severity by effect or outcome, where the kind has none."""
_REFUSED: Final = 5
_PLAIN: Final = 1
_LABELS: Final = (
    ("cs1", "token"),
    ("cs2", "agent"),
    ("cs3", "object"),
    ("cs4", "request"),
    ("cs5", "trace"),
)
"""Custom fields, in the order of their numbers; the sixth is the entry's hash."""


def event(row: AuditRow, digest: str, line: bytes) -> str:
    """The event of one entry: its columns, its hash, and the reason that its body gives."""
    reason = _reason(line)
    name = " ".join(word for word in (row.kind, row.effect) if word)
    severity = _SEVERITY.get(row.kind, _EFFECT_SEVERITY.get(row.effect or "", _plain_severity(row.kind)))
    header = (VERSION, VENDOR, PRODUCT, DEVICE_VERSION, row.kind, name, str(severity))
    extension = {
        "rt": str(row.at_ms),
        "externalId": str(row.seq),
        "suser": row.actor,
        "act": row.kind,
        "outcome": row.effect,
        "reason": reason,
    }
    for key, column in _LABELS:
        value = getattr(row, column)
        if value is not None:
            extension |= {key: value, f"{key}Label": column}
    extension |= {"cs6": digest, "cs6Label": "hash"}
    said = " ".join(f"{key}={_in_extension(value)}" for key, value in extension.items() if value)
    return "|".join((header[0], *map(_in_header, header[1:]), said))


def _plain_severity(kind: str) -> int:
    return _REFUSED if kind.endswith("refused") or kind == "refusal" else _PLAIN


def _reason(line: bytes) -> str:
    body: Any = json.loads(line)["body"]
    record = body.get("record")
    body = record["body"] if isinstance(record, dict) else body
    decided = body.get("decision")
    found = (decided if isinstance(decided, dict) else body).get("reason", body.get("code"))
    return found[:REASON_CHARACTERS] if isinstance(found, str) else ""


def _in_header(value: str) -> str:
    """A field of the header: backslash and bar are escaped, and it has no line breaks."""
    return _on_one_line(value).replace("\\", "\\\\").replace("|", "\\|")


def _in_extension(value: str) -> str:
    """A value of the extension: backslash, equals sign and line breaks are escaped."""
    escaped = value.replace("\\", "\\\\").replace("=", "\\=").replace("\r", "\\r").replace("\n", "\\n")
    return _on_one_line(escaped)


def _on_one_line(value: str) -> str:
    """The value without characters by which a reader of lines would end one (`str.splitlines` knows them all)."""
    return " ".join(value.splitlines())
