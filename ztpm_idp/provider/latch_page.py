"""A latch as people read it, on a page where an approver clears it by passkey."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.statements.people.assertion import relying_party
from capabilities.values.units import Unit
from policies.words.reason_table import REASONS, Reason
from ztpm_idp.provider import ask_page

if TYPE_CHECKING:
    from capabilities.statements.people.latch import Latch
    from ztpm_idp.domain.asking.latch_acts import ClearingRecord, LatchRecord

LASTS_S: Final = 300
"""Seconds for which a clearing on the page counts: time for two people at one cell."""


def headers(issuer: str) -> dict[str, str]:
    """Headers of the page: with the script of passkeys where these belong to the issuer."""
    return ask_page.HEADERS if relying_party(issuer) is None else ask_page.scripted(issuer)


def render(latch: Latch, record: LatchRecord, clearings: tuple[ClearingRecord, ...], *, at_ms: int) -> str:
    """The page of a latch.

    Args:
        latch: as opened from the text of `record`.
        record: as the provider keeps it.
        clearings: of it, in order.
        at_ms: now, wall clock.
    """
    party = relying_party(latch.issuer)
    way = latch.retreat[0] if latch.retreat else None
    return ask_page.PAGES.get_template("latch.html").render(
        style=ask_page.STYLE,
        look=ask_page.look_of(latch.issuer),
        latch=latch,
        text=record.text,
        digest=record.digest,
        waits=not record.released,
        rp_id="" if party is None else party.rp_id,
        script=ask_page.script_of(latch.issuer),
        post=f"{latch.issuer}/latches/{latch.latch_id}/passkey-clearings",
        now=at_ms // 1_000,
        lasts_s=LASTS_S,
        reload_s=ask_page.RELOAD_S,
        shown_at=ask_page.time_of(at_ms // 1_000),
        since=ask_page.time_of(latch.at),
        tier=ask_page.TIERS[latch.tier],
        reason=REASONS[Reason(latch.reason)].text if latch.reason in Reason.__members__ else "",
        turns=[
            (turn.joint, ask_page.readable(turn.by_urad, Unit.MICRORADIAN), f"{turn.by_urad} {Unit.MICRORADIAN}")
            for turn in (way.turns if way is not None else ())
        ],
        way=way,
        way_tier="" if way is None else ask_page.TIERS[way.tier],
        way_speed="" if way is None else ask_page.readable(way.speed_urad_s, Unit.MICRORADIAN_PER_SECOND),
        cleared=[
            (each.approver, ask_page.time_of(each.not_after), "counts" if each.counts(record, at_ms) else "over")
            for each in clearings
        ],
    )
