"""Settings of a deployment, read strictly.

A service with an unsafe or empty security setting does not start, and says which one.
"""

from __future__ import annotations

import logging
import os
import stat
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal, Self, TypeVar
from urllib.parse import urlsplit

import sqlalchemy as sa
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from capabilities.keys.windows import Role
from capabilities.statements.workload import KEY_SET_BYTES, Platform, key_set
from capabilities.values import text
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import BadKeyError, CapabilityError, ScopeError
from policies.decision.load import SHIPPED, load, load_shipped
from policies.words.errors import PolicyError
from ztpm_idp.allowance_settings import EveryAllowance
from ztpm_idp.domain.addresses import is_loopback
from ztpm_idp.domain.asking.asks import STANDING_ASKS
from ztpm_idp.keys import key_ring
from ztpm_idp.keys.hardware_token import open_token
from ztpm_idp.keys.key_files import PASSPHRASE_VARIABLE, IdpKeys, SettingsError, UnsafeError, load_key, token_key
from ztpm_idp.login_settings import LoginProviderSettings, check_login_providers
from ztpm_idp.platforms.stated import PLATFORMS, PUBLISHERS, Publisher, StatedPlatform, check_together
from ztpm_idp.rate_settings import RateSettings
from ztpm_idp.web_push_settings import WebPushSettings
from ztpm_idp.webhook_settings import SETTING as WEBHOOKS
from ztpm_idp.webhook_settings import WebhookSettings, check_webhooks

if TYPE_CHECKING:
    from policies.decision.policy import PolicySet

KEY_FILES: Final = ("root_key_file", "attester_key_file", "feed_key_file", "registry_key_file", "ledger_key_file")
S = TypeVar("S", bound=BaseModel)
RootKeyId = Annotated[int, Field(ge=0, lt=2**32)]
KeyFile = Annotated[str, Field(min_length=1)] | None
_SQLITE: Final = "sqlite+aiosqlite"
_POSTGRES: Final = "postgresql+asyncpg"

_LOG: Final = logging.getLogger(__name__)


class Lifetimes(BaseModel):
    """Lifetimes in seconds. Each can only be shorter than the profile allows."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    token_s: Annotated[int, Field(ge=1, le=DEFAULT.lifetime_s)] = DEFAULT.key_evidence_lifetime_s
    nonce_s: Annotated[int, Field(ge=1, le=DEFAULT.nonce_age_s)] = DEFAULT.nonce_age_s


class PictureSettings(BaseModel):
    """Time and room for which pictures of motions are kept; their digests stay on record for ever.

    Attributes:
        days: after which a picture is forgotten.
        megabytes: room for all, deflated; beyond it the oldest are forgotten, but none of the last hour, within which
            people answer.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    days: Annotated[int, Field(ge=1, le=36_500)] = 30
    megabytes: Annotated[int, Field(ge=16, le=16_777_216)] = 2_048


class Stated(BaseModel):
    """Address of the identity provider and the way it keeps its state, all but its keys.

    Attributes:
        issuer: its base URL with a path; every endpoint is below it, every proof names it.
        host, port: its listener's address.
        database_url: `sqlite+aiosqlite:///FILE`, or `postgresql+asyncpg://USER@HOST/NAME`. The password of a server
            is in `PGPASSFILE` or `PGPASSWORD`, its certificate authority in the file that `PGSSLROOTCERT` names.
        policy: the set that decides on delegations: the name of a shipped policy set, or a TOML file.
        access_log: each request is a line of the log, but for those that come again and again by themselves.
        client_documents: OAuth clients may be known by a metadata document, which is fetched from their host.
        tls_certificate_file, tls_key_file: PEM files; needed wherever it listens beyond loopback.
        open_nonces: unused nonces that one agent may hold at a time.
        open_asks: asks that may wait for people at a time, one agent's at most a third of them. By default 24: at ten
            seconds of reading each they take one person four minutes, inside the life of an ask; a queue too long
            to be read in time is approved unread.
        login_providers: OpenID providers at which people may log in.
        webhooks: that are told of open asks and latches.
        web_push: people's devices may be told of them, too; None: by nobody's push service.
        asks_a_minute, asks_an_hour: asks that are shown for each active approver. By default 6 and 30: more
            of them are approved unread.
        allowances: how much of each thing one sponsor may have.
        rates: requests of one caller, or from one address, that are taken in a minute.
        pictures: how long pictures of motions are kept, and how much room they have.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, hide_input_in_errors=True)

    issuer: Annotated[str, Field(min_length=1)]
    host: Annotated[str, Field(min_length=1)]
    port: Annotated[int, Field(ge=1, le=65_535)]
    database_url: Annotated[str, Field(min_length=1)]
    lifetimes: Lifetimes = Lifetimes()
    open_nonces: Annotated[int, Field(ge=1, le=4_096)] = 256
    open_asks: Annotated[int, Field(ge=1, le=STANDING_ASKS)] = 24
    asks_a_minute: Annotated[int, Field(ge=1, le=10_000)] = 6
    asks_an_hour: Annotated[int, Field(ge=1, le=10_000)] = 30
    policy: Annotated[str, Field(min_length=1)] = "paper-default"
    client_documents: bool = False
    access_log: bool = True
    tls_certificate_file: str | None = None
    tls_key_file: str | None = None
    login_providers: list[LoginProviderSettings] = []
    webhooks: list[WebhookSettings] = []
    web_push: WebPushSettings | None = None
    rates: RateSettings = RateSettings()
    allowances: EveryAllowance = EveryAllowance()
    pictures: PictureSettings = PictureSettings()

    @model_validator(mode="after")
    def _safe(self) -> Self:
        _check_issuer(self.issuer)
        _check_listener(self)
        _check_database(self.database_url)
        if fault := check_login_providers(self.login_providers):
            raise UnsafeError("login_providers", fault)
        if fault := check_webhooks(self.webhooks):
            raise UnsafeError(WEBHOOKS, fault)
        return self


class Settings(Stated):
    """Settings that `create_app` needs.

    Attributes:
        root_key_id: number of the root key that signs, in every token.
    """

    root_key_id: RootKeyId


class Pkcs11(BaseModel):
    """Hardware module that holds private keys, spoken to by PKCS #11. Its PIN is in the environment (`PIN_VARIABLE`).

    Attributes:
        module: library of the module, e.g. /usr/lib/softhsm/libsofthsm2.so.
        token: label of the token in it; a key has the label of its name in the ring, e.g. "root-2".
        roles: roles whose next keys `ztpm keys prepare` makes in it. Wherever a key of the ring has a file, that one
            is taken.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    module: Annotated[str, Field(min_length=1)]
    token: Annotated[str, Field(min_length=1, max_length=32)]
    roles: Annotated[list[Literal["root", "attester", "feed", "registry", "ledger"]], Field(min_length=1)]


class FileSettings(Stated):
    """The settings of a configuration file, which also names the files of the keys (PKCS #8, encrypted, mode 0600).

    Attributes:
        key_ring_file: which keys there are, and which of them sign (`capabilities.rotation.rotation`); the private key
            of
            "root-2" lies beside it as `root-2.key`. With it none of the next six is stated, without it all of them.
            A step of a rotation takes effect while it serves.
        pkcs11: the hardware module that holds those private keys of the ring which have no file.
        root_key_id: number of the root key, in every token.
        root_key_file, attester_key_file, feed_key_file, registry_key_file, ledger_key_file: one key for each role.
        oauth_key_files: keys of the authorization server, the one that signs first; all are published. Without one
            there is no authorization server here.
        metrics_token_file: file with the bearer token by which `/metrics` is read; without it only on this machine.
        platform_trust_domain, platform_jwks_file: whose workload tokens are evidence of kind `jwt`, and its public keys
            (Ed25519, P-256 or RSA, each with a `kid`). Both or neither.
        platforms: further platforms: SPIFFE trust domains and Kubernetes clusters.
        publishers: those whose releases of agents' software are evidence of kind `release`.
    """

    metrics_token_file: KeyFile = None
    key_ring_file: KeyFile = None
    pkcs11: Pkcs11 | None = None
    root_key_id: RootKeyId | None = None
    root_key_file: KeyFile = None
    attester_key_file: KeyFile = None
    feed_key_file: KeyFile = None
    registry_key_file: KeyFile = None
    ledger_key_file: KeyFile = None
    oauth_key_files: list[str] = Field(default_factory=list)
    platform_trust_domain: str | None = None
    platform_jwks_file: str | None = None
    platforms: Annotated[list[StatedPlatform], Field(max_length=PLATFORMS)] = []
    publishers: Annotated[list[Publisher], Field(max_length=PUBLISHERS)] = []

    @model_validator(mode="after")
    def _keys(self) -> Self:
        for name in ("root_key_id", *KEY_FILES):
            if (getattr(self, name) is None) != (self.key_ring_file is not None):
                why = "missing" if self.key_ring_file is None else "the key ring says it"
                raise UnsafeError(name, why)
        return self

    @model_validator(mode="after")
    def _hardware(self) -> Self:
        if self.pkcs11 is not None and self.key_ring_file is None:
            raise UnsafeError("pkcs11", "keys of a module are named by a key ring; key_ring_file is missing")
        return self

    @model_validator(mode="after")
    def _platform(self) -> Self:
        if (self.platform_trust_domain is None) != (self.platform_jwks_file is None):
            absent = "platform_jwks_file" if self.platform_jwks_file is None else "platform_trust_domain"
            raise UnsafeError(absent, "trust domain and key file go together")
        if self.platform_trust_domain is not None and not text.is_trust_domain(self.platform_trust_domain):
            raise UnsafeError("platform_trust_domain", "not the name of a trust domain")
        check_together(self.platforms, self.publishers)
        if any(each.name == f"spiffe://{self.platform_trust_domain}" for each in self.platforms):
            raise UnsafeError("platforms", "platform_trust_domain once more")
        return self

    def settings(self, keys: IdpKeys | None = None) -> Settings:
        """The part that `create_app` needs.

        Args:
            keys: of `load_keys`; they say which root key signs, where there is a key ring.
        """
        ring = None if keys is None else keys.ring
        signs = self.root_key_id if ring is None else ring.active(Role.ROOT).number
        return _validated(
            Settings, {name: getattr(self, name) for name in Stated.model_fields} | {"root_key_id": signs}
        )


def load_settings(path: Path) -> FileSettings:
    """Settings of a TOML file, each known and safe.

    File names are taken from the file's folder.

    Raises:
        SettingsError: naming the first setting that is refused.
    """
    try:
        stated = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError:
        raise SettingsError("config", "the file cannot be read") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError):
        raise SettingsError("config", "the file is not TOML") from None
    if isinstance(named := stated.get("database_url"), str):
        stated["database_url"] = _in_folder(named, path.absolute().parent)
    return _validated(FileSettings, stated)


def _in_folder(database_url: str, folder: Path) -> str:
    """The database URL; a relative file of SQLite begins in the folder."""
    scheme, mark, file = database_url.partition(f"{_SQLITE}:///")
    plain = not scheme and mark and file and not file.startswith(("/", ":", "file:")) and "?" not in file
    return f"{mark}{folder / file}" if plain else database_url


def check_settings(stated: dict[str, object]) -> Settings:
    """The settings, when safe.

    Raises:
        SettingsError: naming the first setting that is refused.
    """
    return _validated(Settings, stated)


def load_keys(settings: FileSettings, folder: Path, passphrase: str) -> IdpKeys:
    """The private keys that the settings name.

    Args:
        settings: names the files.
        folder: where relative names start.
        passphrase: of all of them; not empty.

    Raises:
        SettingsError: naming the file's setting.
    """
    if not passphrase:
        raise SettingsError(PASSPHRASE_VARIABLE, "empty")
    if settings.key_ring_file is not None:
        hardware = None if settings.pkcs11 is None else open_token(settings.pkcs11.module, settings.pkcs11.token)
        return key_ring.load(settings.key_ring_file, folder, settings.issuer, passphrase, hardware=hardware)
    files = {name: folder / str(getattr(settings, name)) for name in KEY_FILES}
    root, attester = (load_key(name, files[name], passphrase) for name in KEY_FILES[:2])
    feed, registry, ledger = (load_key(name, files[name], passphrase) for name in KEY_FILES[2:])
    keys = IdpKeys(token_key("root_key_file", root), token_key("attester_key_file", attester), feed, registry, ledger)
    try:
        keys.trust(issuer=settings.issuer, root_key_id=settings.root_key_id or 0)
    except BadKeyError as error:
        raise SettingsError("root_key_file", f"{error.code}: five different keys are needed") from None
    return keys


def load_platform(settings: FileSettings, folder: Path, keys: IdpKeys) -> Platform | None:
    """Platform whose word on workloads is trusted, when the settings name one.

    Args:
        settings: names trust domain and key file.
        folder: where a relative name starts.
        keys: of the provider itself; the platform has none of them.

    Raises:
        SettingsError: `platform_jwks_file` when the file is unreadable, may be written by others, or is refused.
    """
    if settings.platform_trust_domain is None or settings.platform_jwks_file is None:
        return None
    setting = "platform_jwks_file"
    try:
        with (folder / settings.platform_jwks_file).open("rb") as file:
            if stat.S_IMODE(os.fstat(file.fileno()).st_mode) & 0o022:
                raise SettingsError(setting, "others may write the file: who may, may attest any software")
            usable, others = key_set(file.read(KEY_SET_BYTES + 1))
            platform = Platform(settings.platform_trust_domain, usable)
            for each in others:
                _LOG.warning("platform_jwks: left out %s", each)
    except OSError:
        raise SettingsError(setting, "the file cannot be read") from None
    except CapabilityError as error:
        raise SettingsError(setting, f"{error.code}: {error.detail}") from None
    if platform.all_keys & keys.every_public:
        raise SettingsError(setting, "a key of the provider itself: one key has one role")
    return platform


def load_policies(settings: Stated, folder: Path | None = None) -> PolicySet:
    """Policy set that decides on delegations.

    Args:
        settings: name a shipped set, or a file.
        folder: where a relative name of a file starts; None: only a shipped set is taken.

    Raises:
        SettingsError: `policy`, when there is no such set, or it is refused.
    """
    try:
        if folder is None or settings.policy in SHIPPED:
            return load_shipped(settings.policy)
        path = folder / settings.policy
        return load(path.read_text(encoding="utf-8"), place=str(path.resolve()), read=_beside)
    except (OSError, UnicodeDecodeError):
        raise SettingsError("policy", "the file cannot be read") from None
    except PolicyError as error:
        raise SettingsError("policy", f"{error.code}: {error.where}") from None


def _beside(name: str, place: str) -> tuple[str, str]:
    """Text and place of a policy set that the one at `place` names, in whose folder it is."""
    path = (Path(place).parent / name).resolve()
    return path.read_text(encoding="utf-8"), str(path)


def _validated(model: type[S], stated: dict[str, object]) -> S:
    try:
        return model.model_validate(stated)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=True, include_input=False)[0]
        cause = first.get("ctx", {}).get("error")
        if isinstance(cause, UnsafeError):
            raise SettingsError(cause.setting, cause.why) from None
        raise SettingsError(".".join(str(part) for part in first["loc"]) or "config", first["type"]) from None


def _check_issuer(issuer: str) -> None:
    try:
        text.url(issuer, most_bytes=DEFAULT.text_bytes)
    except ScopeError:
        raise UnsafeError("issuer", "not a canonical URL") from None
    parts = urlsplit(issuer)
    if parts.scheme not in {"http", "https"}:
        raise UnsafeError("issuer", "not an HTTP URL")
    if not parts.path:
        raise UnsafeError("issuer", "needs a path, e.g. /ztpm: readers differ on what a URL without one is called")
    if parts.scheme == "http" and not is_loopback(parts.hostname or ""):
        raise UnsafeError("issuer", "plain HTTP beyond loopback")


def _check_listener(settings: Stated) -> None:
    tls = (settings.tls_certificate_file, settings.tls_key_file)
    if any(tls) and not all(tls):
        raise UnsafeError("tls_certificate_file" if not tls[0] else "tls_key_file", "certificate and key go together")
    if not is_loopback(settings.host) and not all(tls):
        raise UnsafeError("host", "listening beyond loopback needs TLS")
    if all(tls) and not settings.issuer.startswith("https://"):
        raise UnsafeError("issuer", "TLS is configured but the issuer is plain HTTP")


def _check_database(database_url: str) -> None:
    try:
        url = sa.make_url(database_url)
    except sa.exc.ArgumentError:
        raise UnsafeError("database_url", "not a database URL") from None
    if url.drivername == _SQLITE:
        _check_sqlite(url)
    elif url.drivername == _POSTGRES:
        _check_postgres(url)
    else:
        raise UnsafeError("database_url", f"the driver is {_SQLITE} or {_POSTGRES}")


def _check_sqlite(url: sa.URL) -> None:
    # A plain file and nothing else: options in the URL could put it into memory or loosen its durability.
    if not url.database or url.database.startswith((":", "file:")):
        raise UnsafeError("database_url", "a database in memory forgets revocations")
    if url.query:
        raise UnsafeError("database_url", "options are not taken")


def _check_postgres(url: sa.URL) -> None:
    """Takes one server by its name or socket, without a password, and with verified TLS beyond this machine.

    The store turns TLS on by itself: an option could only turn it down.
    """
    if url.password is not None:
        raise UnsafeError("database_url", "a password in a file: it belongs in PGPASSFILE (~/.pgpass) or PGPASSWORD")
    socket = url.query.get("host")
    if url.query and (set(url.query) != {"host"} or not isinstance(socket, str) or not socket.startswith("/")):
        raise UnsafeError("database_url", "the only option is host=/DIRECTORY, of a socket; TLS needs none")
    if (url.host is None) == (socket is None):
        raise UnsafeError("database_url", "one server: //USER@HOST/NAME, or //USER@/NAME?host=/DIRECTORY")
    if not url.username or not url.database:
        raise UnsafeError("database_url", "names a user and a database: another's environment would choose them")
