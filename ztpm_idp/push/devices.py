"""Sending to one device, by the push service that its browser named: the push service learns that, and no word."""

from __future__ import annotations

import asyncio
import hashlib
import json
from typing import TYPE_CHECKING, Final

from cryptography.hazmat.primitives.asymmetric import ec

from capabilities.keys.keys import b64u
from ztpm_idp.domain.asking.pushes import PushCode
from ztpm_idp.outward import Pinned, pinned
from ztpm_idp.push.encryption import SALT_BYTES, authorization, encrypt
from ztpm_idp.push.sending import Sent, post
from ztpm_idp.web_push_settings import ServicePlace, place_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from ztpm_idp.domain.asking.subscriptions import Subscription
    from ztpm_idp.outward import Resolver
    from ztpm_idp.push.message import Message
    from ztpm_idp.web_push_settings import WebPush

LATCH_S: Final = 43_200
"""Ours: seconds for which a push service keeps word of a stopped robot: the longest that a subscription lasts."""
TOPIC_CHARACTERS: Final = 32
"""Longest topic (RFC 8030, section 5.4)."""
GONE: Final = frozenset({404, 410})
"""Statuses by which a push service says that a subscription is over (RFC 8030, section 7.3)."""


def text_of(message: Message) -> bytes:
    """Text that the device is told: as much as a webhook without details."""
    told = {"title": message.title, "body": message.head, "url": message.url, "tag": message.id}
    return json.dumps(told).encode("ascii")


async def send_to_device(
    web_push: WebPush,
    subscription: Subscription,
    message: Message,
    *,
    key: ec.EllipticCurvePrivateKey,
    random: Callable[[int], bytes],
    at_s: int,
    resolver: Resolver,
    patience_s: float,
) -> Sent:
    """Sends a message once.

    Args:
        web_push: names the push services, and whose certificates are believed.
        subscription: of the device.
        message: about the question or latch.
        key: of `encryption.signing_key`.
        random: so many fresh bytes.
        at_s: now, seconds since the epoch.
        resolver: of names.
        patience_s: longest time for all of it.
    """
    endpoint, place = subscription.endpoint, place_of(subscription.endpoint, web_push.stated)
    if place is None:  # other settings than when it was made
        return Sent(PushCode.PUSH_REFUSED, "its push service is not in the settings")
    target: Pinned | None = None
    if place is ServicePlace.PUBLIC:
        try:
            async with asyncio.timeout(patience_s):
                target = await pinned(endpoint, resolver)
        except (OSError, TimeoutError, UnicodeError) as error:
            return Sent(PushCode.PUSH_UNREACHABLE, type(error).__name__, again=True)
        if target is None:
            return Sent(PushCode.PUSH_REFUSED, "its push service has no public address, or also another one")
    ephemeral = ec.generate_private_key(ec.SECP256R1())
    body = encrypt(
        text_of(message),
        key=subscription.key,
        secret=subscription.secret,
        ephemeral=ephemeral,
        salt=random(SALT_BYTES),
    )
    headers = {
        "authorization": authorization(endpoint, contact=web_push.stated.contact, key=key, at_s=at_s),
        "content-encoding": "aes128gcm",
        "content-type": "application/octet-stream",
        "ttl": str(LATCH_S if message.until is None else max(0, message.until - at_s)),
        # One that was not delivered yet is replaced. The id itself opens the page, and is no business of the service.
        "topic": b64u(hashlib.sha256(f"topic {message.id}".encode()).digest())[:TOPIC_CHARACTERS],
        "urgency": "high",
    }
    return await post(
        endpoint if target is None else target.url,
        body,
        headers=headers if target is None else headers | dict(target.headers),
        verify=web_push.authorities[place],
        extensions={} if target is None else target.extensions,
        patience_s=patience_s,
    )
