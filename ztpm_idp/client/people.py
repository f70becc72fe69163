"""People as administrators see and change them: alone for those who lend, by two for approvers and administrators."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from capabilities.keys.keys import b64u
from ztpm_idp.client.caller import Caller, ClientError

if TYPE_CHECKING:
    from collections.abc import Iterable


class PeopleCaller(Caller):
    """Requests about people."""

    def register_person(self, id: str, name: str, key: bytes, roles: Iterable[str]) -> None:  # noqa: A002
        """A person who only lends or only reads is registered.

        Raises:
            ClientError: `TWO_PEOPLE_NEEDED` for other roles than "sponsor" and "auditor": see `propose_person`.
        """
        self._post("/people", {"id": id, "name": name, "key": b64u(key), "roles": list(roles)})

    def disable_person(self, id: str, reason: str) -> int:  # noqa: A002
        """The person and its whole tree are dead; the epoch.

        Raises:
            ClientError: `TWO_PEOPLE_NEEDED` for another approver or administrator: see `propose_end`;
                `LAST_ADMINISTRATOR`.
        """
        return int(self._post(f"/people/{id}/disable", {"reason": reason})["epoch"])

    def persons(self) -> list[dict[str, Any]]:
        """Every person: id, name, roles, status, `keys` (thumbprints of all that sign for it now), `logins`."""
        found: list[dict[str, Any]] = self._json(self._send("GET", "/people", b"", None))
        return found

    def allowances(self, sponsor: str) -> list[dict[str, Any]]:
        """Allowances of a sponsor, each with `name`, `used` and `most`, for that person or an administrator.

        Raises:
            ClientError: `NOT_PERMITTED`, `NOT_FOUND`.
        """
        answer = self._json(self._send("GET", f"/people/{quote(sponsor, safe='')}/allowances", b"", None))
        found: list[dict[str, Any]] = answer["allowances"]
        return found

    def propose_person(self, id: str, name: str, key: bytes, roles: Iterable[str]) -> str:  # noqa: A002
        """A person waits to be registered, with roles as "approver" or "admin"; the change's id."""
        body = {"id": id, "name": name, "key": b64u(key), "roles": list(roles)}
        return str(self._post("/changes/person", body)["change_id"])

    def propose_key(self, key: bytes) -> str:
        """A further key of this person's own waits; the change's id. It gives no second vote."""
        return str(self._post("/changes/key", {"key": b64u(key)})["change_id"])

    def propose_login(self, person: str, issuer: str, subject: str) -> str:
        """A person waits to be let log in with a login at another provider; the change's id.

        Args:
            person: this one, or any for an administrator.
            issuer: of the provider, exactly as its identity tokens spell it.
            subject: of the person there, likewise.
        """
        body = {"person": person, "issuer": issuer, "subject": subject}
        return str(self._post("/changes/login", body)["change_id"])

    def end_login(self, issuer: str, subject: str) -> None:
        """A login at another provider, this person's or any for an administrator, is over, and its sessions with it."""
        self._post("/logins/end", {"issuer": issuer, "subject": subject})

    def propose_roles(self, person: str, roles: Iterable[str]) -> str:
        """All the roles that a person has from then on wait; the change's id."""
        return str(self._post("/changes/roles", {"person": person, "roles": list(roles)})["change_id"])

    def begin_passkey(self) -> dict[str, Any]:
        """A passkey of this person's own may be made: enrolment_id, url of the page, expires_at (seconds)."""
        return self._post("/passkeys/enrolments", {})

    def enrolled_passkey(self, enrolment_id: str) -> str:
        """The raw public key, in base64url, of the passkey that a browser has made; "" while it has made none."""
        found = self._json(self._send("GET", f"/passkeys/enrolments/{quote(enrolment_id, safe='')}", b"", None))
        return str(found["key"])

    def propose_passkey(self, enrolment_id: str, key: str) -> str:
        """The passkey that was made waits to be this person's; the change's id. It gives no second vote.

        Args:
            enrolment_id: of `begin_passkey`.
            key: of `enrolled_passkey`, once the person has compared it with what the browser shows.
        """
        return str(self._post("/changes/passkey", {"enrolment_id": enrolment_id, "key": key})["change_id"])

    def propose_end(self, person: str, reason: str) -> str:
        """A person waits to be ended; the change's id."""
        return str(self._post("/changes/end", {"person": person, "reason": reason})["change_id"])

    def changes(self) -> list[dict[str, Any]]:
        """The changes of people that wait, oldest first.

        Each has change_id, kind ("person", "key", "login", "roles", "end", "recovery"), person, name, roles, login, key
        (thumbprint), passkey (the key is one), reason, by, state, until (seconds since the epoch), confirmed, declined.
        """
        found: list[dict[str, Any]] = self._json(self._send("GET", "/changes", b"", None))
        return found

    def confirm_change(self, change_id: str) -> str:
        """This administrator confirms another's change; its state afterwards: "done", or "open" where more must."""
        return str(self._post(f"/changes/{quote(change_id, safe='')}/confirm", {})["state"])

    def decline_change(self, change_id: str, reason: str) -> str:
        """This administrator declines a change, or takes its own back; its state afterwards."""
        return str(self._post(f"/changes/{quote(change_id, safe='')}/decline", {"reason": reason})["state"])

    def recover(self, person: str, name: str, key: bytes) -> str:
        """An administrator waits to be made, by this key alone, which must be the provider's root key; the change's id.

        Args:
            person: a new id, or an administrator's, who gets `key` in place of all others.
            name: as shown to people.
            key: raw public key.
        """
        return str(self._post("/recoveries", {"person": person, "name": name, "key": b64u(key)})["change_id"])

    def login_link(self) -> str:
        """A link that logs this person in in the browser that opens it: once, within two minutes.

        Raises:
            ClientError: the answer names another place than the provider.
        """
        url = str(self._post("/login/links", {}).get("url", ""))
        if not url.startswith(f"{self.issuer}/login/links/"):
            raise ClientError("ANSWER_MALFORMED", 201)
        return url
