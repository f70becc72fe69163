"""Settings of Web Push: who answers for it, and the push services that browsers may name."""

from __future__ import annotations

import re
import ssl
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Annotated, Final
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field

from ztpm_idp.keys.key_files import SettingsError
from ztpm_idp.keys.passphrase import OTHERS_WRITE, check_modes

if TYPE_CHECKING:
    from pathlib import Path

SETTING: Final = "web_push"
SERVICES: Final = (
    "fcm.googleapis.com",
    "updates.push.services.mozilla.com",
    "web.push.apple.com",
    "*.notify.windows.com",
)
"""Hosts of the push services of Chrome, Firefox, Safari and Edge."""
ENDPOINT_BYTES: Final = 1_024
"""Ours: longest endpoint; those of today's services have less than 400."""
_HTTPS: Final = 443
_CONTACT: Final = r"^(mailto:[!-?A-~]+@[!-?A-~]+|https://[!-~]+)$"
_HOST: Final = r"^(\*\.)?[a-z0-9]([a-z0-9-]*[a-z0-9])?(\.[a-z0-9]([a-z0-9-]*[a-z0-9])?)+$"
_OWN: Final = r"^[a-z0-9]([a-z0-9.-]*[a-z0-9])?:[1-9][0-9]{0,4}$"
_URL: Final = re.compile(r"https://[A-Za-z0-9._~:/?=&%+,;!$'()*-]+", re.ASCII)


class WebPushSettings(BaseModel):
    """Web Push to people's devices.

    Attributes:
        contact: whom a push service may write to, as `mailto:ADDRESS` or an `https` URL; each of them is told it.
        services: hosts of push services, at public addresses; `*.` at the start stands for any labels.
        own_services: push services of one's own network, each `HOST:PORT`, at any address.
        ca_file: PEM file of the authorities by which certificates of `own_services` are believed; None: the system's.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, hide_input_in_errors=True)

    contact: Annotated[str, Field(pattern=_CONTACT, max_length=256)]
    services: Annotated[list[Annotated[str, Field(pattern=_HOST)]], Field(max_length=16)] = list(SERVICES)
    own_services: Annotated[list[Annotated[str, Field(pattern=_OWN)]], Field(max_length=4)] = []
    ca_file: Annotated[str, Field(min_length=1)] | None = None


class ServicePlace(Enum):
    """Place of a push service: on the public Internet, or in one's own network."""

    PUBLIC = "public"
    OWN = "own"


@dataclass(frozen=True, slots=True)
class WebPush:
    """Web Push as it is configured.

    Attributes:
        stated: its settings.
        authorities: that certificates are believed by, for each place.
    """

    stated: WebPushSettings
    authorities: dict[ServicePlace, ssl.SSLContext] = field(repr=False, compare=False)


def place_of(endpoint: str, stated: WebPushSettings) -> ServicePlace | None:
    """Place of the push service that an endpoint names; None where the settings have no such service.

    Args:
        endpoint: as a browser says it.
        stated: name the services.
    """
    if len(endpoint) > ENDPOINT_BYTES or not _URL.fullmatch(endpoint):
        return None
    parts = urlsplit(endpoint)
    host, mark, digits = parts.netloc.partition(":")
    # One spelling: what is read here, and what is asked later, is one host.
    if host != host.lower() or parts.path in {"", "/"} or (mark and not re.fullmatch("[1-9][0-9]{0,4}", digits)):
        return None
    port = int(digits) if mark else _HTTPS
    if f"{host}:{port}" in stated.own_services:
        return ServicePlace.OWN
    return ServicePlace.PUBLIC if port == _HTTPS and any(_is(host, each) for each in stated.services) else None


def load_web_push(stated: WebPushSettings | None, folder: Path) -> WebPush | None:
    """Web Push, with the authorities that it believes.

    Args:
        stated: the settings; None: there is no Web Push.
        folder: where a relative name of a file starts.

    Raises:
        SettingsError: `web_push`.
    """
    if stated is None:
        return None
    if not stated.services and not stated.own_services:
        raise SettingsError(SETTING, "names no push service")
    public = ssl.create_default_context()
    if stated.ca_file is None:
        return WebPush(stated, {ServicePlace.PUBLIC: public, ServicePlace.OWN: public})
    path = folder / stated.ca_file
    check_modes(SETTING, path, OTHERS_WRITE)
    try:
        own = ssl.create_default_context(cafile=str(path))
    except (OSError, ssl.SSLError):
        raise SettingsError(SETTING, "ca_file holds no certificate of an authority") from None
    return WebPush(stated, {ServicePlace.PUBLIC: public, ServicePlace.OWN: own})


def _is(host: str, service: str) -> bool:
    return host.endswith(service[1:]) and len(host) >= len(service) if service.startswith("*.") else host == service
