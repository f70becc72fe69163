"""Requests of each operation, made and signed beforehand: what a sponsor, a holder, a server and a person send."""

from __future__ import annotations

import hashlib
import secrets
import time
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlencode

import rfc8785

from capabilities.keys import keys
from capabilities.proof.proof import prove
from capabilities.statements import attestation
from capabilities.values.scope import Grant, Limit, Range, Restriction
from capabilities.values.scope_json import scope_to_json
from evaluation.idp.lent import SPEED, scope_now
from evaluation.idp.load import Ready, ready
from evaluation.idp.place import MEASUREMENT
from ztpm_idp.client import delegate_request, issue_request
from ztpm_idp.oauth.metadata import INTROSPECT

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.keys.keys import PrivateKey
    from evaluation.idp.place import IdpPlace

JTI_BYTES: Final = 18
LESS: Final = Restriction(grants=(Grant("arm", "move_joint", (Limit(SPEED, Range(0, 500_000)),)), Grant("arm", "stop")))
"""Part that a holder lends on: half the speed."""


class Work:
    """Maker of requests to one place. Agents `2n` receive tokens, agents `2n + 1` what is lent on."""

    def __init__(self, at: IdpPlace) -> None:
        self._at = at
        self._scope = scope_now()

    def nonce(self, agent: int) -> Ready:
        """An agent asks for a nonce."""
        return self._signed("/nonces", {}, self._at.agents[agent][1])

    def issue(self, agent: int, nonce: str) -> Ready:
        """The agent's sponsor lends to it."""
        name, key = self._sponsor_of(agent)
        request = issue_request(self._at.agents[agent][0], self._scope, purpose="benchmark")
        return self._signed("/tokens", {"request": request, "evidence": self._shown(agent, nonce, name, request)}, key)

    def delegate(self, holder: int, token: str, agent: int, nonce: str) -> Ready:
        """The holder lends a part of its token to another agent."""
        name, key = self._at.agents[holder]
        request = delegate_request(self._at.agents[agent][0], LESS, purpose="benchmark")
        body = {"request": request, "evidence": self._shown(agent, nonce, name, request)}
        return self._signed("/tokens/delegate", body, key, token=token)

    def introspect(self, number: int) -> Ready:
        """The enforcement point asks what an access token stands for."""
        url, raw = self._at.issuer + INTROSPECT, urlencode({"token": self._at.access[number]}).encode()
        headers = {"content-type": "application/x-www-form-urlencoded", "dpop": _proof(self._at.point, url, raw)}
        return ready("POST", url, raw, headers)

    def revoke(self, agent: int, token_id: str) -> Ready:
        """The agent's sponsor revokes a token of it."""
        _, key = self._sponsor_of(agent)
        return self._signed("/revocations", {"kind": "token", "id": token_id, "reason": "benchmark"}, key)

    def bare(self, agent: int) -> Ready:
        """A sponsor's request to the bare endpoint, as large as one for a token."""
        _, key = self._sponsor_of(agent)
        body = _json({"request": {"agent": self._at.agents[agent][0], "scope": scope_to_json(self._scope)}})
        return ready("POST", self._at.bare_url, body, {"dpop": _proof(key, self._at.bare_url, body)})

    def _sponsor_of(self, agent: int) -> tuple[str, PrivateKey]:
        return self._at.sponsors[agent // 2 % len(self._at.sponsors)]

    def _shown(self, agent: int, nonce: str, delegator: str, request: Mapping[str, object]) -> str:
        name, key = self._at.agents[agent]
        stated = attestation.Evidence(
            agent=name,
            key_thumbprint=keys.thumbprint(keys.public_raw(key)),
            nonce=nonce,
            delegator=delegator,
            request_digest=hashlib.sha256(_json(request)).digest(),
            measurement=MEASUREMENT,
            at=int(time.time()),
            workload="",
        )
        return attestation.sign(stated, key)

    def _signed(self, path: str, body: Mapping[str, object], key: PrivateKey, *, token: str | None = None) -> Ready:
        url, raw = self._at.issuer + path, _json(body)
        headers = {"content-type": "application/json", "dpop": _proof(key, url, raw, token=token)}
        return ready("POST", url, raw, headers | ({} if token is None else {"authorization": f"DPoP {token}"}))


def _proof(key: PrivateKey, url: str, body: bytes, *, token: str | None = None) -> str:
    jti = secrets.token_urlsafe(JTI_BYTES)
    return prove(key, method="POST", url=url, body=body, token=token, at=int(time.time()), jti=jti)


def _json(value: Mapping[str, Any]) -> bytes:
    return rfc8785.dumps(dict(value))
