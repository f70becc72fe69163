"""Settings of the webhooks that are told of open questions, read strictly; their addresses are secrets."""

from __future__ import annotations

import re
import ssl
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Final, Literal, Self
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, model_validator

from ztpm_idp.domain.addresses import is_loopback
from ztpm_idp.keys.key_files import SettingsError
from ztpm_idp.keys.passphrase import OTHERS_WRITE, STRANGERS_READ, check_modes

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

SETTING: Final = "webhooks"
WEBHOOKS: Final = 8
"""Most webhooks; ours: each is one more request for each question."""
ADDRESS_BYTES: Final = 2_048
"""Longest address; that of a workflow of Microsoft Teams has about 400 characters."""
TOPIC: Final = re.compile(r"[A-Za-z0-9_-]{1,64}", re.ASCII)
"""Topic of ntfy (docs.ntfy.sh, publish)."""
Form = Literal["slack", "teams", "ntfy", "json"]


class WebhookSettings(BaseModel):
    """Webhook that is told of open questions.

    Attributes:
        name: by which log, figures and ledger know it; its address is told nowhere.
        form: of its messages: an incoming webhook of Slack, a workflow of Microsoft Teams, a topic of ntfy, or JSON.
        url_file: file with the address; nobody but owner and group may read it.
        url_variable: name of the environment variable with the address; one of both is stated.
        ends: it is told once more when the question is over.
        details: messages name the agent, the act and its parameters; else nothing of them leaves.
        ca_file: PEM file of the authorities that its certificate is believed by; None: those of the system.
    """

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, hide_input_in_errors=True)

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]{0,31}$")]
    form: Form
    url_file: Annotated[str, Field(min_length=1)] | None = None
    url_variable: Annotated[str, Field(pattern=r"^[A-Z_][A-Z0-9_]{0,63}$")] | None = None
    ends: bool = False
    details: bool = False
    ca_file: Annotated[str, Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.url_file is None) == (self.url_variable is None):
            raise ValueError("one of url_file and url_variable")
        return self


@dataclass(frozen=True, slots=True)
class Webhook:
    """Webhook with its address.

    Attributes:
        stated: its settings.
        url: where it is sent to; a secret.
        authorities: that its certificate is believed by; None: it is on this machine, in the clear.
    """

    stated: WebhookSettings
    url: str = field(repr=False)
    authorities: ssl.SSLContext | None = field(default=None, repr=False, compare=False)


def check_webhooks(stated: list[WebhookSettings]) -> str | None:
    """Fault of the webhooks together, or None."""
    if len(stated) > WEBHOOKS:
        return f"at most {WEBHOOKS}"
    return None if len({each.name for each in stated}) == len(stated) else "two have one name"


def load_webhooks(
    stated: Iterable[WebhookSettings], folder: Path, environment: Mapping[str, str]
) -> tuple[Webhook, ...]:
    """The webhooks, with their addresses.

    Args:
        stated: the settings.
        folder: where relative names of files start.
        environment: of the process.

    Raises:
        SettingsError: `webhooks`, with the name of the one that is refused, and no part of its address.
    """
    return tuple(_loaded(each, folder, environment) for each in stated)


def _loaded(stated: WebhookSettings, folder: Path, environment: Mapping[str, str]) -> Webhook:
    url = _address(stated, folder, environment)
    parts = urlsplit(url)
    secure = parts.scheme == "https"
    if not secure and not (parts.scheme == "http" and is_loopback(parts.hostname or "")):
        raise _refused(stated, "its address is neither https nor on this machine")
    if stated.form == "ntfy" and not TOPIC.fullmatch(parts.path.removeprefix("/")):
        raise _refused(stated, "its address does not end in one topic, as https://ntfy.sh/TOPIC")
    if not secure and stated.ca_file is not None:
        raise _refused(stated, "ca_file is for https")
    return Webhook(stated, url, _authorities(stated, folder) if secure else None)


def _address(stated: WebhookSettings, folder: Path, environment: Mapping[str, str]) -> str:
    if stated.url_variable is not None:
        text = environment.get(stated.url_variable, "")
        if not text:
            raise _refused(stated, f"{stated.url_variable} is not set")
    else:
        path = folder / (stated.url_file or "")
        check_modes(f"{SETTING}: {stated.name}", path, STRANGERS_READ | OTHERS_WRITE)
        try:
            with path.open("rb") as file:
                text = file.read(ADDRESS_BYTES + 2).decode("ascii").strip()
        except (OSError, UnicodeDecodeError):
            raise _refused(stated, "the file of its address cannot be read") from None
    if not text or len(text) > ADDRESS_BYTES or not all("!" <= each <= "~" for each in text):
        raise _refused(stated, "its address is no URL on one line")
    try:
        parts = urlsplit(text)
        _ = parts.port
    except ValueError:
        raise _refused(stated, "its address is no URL on one line") from None
    if not parts.hostname or parts.username is not None or parts.fragment:
        raise _refused(stated, "its address has no host, or a user or a fragment")
    return text


def _authorities(stated: WebhookSettings, folder: Path) -> ssl.SSLContext:
    if stated.ca_file is None:
        return ssl.create_default_context()
    path = folder / stated.ca_file
    check_modes(f"{SETTING}: {stated.name}", path, OTHERS_WRITE)
    try:
        return ssl.create_default_context(cafile=str(path))
    except (OSError, ssl.SSLError):
        raise _refused(stated, "ca_file holds no certificate of an authority") from None


def _refused(stated: WebhookSettings, why: str) -> SettingsError:
    return SettingsError(SETTING, f"{stated.name}: {why}")
