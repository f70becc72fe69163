"""Latches of robots as people read and clear them: only the digest of a latch that was read is signed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

from capabilities.keys.keys import check_raw, unb64u
from capabilities.statements.people import clearing, latch
from capabilities.statements.people.vote import digest_of
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import BadKeyError, FaultCode, StatementError
from ztpm_idp.client.people import PeopleCaller

if TYPE_CHECKING:
    from capabilities.statements.people.latch import Latch

LIFETIME_S: Final = 300
"""Seconds for which a clearing counts: time for two people at one cell."""


@dataclass(frozen=True, slots=True)
class ShownLatch:
    """Latch as read from its text, the digest of that very text, how it stands, and who has cleared it."""

    latch: Latch
    digest: str
    state: str
    clearings: tuple[dict[str, Any], ...]


class LatchCaller(PeopleCaller):
    """Requests about latches."""

    def latches(self) -> list[dict[str, Any]]:
        """The newest latches: latch_id, state ("waits" or "released"), pep, audience, robot, cause, approvers, at."""
        found: list[dict[str, Any]] = self._json(self._send("GET", "/latches", b"", None))
        return found

    def latch(self, latch_id: str) -> ShownLatch:
        """The latch, parsed strictly from its signed text.

        The key that must have signed it is the one the provider states. A provider that lies about it gains nothing:
        a clearing binds the text, and the enforcement point knows which text it signed.

        Raises:
            StatementError: the text is no latch, not signed by that key, or another latch.
            ClientError: as the identity provider refuses it.
        """
        found = self._json(self._send("GET", f"/latches/{quote(latch_id, safe='')}", b"", None))
        text, key = found.get("latch"), found.get("pep_key")
        if not isinstance(text, str) or not isinstance(key, str):
            raise StatementError(FaultCode.STATEMENT_MALFORMED, "no latch in the answer")
        try:
            signer = check_raw(unb64u(key))
        except BadKeyError:
            raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "no key in the answer") from None
        shown = latch.open(text, {signer}, DEFAULT)
        if shown.latch_id != latch_id:
            raise StatementError(FaultCode.STATEMENT_MALFORMED, "another latch")
        return ShownLatch(shown, digest_of(text), str(found.get("state")), tuple(found.get("clearings") or ()))

    def clear_latch(self, shown: ShownLatch, *, lifetime_s: int = LIFETIME_S) -> str:
        """This person's clearing of the latch that it was shown; how the latch stands then.

        Raises:
            ClientError: as the identity provider refuses it.
        """
        at, stated = int(self._now()), shown.latch
        made = clearing.Clearing(
            latch_id=stated.latch_id,
            latch_digest=shown.digest,
            audience=stated.audience,
            robot=stated.robot,
            cause=stated.cause,
            approver=self.id,
            not_after=at + lifetime_s,
            at=at,
        )
        body = {"clearing": clearing.sign(made, self._key)}
        return str(self._post(f"/latches/{quote(stated.latch_id, safe='')}/clearings", body)["state"])
