"""DPoP (RFC 9449) around any OAuth provider for `httpx2`, such as those of the MCP SDK.

They know bearer tokens alone.

    auth = DPoPAuth(OAuthClientProvider(url, metadata, storage, open_page, come_back), key)
    async with httpx2.AsyncClient(auth=auth) as http, Client(streamable_http_client(url, http_client=http)) as client:
        ...

Discovery, registration, consent and renewal stay the provider's own.
"""

from __future__ import annotations

import json
import re
import secrets
import time
from collections import OrderedDict
from typing import TYPE_CHECKING, Any, Final, Literal, NoReturn, TypeVar

import httpx2

from capabilities.keys import keys
from capabilities.proof.dpop import NONCE_BYTES, prove_plain
from capabilities.proof.proof import token_digest
from capabilities.values.errors import BadKeyError

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Callable

    from capabilities.keys.keys import PrivateKey

    Side = Literal["token", "resource"]

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")
NONCES: Final = 64
"""Nonces that are kept: the latest of each origin, once as a token endpoint and once as a resource."""
BOUND: Final = 256
"""Access tokens of which it is remembered whether they are bound to the key."""
_JTI_BYTES: Final = 18
_FORM: Final = "application/x-www-form-urlencoded"
_GRANT: Final = re.compile(rb"(?:^|&)grant_type=")
_NONCE: Final = re.compile(rf"[\x21\x23-\x5b\x5d-\x7e]{{1,{NONCE_BYTES}}}", re.ASCII)
"""Nonces as RFC 9449 section 8.1 spells them, of bounded length."""
_WANTED: Final = re.compile(r"\bdpop\b.*\berror\s*=\s*\"?use_dpop_nonce\b", re.IGNORECASE | re.DOTALL)
_ENTITY: Final = frozenset({"content-encoding", "content-length", "transfer-encoding"})


class DPoPAuth(httpx2.Auth):
    """Binds the access tokens that another provider obtains to a key, and proves the key with each request.

    Each token request has a proof. A token that the server then gives as `DPoP` is presented as such, with a proof; one
    that it gives as `Bearer` stays a bearer token. A nonce that a server asks for is kept for it, and the refused
    request is sent once more.

    Args:
        inner: obtains tokens and presents them as `Bearer`.
        key: Ed25519 or P-256, as the authorization server takes it; the same one for as long as its refresh tokens are.
        now: wall clock, seconds since the epoch.
    """

    def __init__(self, inner: httpx2.Auth, key: PrivateKey, *, now: Callable[[], float] = time.time) -> None:
        self._inner = inner
        self._key = key
        self._thumbprint = keys.thumbprint(keys.public_raw(key))
        self._now = now
        self._nonces: OrderedDict[tuple[Side, str], str] = OrderedDict()
        self._bound: OrderedDict[str, bool] = OrderedDict()

    def sync_auth_flow(self, request: httpx2.Request) -> NoReturn:  # noqa: ARG002 - the form of httpx2
        """Refuses: the SDK's providers are for asynchronous clients, and would send the request bare.

        Raises:
            RuntimeError: always.
        """
        raise RuntimeError("DPoPAuth is for httpx2.AsyncClient")

    async def async_auth_flow(self, request: httpx2.Request) -> AsyncGenerator[httpx2.Request, httpx2.Response]:
        """The requests of the inner provider, those for tokens and with tokens signed."""
        await request.aread()
        flow = self._inner.async_auth_flow(request)
        try:
            outgoing = await anext(flow)
            while True:
                side = await self._side(outgoing, request)
                sent = self._sign(outgoing, side)
                response = yield outgoing
                if await self._again(response, outgoing, side, sent):
                    self._sign(outgoing, side)
                    response = yield outgoing
                    self._keep_nonce(response, outgoing, side)
                if side == "token":
                    response = await self._bearer(response)
                outgoing = await flow.asend(response)
        except StopAsyncIteration:
            return
        finally:
            await flow.aclose()

    async def _side(self, outgoing: httpx2.Request, request: httpx2.Request) -> Side | None:
        """The side of the server that a request is for; None for discovery, registration and the like."""
        if outgoing is request:
            return "resource"
        form = outgoing.headers.get("content-type", "").partition(";")[0].strip().lower() == _FORM
        asks = outgoing.method == "POST" and form and _GRANT.search(await outgoing.aread()) is not None
        return "token" if asks else None

    def _sign(self, outgoing: httpx2.Request, side: Side | None) -> str | None:
        """Puts a fresh proof on a request that wants one; the nonce in it."""
        outgoing.headers.pop("DPoP", None)  # of an earlier sending, perhaps to where a redirect came from
        token = _presented(outgoing) if side == "resource" else None
        if side is None or (side == "resource" and (token is None or not self._is_bound(token))):
            return None
        nonce = self._nonces.get((side, _origin(outgoing)))
        outgoing.headers["DPoP"] = prove_plain(
            self._key,
            method=outgoing.method,
            url=str(outgoing.url.copy_with(query=None, fragment=None, userinfo=b"")),
            token=token,
            nonce=nonce,
            at=int(self._now()),
            jti=secrets.token_urlsafe(_JTI_BYTES),
        )
        if token is not None:
            outgoing.headers["Authorization"] = f"DPoP {token}"
        return nonce

    async def _again(
        self, response: httpx2.Response, outgoing: httpx2.Request, side: Side | None, sent: str | None
    ) -> bool:
        """True where the server refused the request for want of the nonce that it now gives."""
        given = self._keep_nonce(response, outgoing, side)
        if given is None or given == sent or "DPoP" not in outgoing.headers:
            return False
        if side == "resource":
            challenges = response.headers.get_list("www-authenticate")
            return response.status_code == 401 and any(_WANTED.search(each) for each in challenges)
        return response.status_code == 400 and _object(await response.aread()).get("error") == "use_dpop_nonce"

    def _keep_nonce(self, response: httpx2.Response, outgoing: httpx2.Request, side: Side | None) -> str | None:
        """Keeps the nonce that an answer gives for the next request to its origin; None where it gives none."""
        given: str | None = response.headers.get("dpop-nonce")
        if side is None or given is None or _NONCE.fullmatch(given) is None:
            return None
        _keep(self._nonces, (side, _origin(outgoing)), given, most=NONCES)
        return given

    async def _bearer(self, response: httpx2.Response) -> httpx2.Response:
        """An answer that gives a bound token, as one that gives a bearer token; any other as it is."""
        if not response.is_success:
            return response
        told = _object(await response.aread())
        token, kind = told.get("access_token"), told.get("token_type")
        if not isinstance(token, str) or not isinstance(kind, str):
            return response
        bound = kind.lower() == "dpop"
        _keep(self._bound, token_digest(token), bound, most=BOUND)
        if not bound:
            return response
        return httpx2.Response(
            response.status_code,
            headers=[pair for pair in response.headers.multi_items() if pair[0].lower() not in _ENTITY],
            content=json.dumps({**told, "token_type": "Bearer"}).encode(),
            request=response.request,
            extensions=response.extensions,
        )

    def _is_bound(self, token: str) -> bool:
        """True for a token that was given as bound, or else names this key.

        One out of a storage of an earlier time that nobody can read is taken for bound, as this class had it bound.
        """
        known = self._bound.get(token_digest(token))
        if known is not None:
            return known
        parts = token.split(".")
        if len(parts) != 3:
            return True
        try:
            named = _object(keys.unb64u(parts[1])).get("cnf")
        except BadKeyError:
            return True
        return isinstance(named, dict) and named.get("jkt") == self._thumbprint


def _presented(request: httpx2.Request) -> str | None:
    """The access token that a request presents."""
    scheme, _, token = request.headers.get("authorization", "").partition(" ")
    return token.strip() or None if scheme.lower() in {"bearer", "dpop"} else None


def _origin(request: httpx2.Request) -> str:
    url = request.url
    return f"{url.scheme}://{url.netloc.decode('ascii')}"


def _object(raw: bytes) -> dict[str, Any]:
    """The JSON object, or an empty one."""
    try:
        found = json.loads(raw)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _keep(kept: OrderedDict[_Key, _Value], key: _Key, value: _Value, *, most: int) -> None:
    """Keeps the latest; the oldest goes."""
    kept[key] = value
    kept.move_to_end(key)
    if len(kept) > most:
        kept.popitem(last=False)
