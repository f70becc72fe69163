"""Keys of platforms from where a configuration says that they are: read at the start, and again while it serves."""

from __future__ import annotations

import asyncio
import logging
import os
import stat
import time
from typing import TYPE_CHECKING, Final, assert_never
from urllib.parse import urlsplit

from capabilities.statements import platform_keys
from capabilities.statements.workload import Cluster, Platform
from capabilities.values import strict_json
from capabilities.values.errors import CapabilityError
from ztpm_idp.keys.key_files import SettingsError
from ztpm_idp.platforms.fetch import fetched
from ztpm_idp.platforms.stated import KubernetesPlatform, SpiffePlatform

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from capabilities.statements.workload import AnyPlatform

DOCUMENT_BYTES: Final = 65_536
"""Largest discovery document: a large provider's has 5 kB."""
RETRY_S: Final = 10
"""Time until an address is asked again that gave no good answer."""
_DISCOVERY: Final = "/.well-known/openid-configuration"
"""OpenID Connect Discovery 1.0, section 4."""
_LOG: Final = logging.getLogger(__name__)

Stated = SpiffePlatform | KubernetesPlatform


class PlatformKeys:
    """Keys of one platform, wherever they come from; remembers how new the newest were.

    Args:
        stated: the platform, by the configuration.
        folder: where relative names start.
    """

    def __init__(self, stated: Stated, folder: Path) -> None:
        self.stated = stated
        self.setting = f"platforms: {stated.name}"
        self._folder = folder
        self._sequence = -1
        self.hint_s: int | None = None

    @property
    def path(self) -> Path | None:
        """The file that they come from, if any."""
        return None if self.stated.file is None else self._folder / self.stated.file

    def read(self) -> AnyPlatform:
        """The platform by its file.

        Raises:
            SettingsError: when it cannot be read, may be written by others, or is refused.
        """
        path = self.path
        if path is None:
            raise SettingsError(self.setting, "there is no file")
        try:
            with path.open("rb") as file:
                if stat.S_IMODE(os.fstat(file.fileno()).st_mode) & 0o022:
                    raise SettingsError(self.setting, "others may write the file: who may, may attest any workload")
                return self._platform(file.read(platform_keys.BUNDLE_BYTES + 1))
        except OSError:
            raise SettingsError(self.setting, "the file cannot be read") from None

    async def ask(self) -> AnyPlatform:
        """The platform by its address.

        Raises:
            SettingsError: when there is no good answer.
        """
        match self.stated:
            case SpiffePlatform(bundle_url=str(url)):
                return self._platform(await self._fetched(url, platform_keys.BUNDLE_BYTES))
            case KubernetesPlatform() as cluster:
                return self._platform(await self._fetched(await self._address(cluster), platform_keys.BUNDLE_BYTES))
            case _:
                raise SettingsError(self.setting, "there is no address")

    async def _address(self, cluster: KubernetesPlatform) -> str:
        """Address of the key set: the configured one, or that which discovery names on the same server."""
        if cluster.jwks_url is not None:
            return cluster.jwks_url
        base = cluster.discovery_url or cluster.issuer
        raw = await self._fetched(base.rstrip("/") + _DISCOVERY, DOCUMENT_BYTES)
        try:
            document = strict_json.parse_object(raw)
        except CapabilityError:
            raise SettingsError(self.setting, "no discovery document") from None
        if document.get("issuer") != cluster.issuer:
            raise SettingsError(self.setting, "the discovery document of another issuer")
        found = document.get("jwks_uri")
        if not isinstance(found, str) or urlsplit(found)[:2] != urlsplit(base)[:2]:
            raise SettingsError(self.setting, "the key set lies on another server; name it as jwks_url to trust that")
        return found

    async def _fetched(self, url: str, most_bytes: int) -> bytes:
        stated = self.stated
        if stated.ca_file is None:
            raise SettingsError(self.setting, "there is no ca_file")
        bearer = stated.bearer_file if isinstance(stated, KubernetesPlatform) else None
        return await fetched(
            self.setting, url, ca=self._folder / stated.ca_file, most_bytes=most_bytes,
            bearer=None if bearer is None else self._folder / bearer,
        )  # fmt: skip

    def _platform(self, raw: bytes) -> AnyPlatform:
        try:
            match self.stated:
                case SpiffePlatform() as domain:
                    bundle = platform_keys.bundle(raw)
                    if bundle.sequence is not None and bundle.sequence < self._sequence:
                        raise SettingsError(self.setting, f"sequence {bundle.sequence} after {self._sequence}")
                    found: AnyPlatform = Platform(domain.trust_domain, bundle.keys, bundle.authorities)
                    self._sequence = self._sequence if bundle.sequence is None else bundle.sequence
                    self.hint_s = bundle.refresh_hint_s
                    self._tell(bundle.others)
                case KubernetesPlatform() as cluster:
                    keys, others = platform_keys.key_set(raw)
                    found = Cluster(cluster.cluster, cluster.issuer, keys, cluster.token_lifetime_s)
                    self._tell(others)
                case _:
                    assert_never(self.stated)
        except CapabilityError as error:
            raise SettingsError(self.setting, f"{error.code}: {error.detail}") from None
        return found

    def _tell(self, others: tuple[str, ...]) -> None:
        for each in others:
            _LOG.info("%s: left out %s", self.setting, each)


class AskedPlatform:
    """A platform whose keys are asked for beside the provider, again and again.

    Args:
        source: of the keys.
        take: trusts what came, or nothing where the last good answer is too old; raises `SettingsError`.
        faults: has the reason, by setting, for which there is no newer answer.
        clock: monotonic, seconds.
    """

    def __init__(
        self,
        source: PlatformKeys,
        *,
        take: Callable[[AnyPlatform | None], None],
        faults: dict[str, str],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._source, self._take, self._faults, self._clock = source, take, faults, clock
        self._good_s: float | None = None

    async def look(self) -> float:
        """Asks once; the seconds until it is to ask again."""
        source = self._source
        try:
            self._take(await source.ask())
        except SettingsError as error:
            if self._faults.get(source.setting) != error.why:
                _LOG.error("%s: %s", error.setting, error.why)
            self._faults[source.setting] = error.why
            if self._good_s is not None and self._clock() - self._good_s > source.stated.kept_s:
                self._good_s = None
                self._take(None)
                _LOG.error("%s: its last keys are too old, and count no longer", source.setting)
            return RETRY_S
        self._good_s = self._clock()
        self._faults.pop(source.setting, None)
        hint_s = source.stated.refresh_s if source.hint_s is None else source.hint_s
        return min(max(hint_s, RETRY_S), source.stated.refresh_s)

    async def run(self) -> None:
        """Asks for ever."""
        while True:
            pause_s = await self.look()
            await asyncio.sleep(pause_s)
