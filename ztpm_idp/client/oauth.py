"""Clients of OAuth as administrators register them, scopes as sponsors declare them, and what was lent to clients."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from capabilities.keys.keys import b64u
from capabilities.values.scope import Restriction
from capabilities.values.scope_json import restriction_to_json
from ztpm_idp.client.caller import Caller

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capabilities.values.scope import Grant, Tier


class OAuthCaller(Caller):
    """Requests about clients of OAuth."""

    def register_client(
        self, client_id: str, name: str, *, redirects: Iterable[str] = (), key: bytes | None = None, sponsor: str = ""
    ) -> None:
        """A client is registered, with the agent that stands for it in tokens and records.

        Args:
            client_id: also the agent's id: lower-case ASCII.
            name: as people are shown it.
            redirects: exact URIs, https or loopback; of a loopback one any port will do.
            key: raw public key of `private_key_jwt`, Ed25519 or P-256; None: a public client.
            sponsor: who answers for the agent; this person unless another is named.
        """
        body: dict[str, object] = {
            "client_id": client_id,
            "name": name,
            "sponsor": sponsor or self.id,
            "redirect_uris": list(redirects),
        }
        self._post("/oauth/clients", body | ({} if key is None else {"key": b64u(key)}))

    def clients(self) -> list[dict[str, Any]]:
        """Every registered client."""
        return self._listed("/oauth/clients")

    def declare_scope(self, name: str, words: str, audience: str, grants: tuple[Grant, ...], *, ceiling: Tier) -> None:
        """An OAuth scope means this from now on.

        Args:
            name: such as "camera.read".
            words: for the person who is asked.
            audience: the one tool server that it is for.
            grants: as in a token's scope.
            ceiling: 0 or 1.
        """
        limits = restriction_to_json(Restriction(grants=grants, ceiling=ceiling))
        self._post(f"/oauth/scopes/{name}", {"words": words, "audience": audience, **limits})

    def end_scope(self, name: str) -> None:
        """Nobody is lent by this OAuth scope from now on."""
        self._post(f"/oauth/scopes/{name}/end", {})

    def scopes(self) -> list[dict[str, Any]]:
        """Every declared OAuth scope."""
        return self._listed("/oauth/scopes")

    def lent_to_clients(self) -> list[dict[str, Any]]:
        """Families that this person lent to clients; every one for an administrator."""
        return self._listed("/oauth/lent")

    def take_back(self, family: str, reason: str) -> int:
        """All that came of a person's assent is over; the epoch."""
        return int(self._post(f"/oauth/lent/{family}/end", {"reason": reason})["epoch"])

    def _listed(self, path: str) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self._json(self._send("GET", path, b"", None))
        return found
