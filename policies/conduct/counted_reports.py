"""Reports that were counted: each at most once, however often it is sent, in bounded memory."""

from __future__ import annotations

from bisect import insort
from dataclasses import dataclass
from typing import Any, Final

from policies.conduct.report import ReportError, is_count, is_text, listed
from policies.words.canonical import EXACT

KEPT: Final = 512
"""Most request ids remembered of one reporter; then the older half is forgotten, and older reports are not counted."""


@dataclass(frozen=True, slots=True)
class CountedReports:
    """The newest reports of one reporter, and the instant up to which older ones are forgotten.

    A forgotten report could be counted twice, so nothing at or before `floor` is counted: a late report is lost, a
    duplicate never counts. One reporter's ids displace none of another's, so nobody can hide another one's report.

    Attributes:
        floor: seconds since the epoch; -1 while nothing was forgotten.
        kept: (at, request id), ascending.
    """

    floor: int = -1
    kept: tuple[tuple[int, str], ...] = ()

    def added(self, at: int, request_id: str) -> CountedReports | None:
        """Reports with this one counted, or None when it does not count."""
        if at <= self.floor or request_id in [known for _, known in self.kept]:
            return None
        kept = list(self.kept)
        insort(kept, (at, request_id))
        if len(kept) <= KEPT:
            return CountedReports(self.floor, tuple(kept))
        floor = kept[KEPT // 2][0]
        return CountedReports(floor, tuple(entry for entry in kept if entry[0] > floor))

    def to_json(self) -> list[Any]:
        """Plain JSON of the counted reports."""
        return [self.floor, [list(entry) for entry in self.kept]]

    @classmethod
    def from_json(cls, body: object) -> CountedReports:
        """Counted reports that `to_json` wrote.

        Raises:
            ReportError: it is not that.
        """
        match body:
            case [int(floor), list(entries)] if type(floor) is int and -1 <= floor <= EXACT:
                kept = tuple(tuple(listed(entry, "seen")) for entry in entries)
            case _:
                raise ReportError("seen")
        if len(kept) > KEPT or list(kept) != sorted(kept):
            raise ReportError("seen")
        for entry in kept:
            if len(entry) != 2 or not is_count(entry[0], EXACT) or not is_text(entry[1]) or entry[0] <= floor:
                raise ReportError("seen")
        return cls(floor, kept)
