"""Settings of the OpenID providers at which people may log in, read strictly; their secrets lie in files."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Final, Literal, Self
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, model_validator

from capabilities.values import text
from capabilities.values.errors import ScopeError
from ztpm_idp.domain.parties import PersonRole
from ztpm_idp.keys.key_files import SettingsError

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

SECRET_BYTES: Final = 1_024
"""Longest client secret."""
PROVIDERS: Final = 8
"""Most providers: more buttons than a person reads through."""
Algorithm = Literal["RS256", "PS256", "ES256", "EdDSA", "Ed25519"]
"""Signatures of identity tokens that may be taken: public keys alone, never `none`, never a shared secret."""
Printable = Annotated[str, Field(min_length=1, max_length=128, pattern=r"^[!-~]+$")]


class LoginProviderSettings(BaseModel):
    """OpenID provider at which people may log in.

    Attributes:
        name: part of its addresses here, as `/login/providers/NAME/callback`, which is registered there.
        title: as people read it on the button.
        issuer: exactly as the provider spells it; its discovery document must say the same.
        client_id: ours, as the provider knows it.
        client_secret_file: file of mode 0600 with our secret; None: a public client, which PKCE alone protects.
        algorithms: of the identity token's signature, the only ones that are taken.
        scopes: asked for beside `openid`, as one that the groups need.
        acr_values: authentication context classes that are asked for, and of which the token must have one.
        groups_claim: claim with the person's groups; then a session has no other roles than `groups` gives them.
        groups: roles that the members of each group may have in a session, if the registry gives them too.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, hide_input_in_errors=True)

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]{0,31}$")]
    title: Annotated[str, Field(min_length=1, max_length=64)]
    issuer: Annotated[str, Field(min_length=1, max_length=256)]
    client_id: Printable
    client_secret_file: Annotated[str, Field(min_length=1)] | None = None
    algorithms: Annotated[list[Algorithm], Field(min_length=1)] = ["RS256", "PS256", "ES256", "EdDSA", "Ed25519"]
    scopes: list[Printable] = []
    acr_values: list[Printable] = []
    groups_claim: Printable | None = None
    groups: dict[str, list[Literal["sponsor", "approver", "admin", "auditor"]]] = {}

    @model_validator(mode="after")
    def _safe(self) -> Self:
        parts = urlsplit(self.issuer)
        try:
            text.prose(self.title, most_bytes=256)
        except ScopeError:
            raise ValueError("title") from None
        if parts.query or parts.fragment or not parts.hostname or parts.username is not None:
            raise ValueError("the issuer is no issuer's address")
        if not self.issuer.isascii() or any(not "!" <= each <= "~" for each in self.issuer):
            raise ValueError("the issuer is not plain ASCII")
        if parts.scheme != "https" and not (parts.scheme == "http" and is_loopback(parts.hostname)):
            raise ValueError("plain HTTP beyond loopback")
        if (self.groups_claim is None) != (not self.groups):
            raise ValueError("groups_claim and groups go together")
        return self


@dataclass(frozen=True, slots=True)
class LoginProvider:
    """OpenID provider at which people may log in, with our secret there.

    Attributes:
        stated: its settings.
        secret: our client secret, if it is not a public client.
    """

    stated: LoginProviderSettings
    secret: str | None = field(default=None, repr=False)

    def roles(self, group_names: Iterable[str]) -> frozenset[PersonRole]:
        """Roles that members of these groups may have in a session."""
        return frozenset(PersonRole(role) for name in group_names for role in self.stated.groups.get(name, ()))


def load_login_providers(stated: Iterable[LoginProviderSettings], folder: Path) -> tuple[LoginProvider, ...]:
    """The providers, with their secrets.

    Args:
        stated: the settings.
        folder: where relative names of files start.

    Raises:
        SettingsError: `login_providers`, with the name of the one that is refused.
    """
    return tuple(LoginProvider(each, _secret(each, folder)) for each in stated)


def check_login_providers(stated: list[LoginProviderSettings]) -> str | None:
    """Fault of the providers together, or None."""
    if len(stated) > PROVIDERS:
        return f"at most {PROVIDERS}"
    for member in ("name", "issuer"):
        if len({getattr(each, member) for each in stated}) != len(stated):
            return f"two have one {member}"
    return None


def is_loopback(host: str) -> bool:
    """True for the names of this machine in addresses."""
    return host in {"localhost", "127.0.0.1", "::1"}


def _secret(stated: LoginProviderSettings, folder: Path) -> str | None:
    if stated.client_secret_file is None:
        return None
    setting = "login_providers"
    try:
        with (folder / stated.client_secret_file).open("rb") as file:
            if stat.S_IMODE(os.fstat(file.fileno()).st_mode) & 0o077:
                raise SettingsError(setting, f"{stated.name}: others may read the secret; its mode must be 0600")
            secret = file.read(SECRET_BYTES + 1).decode("ascii").strip()
    except (OSError, UnicodeDecodeError):
        raise SettingsError(setting, f"{stated.name}: the file of the secret cannot be read") from None
    if not 16 <= len(secret) <= SECRET_BYTES or not all("!" <= each <= "~" for each in secret):
        raise SettingsError(setting, f"{stated.name}: a secret has 16 to {SECRET_BYTES} characters")
    return secret
