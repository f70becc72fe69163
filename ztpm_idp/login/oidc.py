"""Logging in at an OpenID provider: authorization code with PKCE, and an identity token that is verified in full.

Everything that says where to go or whom to believe comes from our settings: the issuer is fixed, its discovery
document must name it, and neither algorithm nor key set is chosen by a token. A login begun in one browser ends in it
(state), at the provider where it began (an address of ours for each provider, and `iss` of RFC 9207), for the code that
it asked for (PKCE with S256) and the token that answers it (nonce).
"""

from __future__ import annotations

import hmac
import json
import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

import httpx2
from authlib.integrations.base_client.errors import OAuthError
from authlib.integrations.httpx_client import AsyncOAuth2Client
from authlib.oidc.core import CodeIDToken
from joserfc import jwt
from joserfc.errors import InvalidKeyIdError, JoseError
from joserfc.jwk import KeySet
from joserfc.jws import JWSRegistry

from ztpm_idp.domain.login.records import ABSOLUTE_MS, Authentication, Method
from ztpm_idp.login_settings import is_loopback

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from ztpm_idp.domain.parties import PersonRole
    from ztpm_idp.login_settings import LoginProvider

METADATA_S: Final = 3_600
"""Seconds after which discovery document and key set are fetched again."""
KEYS_S: Final = 60
"""Least seconds between two fetches of a key set for keys that it does not name."""
TIMEOUT_S: Final = 5.0
"""Longest wait for each step of a request to a provider: a person looks at an empty page meanwhile."""
SKEW_S: Final = 30
"""Seconds by which a provider's clock may differ from ours."""
ATTEMPT_S: Final = 600
"""Seconds that a person has for logging in at the provider."""
MAX_AGE_S: Final = ABSOLUTE_MS // 1_000
"""Greatest age of a login at the provider, in seconds, as of a session; a page may ask for less."""
TOKEN_BYTES: Final = 16_384
"""Longest identity token."""
_ENDPOINTS: Final = ("authorization_endpoint", "token_endpoint", "jwks_uri")


class LoginFailedError(Exception):
    """A login did not come to its end.

    Attributes:
        why: for people, in our own words; no text of the provider or of the address.
        reachable: False where the provider did not answer as a provider should.
    """

    def __init__(self, why: str, *, reachable: bool = True) -> None:
        super().__init__(why)
        self.why = why
        self.reachable = reachable


@dataclass(frozen=True, slots=True)
class Attempt:
    """A login on its way, as the browser keeps it under the store's secret.

    Attributes:
        provider: its name.
        state, nonce, verifier: fresh randomness, as RFC 6749, OpenID Connect Core and RFC 7636 use them.
        begun_s: when it began, seconds since the epoch.
        max_age_s: greatest age of the login at the provider, in seconds; 0: the person logs in again there.
    """

    provider: str
    state: str
    nonce: str
    verifier: str
    begun_s: int
    max_age_s: int

    def to_text(self) -> str:
        """Its text, for `from_text`."""
        return json.dumps({name: getattr(self, name) for name in self.__slots__})

    @classmethod
    def from_text(cls, text: str) -> Attempt:
        """The attempt that a text of ours states."""
        return cls(**json.loads(text))


@dataclass(frozen=True, slots=True)
class LoggedIn:
    """Person as an OpenID provider knows it, authenticated there.

    Attributes:
        login: issuer and subject, with a space between.
        how: the authentication.
        roles: most that the session may have; None: the provider's groups are not asked.
    """

    login: str
    how: Authentication
    roles: frozenset[PersonRole] | None


class OpenIdProvider:
    """An OpenID provider at which people may log in.

    Args:
        configured: settings, and our secret there.
        redirect_uri: our address at which its answers arrive, as it is registered there.
        now: wall clock, seconds since the epoch.
        transport: in place of the network's, for tests.
    """

    def __init__(
        self,
        configured: LoginProvider,
        *,
        redirect_uri: str,
        now: Callable[[], float],
        transport: httpx2.AsyncBaseTransport | None = None,
    ) -> None:
        self.configured = configured
        self.name = configured.stated.name
        self._redirect_uri = redirect_uri
        self._now = now
        self._transport = transport
        self._metadata: dict[str, Any] = {}
        self._metadata_at = 0.0
        self._keys: KeySet | None = None
        self._keys_at = 0.0

    @property
    def origin(self) -> str:
        """Origin of the provider, to which the login page's form leads."""
        parts = urlsplit(self.configured.stated.issuer)
        return f"{parts.scheme}://{parts.netloc}"

    async def begin(self, *, max_age_s: int) -> tuple[str, Attempt]:
        """The address at which the person logs in, and the attempt for the browser to keep.

        Raises:
            LoginFailedError: the provider is not to be reached, or is not the one that is configured.
        """
        metadata, stated = await self._discovered(), self.configured.stated
        attempt = Attempt(
            provider=self.name,
            state=secrets.token_urlsafe(32),
            nonce=secrets.token_urlsafe(32),
            verifier=secrets.token_urlsafe(48),
            begun_s=int(self._now()),
            max_age_s=max_age_s,
        )
        more = {"prompt": "login"} if max_age_s == 0 else {}
        more |= {"acr_values": " ".join(stated.acr_values)} if stated.acr_values else {}
        async with self._client() as client:
            url, _ = client.create_authorization_url(
                metadata["authorization_endpoint"],
                state=attempt.state,
                code_verifier=attempt.verifier,
                nonce=attempt.nonce,
                max_age=max_age_s,
                **more,
            )
        return str(url), attempt

    async def finish(self, attempt: Attempt, answer: Mapping[str, str]) -> LoggedIn:
        """The person who logged in, by the provider's answer to this attempt.

        Args:
            attempt: as this browser kept it.
            answer: parameters of the address that the browser was sent back to, each once.

        Raises:
            LoginFailedError: the answer is no answer to it, or its token does not verify.
        """
        metadata, stated = await self._discovered(), self.configured.stated
        # 1. It answers this attempt, in time, and comes from this provider (RFC 9207 section 2.4).
        if attempt.provider != self.name or not hmac.compare_digest(answer.get("state", ""), attempt.state):
            raise LoginFailedError("the answer is for another login")
        if not 0 <= self._now() - attempt.begun_s <= ATTEMPT_S:
            raise LoginFailedError(f"the login took longer than {ATTEMPT_S // 60} minutes")
        named = answer.get("iss")
        if named is None and metadata.get("authorization_response_iss_parameter_supported") is True:
            raise LoginFailedError("the answer does not say which provider it is of")
        if named is not None and named != stated.issuer:
            raise LoginFailedError("the answer is of another provider")
        if "error" in answer:
            raise LoginFailedError("the provider did not log the person in")
        # 2. Its code is good for a token, with our secret and the verifier of this attempt.
        try:
            async with self._client() as client:
                answered = await client.fetch_token(
                    metadata["token_endpoint"],
                    grant_type="authorization_code",
                    code=answer.get("code", ""),
                    code_verifier=attempt.verifier,
                )
        except OAuthError:
            raise LoginFailedError("the provider took the code for none of its own") from None
        except (httpx2.HTTPError, ValueError, TypeError, KeyError, AttributeError):
            raise LoginFailedError("the provider gave no token", reachable=False) from None
        text = answered.get("id_token") if isinstance(answered, dict) else None
        if not isinstance(text, str) or len(text) > TOKEN_BYTES:
            raise LoginFailedError("the provider gave no identity token", reachable=False)
        # 3. The identity token is the provider's, for us, for this attempt, and new.
        return self._person(await self._claims(text, attempt, answered), attempt)

    async def _claims(self, text: str, attempt: Attempt, answered: Mapping[str, Any]) -> Mapping[str, Any]:
        stated = self.configured.stated
        registry = JWSRegistry(algorithms=list(stated.algorithms))
        try:
            try:
                token = jwt.decode(text, await self._key_set(), registry=registry)
            except InvalidKeyIdError:
                token = jwt.decode(text, await self._key_set(unknown=True), registry=registry)
            claims = CodeIDToken(
                token.claims,
                token.header,
                options={
                    "iss": {"essential": True, "value": stated.issuer},
                    "aud": {"essential": True, "value": stated.client_id},
                    "sub": {"essential": True},
                },
                params={
                    "nonce": attempt.nonce,
                    "client_id": stated.client_id,
                    "access_token": answered.get("access_token"),
                    "max_age": MAX_AGE_S,
                },
            )
            claims.validate(now=int(self._now()), leeway=SKEW_S)
        except (JoseError, ValueError, TypeError, KeyError):
            raise LoginFailedError("the identity token does not verify") from None
        return dict(claims)

    def _person(self, claims: Mapping[str, Any], attempt: Attempt) -> LoggedIn:
        stated, now = self.configured.stated, self._now()
        subject, at = claims["sub"], claims.get("auth_time")
        if not is_subject(subject):
            raise LoginFailedError("the identity token names nobody")
        # Where a new login was asked for it is newer than the attempt; else it has at most the age that was asked for.
        oldest = attempt.begun_s if attempt.max_age_s == 0 else now - attempt.max_age_s
        if type(at) is not int or not oldest - SKEW_S <= at <= now + SKEW_S:
            raise LoginFailedError("the provider does not say that the person logged in recently enough")
        acr, amr = claims.get("acr", ""), claims.get("amr", [])
        if stated.acr_values and acr not in stated.acr_values:
            raise LoginFailedError("the login was weaker than what was asked for")
        kept = [each for each in amr if _is_word(each)] if isinstance(amr, list) else []
        how = Authentication(
            method=Method.OIDC,
            at_ms=int(min(at, now) * 1_000),
            acr=acr if _is_word(acr) else "",
            amr=tuple(kept[:16]),
            login=f"{stated.issuer} {subject}",
        )
        return LoggedIn(how.login, how, self._roles(claims))

    def _roles(self, claims: Mapping[str, Any]) -> frozenset[PersonRole] | None:
        if self.configured.stated.groups_claim is None:
            return None
        named = claims.get(self.configured.stated.groups_claim, [])
        return (
            self.configured.roles(each for each in named if isinstance(each, str))
            if isinstance(named, list)
            else frozenset()
        )

    async def _discovered(self) -> dict[str, Any]:
        """The discovery document, when it is that of the configured issuer."""
        if self._metadata and 0 <= self._now() - self._metadata_at < METADATA_S:
            return self._metadata
        issuer = self.configured.stated.issuer
        found = await self._fetched(f"{issuer.rstrip('/')}/.well-known/openid-configuration")
        if found.get("issuer") != issuer:
            raise LoginFailedError("the provider calls itself by another name", reachable=False)
        for name in _ENDPOINTS:
            parts = urlsplit(str(found.get(name, "")))
            if parts.scheme != "https" and not (parts.scheme == "http" and is_loopback(parts.hostname or "")):
                raise LoginFailedError("the provider names an address without TLS", reachable=False)
        methods = found.get("code_challenge_methods_supported", ["S256"])
        if not isinstance(methods, list) or "S256" not in methods:
            raise LoginFailedError("the provider does not know PKCE with S256", reachable=False)
        self._metadata, self._metadata_at, self._keys = found, self._now(), None
        return found

    async def _key_set(self, *, unknown: bool = False) -> KeySet:
        """The provider's keys; with `unknown`, fetched again where that was not done just now."""
        if self._keys is None or (unknown and not 0 <= self._now() - self._keys_at < KEYS_S):
            found = await self._fetched(str(self._metadata["jwks_uri"]))
            try:
                # A private or shared key in a public set is none that a signature may be checked with.
                public = [
                    key for key in found["keys"] if isinstance(key, dict) and key.get("kty") in {"RSA", "EC", "OKP"}
                ]
                self._keys = KeySet.import_key_set({"keys": public})
            except (JoseError, ValueError, TypeError, KeyError):
                raise LoginFailedError("the provider's keys cannot be read", reachable=False) from None
            self._keys_at = self._now()
        return self._keys

    async def _fetched(self, url: str) -> dict[str, Any]:
        try:
            async with httpx2.AsyncClient(**self._ways()) as client:
                answer = await client.get(url)
                found = answer.json() if answer.status_code == 200 else None
        except (httpx2.HTTPError, httpx2.InvalidURL, ValueError):
            found = None
        if not isinstance(found, dict):
            raise LoginFailedError("the provider does not answer", reachable=False)
        return found

    def _client(self) -> AsyncOAuth2Client:
        secret = self.configured.secret
        return AsyncOAuth2Client(
            client_id=self.configured.stated.client_id,
            client_secret=secret,
            token_endpoint_auth_method="none" if secret is None else "client_secret_basic",
            scope=" ".join(["openid", *self.configured.stated.scopes]),
            redirect_uri=self._redirect_uri,
            code_challenge_method="S256",
            **self._ways(),
        )

    def _ways(self) -> dict[str, Any]:
        """No redirect, no proxy of the environment, no endless wait."""
        return {
            "transport": self._transport or httpx2.AsyncHTTPTransport(),
            "timeout": TIMEOUT_S,
            "follow_redirects": False,
            "trust_env": False,
        }


def is_subject(subject: object) -> bool:
    """True for what OpenID Connect Core section 2 lets a subject be, without control characters and blanks."""
    return isinstance(subject, str) and 0 < len(subject) <= 255 and all("!" <= each <= "~" for each in subject)


def _is_word(value: object) -> bool:
    return isinstance(value, str) and 0 < len(value) <= 128 and all("!" <= each <= "~" for each in value)
