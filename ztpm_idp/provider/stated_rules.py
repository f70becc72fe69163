"""Rules of the domain, as settings, keys, platforms and policies of a deployment state them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capabilities.keys.keys import public_raw
from capabilities.values.caps import DEFAULT
from ztpm_idp.domain.rules import Rules

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.statements.workload import AnyPlatform
    from policies.decision.policy import PolicySet
    from ztpm_idp.keys.key_files import IdpKeys
    from ztpm_idp.settings import Settings


def rules_of(
    settings: Settings,
    keys: IdpKeys,
    platforms: tuple[AnyPlatform, ...],
    policies: PolicySet,
    publishers: Mapping[str, frozenset[bytes]],
    *,
    reserved: frozenset[bytes] = frozenset(),
) -> Rules:
    """Rules that a deployment's settings, keys, platforms and policies fix for the domain.

    `reserved` keys are nobody's, too.
    """
    trust = keys.trust(issuer=settings.issuer, root_key_id=settings.root_key_id)
    return Rules(
        issuer=settings.issuer,
        trust=trust,
        caps=DEFAULT,
        # Nobody who is registered may hold a key of the platform either, or one that was ours.
        own_keys=keys.every_public.union(reserved, *(each.all_keys for each in platforms), *publishers.values()),
        token_lifetime_s=settings.lifetimes.token_s,
        nonce_age_s=settings.lifetimes.nonce_s,
        open_nonces=settings.open_nonces,
        platforms=platforms,
        publishers=publishers,
        open_asks=settings.open_asks,
        asks_a_minute=settings.asks_a_minute,
        asks_an_hour=settings.asks_an_hour,
        policies=policies,
        root_key=public_raw(keys.root),
        allowances=settings.allowances.table(open_asks=settings.open_asks),
    )
