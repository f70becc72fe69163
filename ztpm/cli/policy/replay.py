"""Decisions of the past: out of a PEP's journal, an exported ledger, or a file of written cases.

Nothing here verifies that a file is whole and unchanged: `ztpm audit verify` does.
"""

from __future__ import annotations

import lzma
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.strict_json import JsonError, read
from pep.gate.records import GATE
from pep.journal.file_journal import record_hash
from policies.evidence import case_json
from policies.evidence.model import Effect
from policies.explain.differences import ComparedCase, ComparedDecision
from policies.words.errors import PolicyError
from policies.words.reason_table import Reason
from ztpm_idp.ledger_file import LINE_BYTES, LINE_DEPTH

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from policies.evidence.case_json import RecordedCase

UNANSWERED: Final = frozenset({Reason.APPROVAL_TIMEOUT, Reason.ASK_BUDGET_SPENT})
"""Denials of the gate that end a DEFER of the policies: nobody answered, or nobody could be asked."""


class ReplayError(Exception):
    """A file of the past that cannot be read.

    Attributes:
        code: "LINE_MALFORMED", "NO_DECISION", "NO_REPLAY", "EVIDENCE_DIFFERS" or a `PolicyFault`.
    """

    def __init__(self, code: str, detail: str) -> None:
        super().__init__(detail)
        self.code = code


@dataclass(frozen=True, slots=True)
class RecordedDecision:
    """One decision as it was recorded.

    Attributes:
        line: in its file, from 1.
        seq, pep, at_ms, digest: number, author, wall time and hash of its record.
        body: of the record.
    """

    line: int
    seq: int
    pep: str
    at_ms: int
    digest: str
    body: dict[str, Any]

    @property
    def request_id(self) -> str:
        """Id of the request; "" when the record has none."""
        request = self.body.get("request")
        return str(request.get("id", "")) if isinstance(request, dict) else ""

    @property
    def name(self) -> str:
        """Name under which the decision is found again."""
        return f"{self.pep} {self.seq}: {self.request_id}"

    def recorded(self) -> RecordedCase:
        """The request and evidence.

        Raises:
            PastError: `NO_REPLAY` for a record of an earlier form, `EVIDENCE_DIFFERS` when the record's digest is of
                other evidence, else the fault of `policies.evidence.case_json`.
        """
        if "form" not in self.body:
            raise ReplayError("NO_REPLAY", "the record does not hold what its decision was made of")
        try:
            found = case_json.read({key: self.body.get(key) for key in ("form", "request", "evidence")})
        except PolicyError as error:
            raise ReplayError(str(error.code), f"{error.where}: {error.detail}".rstrip(": ")) from error
        stated = self._decision().get("evidence_digest")
        if stated and stated != found.evidence.digest:
            raise ReplayError("EVIDENCE_DIFFERS", "the digest of the evidence is of other evidence")
        return found

    def verdict(self) -> ComparedDecision | None:
        """Verdict of the policies then; None for a denial that is the gate's own.

        Raises:
            PastError: `LINE_MALFORMED`.
        """
        decision = self._decision()
        try:
            if decision.get("by") != GATE:
                return ComparedDecision(Effect(decision["effect"]), str(decision["reason"]))
            if decision["reason"] in UNANSWERED:
                return ComparedDecision(Effect.DEFER, str(decision["findings"][1]["reason"]))
        except (KeyError, ValueError, TypeError, IndexError):
            raise ReplayError("LINE_MALFORMED", f"line {self.line}: no decision") from None
        return None

    @property
    def reason(self) -> str:
        """The reason that was recorded."""
        return str(self._decision().get("reason", ""))

    @property
    def policy_digest(self) -> str:
        """Digest of the set that decided."""
        return str(self._decision().get("policy_digest", ""))

    def _decision(self) -> dict[str, Any]:
        decision = self.body.get("decision")
        return decision if isinstance(decision, dict) else {}


def decisions(path: Path) -> Iterator[RecordedDecision]:
    """Every decision of a journal or an exported ledger, in the file's order.

    A last line without its end is one that is being written, and is left out.

    Raises:
        PastError: `LINE_MALFORMED`.
        OSError: when the file cannot be read.
    """
    with path.open("rb") as file:
        for number, line in enumerate(iter(lambda: file.readline(LINE_BYTES + 2), b""), start=1):
            if not line.endswith(b"\n"):
                if len(line) > LINE_BYTES:
                    raise ReplayError("LINE_MALFORMED", f"line {number}: TOO_LARGE")
                return
            found = _decision_of(line[:-1], number)
            if found is not None:
                yield found


def _decision_of(line: bytes, number: int) -> RecordedDecision | None:
    """The decision of a line; None for anything else that a journal or ledger holds."""
    try:
        entry: Any = read(line, limit_bytes=LINE_BYTES, limit_depth=LINE_DEPTH)
    except JsonError as error:
        raise ReplayError("LINE_MALFORMED", f"line {number}: {error.detail}") from error
    digest = record_hash(line)
    try:
        if "checkpoint" in entry:
            return None
        if entry["kind"] == "pep-record":
            import rfc8785

            entry = entry["body"]["record"]
            digest = record_hash(rfc8785.dumps(entry))
        if entry["kind"] != "decision":
            return None
        return RecordedDecision(
            number, int(entry["seq"]), str(entry["pep"]), int(entry["at_ms"]), digest, {**entry["body"]}
        )
    except (KeyError, TypeError, ValueError):
        raise ReplayError("LINE_MALFORMED", f"line {number}: no record") from None


def find(path: Path, record: str) -> RecordedDecision:
    """The decision with this request id or record hash; of several of one request the newest.

    Raises:
        PastError: `NO_DECISION` when there is none; as `decisions`.
        OSError: when the file cannot be read.
    """
    found = None
    for past in decisions(path):
        if record and record in (past.request_id, past.digest):
            found = past
    if found is None:
        raise ReplayError("NO_DECISION", f"no decision about request or record {record!r}")
    return found


@dataclass
class Replayed:
    """Cases of a journal, as they are drawn from it, and the number of those left out.

    Attributes:
        own: denials of the gate's own, by reason: no set of policies changes them.
        unread: records that cannot be decided again, by code.
    """

    own: dict[str, int] = field(default_factory=dict)
    unread: dict[str, int] = field(default_factory=dict)

    def cases(self, path: Path, *, since_ms: int = 0) -> Iterator[ComparedCase]:
        """Every decision since then that can be decided again.

        Raises:
            PastError, OSError: as `decisions`.
        """
        for past in decisions(path):
            if past.at_ms < since_ms:
                continue
            verdict = past.verdict()
            if verdict is None:
                self.own[past.reason] = self.own.get(past.reason, 0) + 1
                continue
            try:
                recorded = past.recorded()
            except ReplayError as error:
                self.unread[error.code] = self.unread.get(error.code, 0) + 1
                continue
            yield ComparedCase(past.name, recorded, verdict, past.policy_digest)


def written_cases(path: Path) -> Iterator[ComparedCase]:
    """Cases of a file, one document (`ztpm policy schema`) a line; a name ending in .xz is unpacked.

    Raises:
        PastError: with the line.
        OSError: when the file cannot be read.
    """
    with lzma.open(path, "rb") if path.suffix == ".xz" else path.open("rb") as file:
        try:
            for number, line in enumerate(file, start=1):
                document = read(line, limit_bytes=LINE_BYTES, limit_depth=LINE_DEPTH)
                recorded = case_json.read(document)
                yield ComparedCase(f"line {number}: {recorded.request.object}/{recorded.request.operation}", recorded)
        except JsonError as error:
            raise ReplayError("LINE_MALFORMED", str(error)) from error
        except PolicyError as error:
            raise ReplayError(str(error.code), f"{error.where}: {error.detail}".rstrip(": ")) from error
        except lzma.LZMAError as error:
            raise ReplayError("LINE_MALFORMED", "not xz") from error
