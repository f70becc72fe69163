"""Credentials as an agent presents them with a call: its own, or wrong in one thing."""

from __future__ import annotations

import secrets
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Final, Literal, assert_never

import httpx2

from capabilities.keys import keys
from capabilities.proof.proof import prove
from evaluation.redteam.acts import forged_tokens
from evaluation.redteam.acts.narrowing import Narrowing, restriction_of
from evaluation.redteam.desk.lending import lent_at_desk
from ztpm.stage.lending import lent
from ztpm_idp.client import ProofAuth

if TYPE_CHECKING:
    from collections.abc import Generator

    from capabilities.values.scope import Scope
    from evaluation.redteam.guarded import GuardedArena
    from evaluation.redteam.parts import Place
    from ztpm_idp.client import Agent

Presents = Literal[
    "own", "nothing", "no proof", "bearer", "stolen", "old proof", "early proof", "proof for another place",
    "proof for another body", "proof for another method", "proof of no token", "token for another place", "expired",
    "not yet valid", "self-attested", "own key as attester", "self-made", "altered", "flipped", "spliced",
]  # fmt: skip
"""Credentials of a call: `own` is the caller's token with its proof, each other is wrong as named."""
PROOF_OFF_S: Final = 120
"""Age of an old proof, and lead of an early one: proofs live 30 s, with 5 s of skew."""
SHORT_S: Final = 2
"""Life of a token that is used when it is over."""
LATER_S: Final = 300


class WrongProof(httpx2.Auth):
    """Signs each request for another method, place or body, or without the token.

    Args:
        key: of the caller.
        token: its text.
        wrong: method, place, body or token.
        elsewhere: URL of another place.
    """

    requires_request_body = True

    def __init__(self, key: object, token: str, wrong: str, elsewhere: str) -> None:
        self._key, self._token, self._wrong, self._elsewhere = key, token, wrong, elsewhere

    def auth_flow(self, request: httpx2.Request) -> Generator[httpx2.Request, httpx2.Response, None]:
        """The request with a fresh proof that is wrong in one thing."""
        wrong = self._wrong
        request.headers["DPoP"] = prove(
            self._key,  # type: ignore[arg-type]  # the key of an agent
            method="GET" if wrong == "method" else request.method,
            url=self._elsewhere if wrong == "place" else str(request.url),
            body=b"{}" if wrong == "body" else request.content,
            token=None if wrong == "token" else self._token,
            at=int(time.time()),
            jti=secrets.token_urlsafe(18),
        )
        request.headers["Authorization"] = f"DPoP {self._token}"
        yield request


class Headers(httpx2.Auth):
    """Puts fixed headers on each request.

    Args:
        headers: by name.
    """

    def __init__(self, headers: dict[str, str]) -> None:
        self._headers = headers

    def auth_flow(self, request: httpx2.Request) -> Generator[httpx2.Request, httpx2.Response, None]:
        """The request with the headers."""
        request.headers.update(self._headers)
        yield request


def whole(arena: GuardedArena, place: Place, *, delegates: frozenset[str] = frozenset()) -> Scope:
    """All that a person ever lends at a place, from now on."""
    if place == "arm":
        return lent(arena.stage, *delegates)
    return lent_at_desk(arena.desk.url, delegates=delegates, now=int(time.time()))


def credentials(
    arena: GuardedArena, caller: str, place: Place, presents: Presents, *, of: str = "",
    wider: Narrowing | None = None, change: tuple[str, ...] = (),
) -> httpx2.Auth:  # fmt: skip
    """Credentials of a caller for one call.

    Args:
        arena: the cell.
        caller: role.
        place: where it calls.
        presents: which credentials.
        of: role out of whose token they are made; the caller itself, or for a forged hop the orchestrator, if empty.
        wider: restriction of a forged hop; that of nothing if None.
        change: text before and after, or the part or way of a change.
    """
    agent = arena.agent(caller)
    elsewhere: Place = "desk" if place == "arm" else "arm"
    match presents:
        case "own":
            return agent.auth(arena.token(caller, place))
        case "nothing":
            return Headers({})
        case "no proof":
            return Headers({"Authorization": f"DPoP {arena.token(of or caller, place)}"})
        case "bearer":
            return Headers({"Authorization": f"Bearer {arena.token(of or caller, place)}"})
        case "stolen":
            return agent.auth(arena.token(of or "orchestrator", place))
        case "old proof" | "early proof":
            off_s = -PROOF_OFF_S if presents == "old proof" else PROOF_OFF_S
            return ProofAuth(agent.key, arena.token(caller, place), now=lambda: time.time() + off_s)
        case "proof for another place" | "proof for another body" | "proof for another method" | "proof of no token":
            wrong = presents.rsplit(" ", 1)[1]
            return WrongProof(agent.key, arena.token(caller, place), wrong, arena.url(elsewhere))
        case "token for another place":
            return agent.auth(arena.token(caller, elsewhere))
        case "expired" | "not yet valid" | "self-attested" | "own key as attester" | "self-made":
            return agent.auth(_made(arena, agent, place, presents, of=of or "orchestrator", wider=wider))
        case "altered":
            return agent.auth(forged_tokens.altered(arena.token(of or caller, place), *change))
        case "flipped":
            return agent.auth(forged_tokens.flipped(arena.token(of or caller, place), change[0]))
        case "spliced":
            own, other = arena.token(caller, place), arena.token(of or "orchestrator", place)
            return agent.auth(forged_tokens.spliced(own, other, change[0]))
        case _:
            assert_never(presents)


def _made(
    arena: GuardedArena, agent: Agent, place: Place, presents: Presents, *, of: str, wider: Narrowing | None
) -> str:
    """Token that is lent, and out of its time; or that nobody has lent."""
    scope, now = whole(arena, place), int(time.time())
    if presents in {"expired", "not yet valid"}:
        window = (now - 1, now + SHORT_S) if presents == "expired" else (now + LATER_S, now + 2 * LATER_S)
        timed = replace(scope, not_before=window[0], not_after=window[1])
        token = arena.stage.person("alice").issue(agent, timed, purpose="a short task").token
        if presents == "expired":
            time.sleep(SHORT_S)  # the time that it takes to be over
        return token
    if presents == "self-made":
        issuer = arena.stage.cell.addresses.issuer
        root_key_id = next(iter(arena.stage.trust.roots))
        return forged_tokens.minted(agent, scope, sponsor="alice", issuer=issuer, root_key_id=root_key_id)
    attester = agent.key if presents == "own key as attester" else keys.generate()
    return forged_tokens.grafted(
        arena.token(of, place), agent, restriction_of(arena, wider or Narrowing()),
        audience=arena.url(place), trust=arena.stage.trust, attester=attester,  # type: ignore[arg-type]  # Ed25519
    )  # fmt: skip
