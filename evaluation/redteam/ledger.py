"""File of runs that were played: a line each, so that a campaign goes on where it was ended."""

from __future__ import annotations

import os
from dataclasses import dataclass
from hashlib import sha256
from typing import IO, TYPE_CHECKING, Final, Self

import msgspec

from capabilities.values import strict_json
from evaluation.redteam.record import RunRecord

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from types import TracebackType

    from evaluation.redteam.scenario import Scenario

LINE_BYTES: Final = 1 << 20
"""Most bytes of a line; a run has some thousand."""
Key = tuple[str, str, bool]
"""Scenario, mode and whether the approver says yes."""


class LedgerError(Exception):
    """File that is no ledger of this campaign; the text says what to do."""


class RedCampaign(msgspec.Struct, frozen=True):
    """Code and scenarios of a ledger: runs of other ones do not count for it.

    Attributes:
        commit: of the project when it was begun; empty where that is not known.
        code: digest of the packages' files.
        scenarios: SHA-256 of the scenarios, hexadecimal.
    """

    commit: str
    code: str
    scenarios: str


def campaign(of: Sequence[Scenario], *, commit: str, code: str) -> RedCampaign:
    """Campaign of all these scenarios with this code, begun at a commit."""
    return RedCampaign(commit, code, sha256(msgspec.json.encode(of)).hexdigest())


def digest(run: RunRecord) -> str:
    """SHA-256 of the record of a run, hexadecimal."""
    return sha256(msgspec.json.encode(run)).hexdigest()


def _line(raw: bytes) -> object:
    return strict_json.read(raw, limit_bytes=LINE_BYTES, limit_depth=strict_json.DEPTH_LIMIT)


@dataclass
class Ledger:
    """Runs of one campaign. Each is on disk before the next one is played.

    Attributes:
        runs: by key; a later run takes the place of an earlier one.
    """

    runs: dict[Key, RunRecord]
    _file: IO[bytes]

    @classmethod
    def open(cls, file: Path, of: RedCampaign) -> Self:
        """The ledger in `file`, with the runs that it has; a new one where there is no file.

        A last line that was cut off by an end in mid-write is dropped.

        Raises:
            LedgerError: the file is no ledger, or is of another campaign.
            OSError: it cannot be read or written.
        """
        text = file.read_bytes() if file.exists() else b""
        whole = text[: text.rfind(b"\n") + 1]
        head, *lines = whole.splitlines() or [b""]
        if head:
            try:
                earlier = msgspec.convert(_line(head), type=RedCampaign)
                read = [msgspec.convert(_line(line), type=RunRecord) for line in lines]
            except (strict_json.JsonError, msgspec.ValidationError) as error:
                raise LedgerError(f"{file} is no ledger of runs ({error}); name another file") from error
            if (earlier.code, earlier.scenarios) != (of.code, of.scenarios):
                what = "code" if earlier.scenarios == of.scenarios else "scenarios"
                raise LedgerError(f"{file} has runs of other {what}; name another file, or delete this one")
        elif text:
            raise LedgerError(f"{file} is no ledger of runs; name another file")
        else:
            read = []
        handle = file.open("r+b" if text else "w+b")
        handle.seek(len(whole))
        handle.truncate()
        made = cls({run.key: run for run in read}, handle)
        if not head:
            made._write(msgspec.json.encode(of))
        return made

    def add(self, run: RunRecord) -> None:
        """Keeps a run, on disk when this returns."""
        self._write(msgspec.json.encode(run))
        self.runs[run.key] = run

    def _write(self, line: bytes) -> None:
        self._file.write(line + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
