"""Subscriptions of people's devices to notifications: an address at a push service, and keys of the browser's own."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import Final
from urllib.parse import urlsplit

from capabilities.keys.keys import b64u

DEVICE: Final = "@"
"""First character of the name under which a device is pushed to; no webhook's name has it."""
ID_CHARACTERS: Final = 22
"""Characters of a subscription's id: 132 bits of its endpoint's digest."""
OF_A_PERSON: Final = 4
"""Ours: most devices of one person: a phone, a tablet, two screens."""
OF_ALL: Final = 64
"""Ours: most devices: each is one more request for each question."""


@dataclass(frozen=True, slots=True)
class Subscription:
    """Subscription of one browser on one device.

    Attributes:
        person: whose device it is.
        session_id: of the session in which it was made, with which it ends.
        endpoint: URL at its push service; who has it and the provider's key can send to the device.
        key: uncompressed point of the browser's key.
        secret: the browser's authentication secret.
        made_ms: wall clock.
    """

    person: str
    session_id: str
    endpoint: str = field(repr=False)
    key: bytes = field(repr=False)
    secret: bytes = field(repr=False)
    made_ms: int

    @property
    def id(self) -> str:
        """The same for the same browser, and of no use at its push service."""
        return b64u(hashlib.sha256(self.endpoint.encode()).digest())[:ID_CHARACTERS]

    @property
    def name(self) -> str:
        """Name under which it is pushed to."""
        return DEVICE + self.id

    @property
    def service(self) -> str:
        """Host of its push service."""
        return urlsplit(self.endpoint).hostname or ""
