"""Envelopes as approvers sign, list and revoke them: approvals beforehand, made around an ask that was read."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from capabilities.statements.people import envelope
from capabilities.statements.people.envelope import Envelope, Seen, Side
from capabilities.values.units import Quantity
from ztpm_idp.client import person_answers
from ztpm_idp.client.people import PeopleCaller

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.statements.people.ask import Ask


@dataclass(frozen=True, slots=True)
class Bounds:
    """Bounds of an envelope around an ask.

    Attributes:
        index_milli: highest index, thousandths.
        speed_um_s: highest speed of the tool centre point.
        room: by parameter, how far below and above the ask's value it may be, in its own unit; 0 where none is given.
        start_room_urad: the same for each joint's angle at the start.
        uses: how many acts, 1 to 10.
        lifetime_s: for how long, 1 to 600 s.
    """

    index_milli: int
    speed_um_s: int
    uses: int
    lifetime_s: int
    room: Mapping[str, int] = field(default_factory=dict)
    start_room_urad: int = 0


def around(shown: Ask, bounds: Bounds, *, approver: str, envelope_id: str, at: int) -> Envelope:
    """The envelope around an ask: its agent, act, tier, reasons and things in view, and these bounds.

    Args:
        shown: the ask that the person read.
        bounds: of the envelope.
        approver: the person's id.
        envelope_id: 32 random hex digits.
        at: now, seconds since the epoch.

    Raises:
        ValueError: for an ask with a parameter that is no quantity, or room for a parameter that it has not.
    """
    values = [value for value in shown.values if isinstance(value, Quantity)]
    if len(values) != len(shown.values):
        raise ValueError("an envelope bounds quantities alone")
    if unknown := bounds.room.keys() - {value.name for value in values}:
        raise ValueError(f"no parameter {min(unknown)}")
    return Envelope(
        envelope_id=envelope_id,
        approver=approver,
        audience=shown.audience,
        sponsor=shown.sponsor,
        agent=shown.agent,
        agent_key=shown.agent_key,
        object=shown.object,
        operation=shown.operation,
        model_digest=shown.model_digest,
        policy_digest=shown.policy_digest,
        reasons=shown.reasons,
        tier=shown.tier,
        index_milli=bounds.index_milli,
        speed_um_s=bounds.speed_um_s,
        box=tuple(_side(value.name, value.value, bounds.room.get(value.name, 0)) for value in values),
        start_urad=tuple(
            _side(f"joint{number}", angle, bounds.start_room_urad) for number, angle in enumerate(shown.start_urad)
        ),
        seen=tuple(
            Seen(kind, object_)
            for kind, object_ in sorted(
                {(c.kind, c.object) for c in shown.contributors}
                | {fact.contributor for fact in shown.facts if fact.raises}
            )
        ),
        uses=bounds.uses,
        not_before=at,
        not_after=at + bounds.lifetime_s,
    )


def _side(name: str, value: int, room: int) -> Side:
    return Side(name, value - room, value + room)


class EnvelopeCaller(PeopleCaller):
    """Requests about envelopes."""

    def envelope_around(self, ask_id: str, bounds: Bounds) -> Envelope:
        """The envelope around this ask and by this person, unsigned; see `around`.

        Raises:
            ValueError: as `around`.
            StatementError, ClientError: the ask is none, or cannot be read.
        """
        found = self._json(self._send("GET", f"/approvals/{quote(ask_id, safe='')}", b"", None))
        shown = person_answers.read(found, ask_id).ask
        return around(shown, bounds, approver=self.id, envelope_id=secrets.token_hex(16), at=int(self._now()))

    def sign_envelope(self, made: Envelope) -> str:
        """The envelope, whose author this person is, is in force; its id.

        Raises:
            StatementError: `STATEMENT_MALFORMED` for bounds that nobody may sign.
            ClientError: as the identity provider refuses it.
        """
        return str(self._post("/envelopes", {"envelope": envelope.sign(made, self._key)})["envelope_id"])

    def envelopes(self) -> list[dict[str, Any]]:
        """The envelopes that are not over: envelope_id, approver, audience, agent, not_before, not_after, envelope."""
        found: list[dict[str, Any]] = self._json(self._send("GET", "/envelopes", b"", None))
        return found

    def revoke_envelope(self, envelope_id: str, reason: str) -> None:
        """The envelope is over, at once."""
        self._post(f"/envelopes/{quote(envelope_id, safe='')}/revoke", {"reason": reason})
