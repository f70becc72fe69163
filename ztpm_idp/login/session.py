"""Session of a person in a browser: the port that pages use.

The cookie holds 256 random bits; the store has their SHA-256 and everything else, so that any worker knows the session
and a stolen database opens none. It is over with its time, with the person, and with the key or login that began it.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final
from urllib.parse import urlencode

from fastapi.responses import RedirectResponse

from capabilities.keys.keys import b64u, unb64u
from capabilities.values.errors import BadKeyError
from ztpm_idp.domain.locks import WHOLE, Locks
from ztpm_idp.domain.login.commands import LogIn, LogOut
from ztpm_idp.domain.parties import RegisteredPerson, Standing

if TYPE_CHECKING:
    from fastapi import Request
    from fastapi.responses import Response

    from ztpm_idp.domain.login.records import Authentication, Session
    from ztpm_idp.domain.parties import PersonRole
    from ztpm_idp.provider.done import OneUse
    from ztpm_idp.provider.provider import Provider

COOKIE: Final = "__Host-ztpm-session"
"""Name of the session's cookie; browsers keep the prefix to this host, this path, and TLS (or loopback)."""
BACK: Final = "__Host-ztpm-back"
"""Name of the cookie with the page that a person goes back to once logged in."""
BACK_S: Final = 600
"""Seconds for which that page is remembered."""
BACK_BYTES: Final = 2_048
"""Longest address to go back to: that of an authorization request with its parameters."""
SEEN_MS: Final = 60_000
"""Milliseconds after which a session's last request is written again: not with each page."""
_ID: Final = re.compile(r"[A-Za-z0-9_-]{43}", re.ASCII)
_BACK: Final = re.compile(r"/[A-Za-z0-9._~/-]*(\?[A-Za-z0-9._~/?:@!$&'()*+,;=%-]*)?", re.ASCII)
_LOCKS: Final = Locks(frozenset({WHOLE}), frozenset())
"""Locks of a session's last request: beside all but what runs alone, since no command is decided on it."""
NO_STORE: Final = {"Cache-Control": "no-store"}


@dataclass(frozen=True, slots=True)
class SignedIn:
    """Person who is logged in in the browser that sent a request.

    Attributes:
        person: active, with at most the roles of the session.
        at_ms: when the person was authenticated, wall clock.
        acr: authentication context class, as a login provider said it; else "".
        amr: authentication methods (RFC 8176).
        session_id: SHA-256 (hex) of what the cookie holds; safe to record.
        ends_ms: the session's end in any case, wall clock.
        how: the authentication, with its method and what showed it.
    """

    person: RegisteredPerson
    at_ms: int
    acr: str
    amr: tuple[str, ...]
    session_id: str
    ends_ms: int
    how: Authentication

    def fresh(self, fresh_s: int, *, at_ms: int) -> bool:
        """True where the person was authenticated at most so many seconds before `at_ms`."""
        return 0 <= at_ms - self.at_ms <= fresh_s * 1_000


async def signed_in(request: Request, *, prolongs: bool = True) -> SignedIn | None:
    """The person who is logged in in this browser, now; None where nobody is.

    Args:
        request: with the cookie.
        prolongs: a person's act, before which the session was not silent; False: a page looked by itself.

    Raises:
        StoreUnavailableError: it cannot be said.
    """
    held = cookie(request, COOKIE)
    if held is None or not _ID.fullmatch(held):
        return None
    provider, session_id = _provider(request), digest(held).hex()
    at_ms = provider.now_ms()
    async with provider.store.read() as view:
        session = await view.sessions.session(session_id)
        person = None if session is None else await view.party(session.person)
    if session is None or session.over(at_ms) or not isinstance(person, RegisteredPerson):
        return None
    if person.standing is not Standing.ACTIVE:
        return None
    if prolongs and at_ms - session.seen_ms >= SEEN_MS:
        async with provider.store.write(_LOCKS) as transaction:
            await transaction.sessions.seen(session_id, at_ms=at_ms)
    return _signed_in(session, person)


def to_login(request: Request, *, back_to: str, fresh_s: int) -> RedirectResponse:
    """Sends the browser to the login page, and afterwards to a page of this provider.

    Args:
        request: of the page that needs a person.
        back_to: path and query of the page to go back to, below the issuer's path, as `/ztpm/authorize?...`.
        fresh_s: greatest age of the login, in seconds; 0: the person logs in again in any case.

    Raises:
        ValueError: `back_to` is no page of this provider.
    """
    prefix = prefix_of(_provider(request))
    if not is_own_page(back_to, prefix):
        raise ValueError("back_to is a path below the issuer's")
    query = urlencode({"back_to": back_to, "fresh_s": max(0, fresh_s)})
    return RedirectResponse(f"{prefix}/login?{query}", status_code=303, headers=NO_STORE)


async def begin(
    request: Request,
    response: Response,
    *,
    person: str,
    how: Authentication | None = None,
    offer: bytes | None = None,
    roles: frozenset[PersonRole] | None = None,
    once: OneUse | None = None,
) -> None:
    """Begins a session of this person in this browser, with a new id; the one before is over.

    Args:
        request: with which the person logs in.
        response: gets the cookie.
        person: id of an active person, who was authenticated just now.
        how: the authentication; None: the offer says it.
        offer: digest of the login link that was opened, which is spent by this.
        roles: most that the session may have; None: the person's own.
        once: use of what authenticated the person, in the commit that begins the session.

    Raises:
        Problem: the person may not log in, the link is over, or `once` was used before (`REPLAYED`).
    """
    provider, fresh = _provider(request), secrets.token_urlsafe(32)
    before = await signed_in(request)
    former = None if before is None else before.session_id
    await provider.run(LogIn(person, digest(fresh).hex(), how, offer, roles, former), actor=person, once=once)
    set_cookie(response, COOKIE, fresh, last_s=None)


async def end(request: Request, response: Response) -> None:
    """Ends the session of this browser, if there is one."""
    before = await signed_in(request)
    if before is not None:
        await _provider(request).run(LogOut(before.person.id, before.session_id), actor=before.person.id)
    set_cookie(response, COOKIE, "", last_s=0)


def is_own_page(path: str, prefix: str) -> bool:
    """True for the path and query of a page below the issuer's path, in one spelling that leads nowhere else."""
    if len(path) > BACK_BYTES or not _BACK.fullmatch(path) or not path.startswith(f"{prefix}/"):
        return False
    return not any(part in {"", ".", ".."} for part in path.partition("?")[0][1:].split("/"))


def back_of(request: Request) -> str:
    """The page that this browser goes back to once its person is logged in: the remembered one, or the account's."""
    prefix = prefix_of(_provider(request))
    try:
        held = unb64u(cookie(request, BACK) or "").decode("ascii")
    except (BadKeyError, UnicodeDecodeError):
        held = ""
    return held if is_own_page(held, prefix) else f"{prefix}/login/account"


def remember_back(response: Response, back_to: str) -> None:
    """Has the browser remember the page that its person goes back to once logged in."""
    set_cookie(response, BACK, b64u(back_to.encode()), last_s=BACK_S)


def set_cookie(response: Response, name: str, value: str, *, last_s: int | None) -> None:
    """Sets a cookie that only this host gets, over TLS or loopback, and no script reads.

    Args:
        response: gets it.
        name: with the prefix `__Host-`.
        value: of the cookie's own characters.
        last_s: seconds until the browser forgets it; None: with its own end.
    """
    response.set_cookie(name, value, max_age=last_s, path="/", secure=True, httponly=True, samesite="lax")


def cookie(request: Request, name: str) -> str | None:
    """The value of a cookie that occurs once; None without one, or with two, which two readers would tell apart."""
    found = [
        value.strip().strip('"')
        for header in request.headers.getlist("cookie")
        for held, _, value in (part.partition("=") for part in header.split(";"))
        if held.strip() == name
    ]
    return found[0] if len(found) == 1 and found[0] else None


def digest(held: str) -> bytes:
    """The SHA-256 of a secret that a browser holds, which is all that is stored of it."""
    return hashlib.sha256(held.encode()).digest()


def seal(secret: bytes, purpose: str, kept: str) -> str:
    """The text for a browser to keep, signed, so that it comes back as it was or counts for nothing.

    Args:
        secret: shared by all workers.
        purpose: name of the cookie; a text sealed for one counts in no other.
        kept: the text.
    """
    body = b64u(kept.encode())
    return f"{body}.{b64u(_mac(secret, purpose, body))}"


def unseal(secret: bytes, purpose: str, held: str) -> str | None:
    """The text that was sealed for this purpose, or None."""
    body, _, said = held.partition(".")
    try:
        return unb64u(body).decode() if hmac.compare_digest(unb64u(said), _mac(secret, purpose, body)) else None
    except (BadKeyError, UnicodeDecodeError):
        return None


def _mac(secret: bytes, purpose: str, body: str) -> bytes:
    return hmac.new(secret, f"{purpose} {body}".encode(), hashlib.sha256).digest()


def prefix_of(provider: Provider) -> str:
    """The path of the issuer, below which every page is."""
    return "/" + provider.settings.issuer.split("/", 3)[3]


def _signed_in(session: Session, person: RegisteredPerson) -> SignedIn:
    how = session.how
    within = replace(person, roles=person.roles & session.roles)
    return SignedIn(within, how.at_ms, how.acr, how.amr, session.session_id, session.ends_ms, how)


def _provider(request: Request) -> Provider:
    provider: Provider = request.app.state.provider
    return provider
