"""Platforms and publishers as a configuration states them, read strictly. Issuers and addresses of keys stand here."""

from __future__ import annotations

from typing import Annotated, Final, Literal, Self
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, model_validator

from capabilities.keys.keys import check_raw, unb64u
from capabilities.values import text
from capabilities.values.errors import BadKeyError, CapabilityError
from ztpm_idp.keys.key_files import UnsafeError

URL_BYTES: Final = 256
"""Longest address (as `Caps.text_bytes`)."""
PLATFORMS: Final = 16
"""Ours: most platforms of one provider."""
PUBLISHERS: Final = 64
"""Ours: most publishers of one provider."""
REFRESH_S: Final = 300
"""Time between two looks at an address, where the bundle itself gives no hint (SPIRE's hint is 300 s, too)."""
KEPT_S: Final = 86_400
"""Time for which the last good keys count while none come: a night, not a week."""
ACCOUNT_TOKEN_S: Final = 3_607
"""Life of the token that a kubelet asks for unless told otherwise (Kubernetes, service account admission)."""

_Path = Annotated[str, Field(min_length=1)]


class _Source(BaseModel):
    """Source of keys: a file, or addresses that are asked again and again.

    Attributes:
        ca_file: PEM file of the authorities whose servers are believed; needed with an address.
        refresh_s: time between two questions; a bundle's own hint comes before it.
        kept_s: time for which the last good answer counts while there is no other.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, hide_input_in_errors=True)

    ca_file: _Path | None = None
    refresh_s: Annotated[int, Field(ge=10, le=86_400)] = REFRESH_S
    kept_s: Annotated[int, Field(ge=60, le=604_800)] = KEPT_S


class SpiffePlatform(_Source):
    """A SPIFFE trust domain, such as that of a SPIRE server.

    Attributes:
        trust_domain: its name.
        bundle_file, bundle_url: its bundle, in the SPIFFE format; one of the two.
    """

    kind: Literal["spiffe"]
    trust_domain: str
    bundle_file: _Path | None = None
    bundle_url: str | None = None

    @model_validator(mode="after")
    def _safe(self) -> Self:
        if not text.is_trust_domain(self.trust_domain):
            raise UnsafeError("platforms.trust_domain", "not the name of a trust domain")
        if (self.bundle_file is None) == (self.bundle_url is None):
            raise UnsafeError("platforms.bundle_file", "exactly one of bundle_file and bundle_url")
        _check_address("platforms.bundle_url", self.bundle_url, self.ca_file)
        return self

    @property
    def name(self) -> str:
        """Name in messages; of no other platform."""
        return f"spiffe://{self.trust_domain}"

    @property
    def file(self) -> str | None:
        """The file that its keys come from, if they come from one."""
        return self.bundle_file


class KubernetesPlatform(_Source):
    """A Kubernetes cluster with projected service account tokens.

    Attributes:
        cluster: its name here; the workload id of an account is `k8s://CLUSTER/NAMESPACE/ACCOUNT`.
        issuer: `iss` of its tokens, exactly.
        jwks_file: its key set as a file; without one OIDC discovery is asked.
        discovery_url: base of the discovery document, where that is not the issuer's own.
        jwks_url: address of the key set, where it does not lie where the discovery document does.
        bearer_file: token with which both are asked, read anew each time; a cluster answers strangers only when told.
        token_lifetime_s: longest life of a token of it.
    """

    kind: Literal["kubernetes"]
    cluster: str
    issuer: Annotated[str, Field(min_length=1, max_length=URL_BYTES)]
    jwks_file: _Path | None = None
    discovery_url: str | None = None
    jwks_url: str | None = None
    bearer_file: _Path | None = None
    token_lifetime_s: Annotated[int, Field(ge=60, le=7_200)] = ACCOUNT_TOKEN_S

    @model_validator(mode="after")
    def _safe(self) -> Self:
        if not text.is_trust_domain(self.cluster):
            raise UnsafeError("platforms.cluster", "not a name of lower-case letters, digits, '.', '_' and '-'")
        addresses = (self.discovery_url, self.jwks_url, self.bearer_file, self.ca_file)
        if self.jwks_file is not None and any(each is not None for each in addresses):
            raise UnsafeError("platforms.jwks_file", "a file, or addresses to ask, not both")
        if self.jwks_file is None:
            _check_address("platforms.issuer", self.discovery_url or self.issuer, self.ca_file)
            _check_address("platforms.jwks_url", self.jwks_url, self.ca_file)
        return self

    @property
    def name(self) -> str:
        """Name in messages; of no other platform."""
        return f"k8s://{self.cluster}"

    @property
    def file(self) -> str | None:
        """The file that its keys come from, if they come from one."""
        return self.jwks_file


StatedPlatform = Annotated[SpiffePlatform | KubernetesPlatform, Field(discriminator="kind")]


class Publisher(BaseModel):
    """A publisher of agents' software, whose releases are evidence.

    Attributes:
        name: by which its releases call it.
        keys: its public keys, as `ztpm person new-key` prints one.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, hide_input_in_errors=True)

    name: str
    keys: Annotated[list[str], Field(min_length=1, max_length=16)]

    @model_validator(mode="after")
    def _safe(self) -> Self:
        try:
            text.name(self.name, most_bytes=URL_BYTES)
        except CapabilityError:
            raise UnsafeError("publishers.name", "not a name") from None
        if len(self.raw) != len(self.keys):
            raise UnsafeError("publishers.keys", "a key twice")
        return self

    @property
    def raw(self) -> frozenset[bytes]:
        """Its raw public keys."""
        try:
            return frozenset(check_raw(unb64u(key)) for key in self.keys)
        except BadKeyError:
            raise UnsafeError("publishers.keys", "not an Ed25519 or P-256 key in base64url") from None


def check_together(platforms: list[SpiffePlatform | KubernetesPlatform], publishers: list[Publisher]) -> None:
    """Checks that no two platforms or publishers have one name.

    Raises:
        UnsafeError: `platforms` or `publishers`.
    """
    if len({each.name for each in platforms}) != len(platforms):
        raise UnsafeError("platforms", "one of them twice")
    keys = [raw for each in publishers for raw in each.raw]
    if len({each.name for each in publishers}) != len(publishers) or len(set(keys)) != len(keys):
        raise UnsafeError("publishers", "a name or a key twice")


def _check_address(setting: str, url: str | None, ca_file: str | None) -> None:
    if url is None:
        return
    parts = urlsplit(url)
    plain = url.isascii() and url.isprintable() and " " not in url and not parts.fragment and "@" not in parts.netloc
    if parts.scheme != "https" or not parts.hostname or not plain or len(url) > URL_BYTES:
        raise UnsafeError(setting, "not an https URL")
    if ca_file is None:
        raise UnsafeError("platforms.ca_file", "an address needs the authorities whose servers are believed")
