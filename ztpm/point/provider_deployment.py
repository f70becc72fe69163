"""Deployment of an identity provider, checked whole before it serves: one way for the service and `ztpm doctor`."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ztpm_idp.keys import oauth_keys
from ztpm_idp.keys.key_ring import check_current
from ztpm_idp.login_settings import load_login_providers
from ztpm_idp.provider import metrics_access
from ztpm_idp.safe_files import check_files
from ztpm_idp.settings import load_keys, load_platform, load_policies, load_settings
from ztpm_idp.web_push_settings import load_web_push
from ztpm_idp.webhook_settings import load_webhooks

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from capabilities.statements.workload import Platform
    from policies.decision.policy import PolicySet
    from ztpm_idp.keys.key_files import IdpKeys
    from ztpm_idp.keys.oauth_keys import OAuthKeys
    from ztpm_idp.login_settings import LoginProvider
    from ztpm_idp.provider.metrics_access import MetricsAccess
    from ztpm_idp.settings import FileSettings
    from ztpm_idp.web_push_settings import WebPush
    from ztpm_idp.webhook_settings import Webhook


@dataclass(frozen=True, slots=True)
class ProviderDeployment:
    """Parts of which a provider is made, each checked.

    Attributes:
        settings: of idp.toml.
        keys: its private keys.
        platform: the platform whose workload tokens count, if any.
        policies: the set that decides on delegations.
        login_providers: OpenID providers at which people may log in.
        oauth: keys of the authorization server; None: there is none.
        publishers: raw public keys by name of each whose releases count.
        metrics: right to read the figures.
        webhooks: that are told of open questions and latches.
        web_push: the way to people's devices; None: there is none.
    """

    settings: FileSettings
    keys: IdpKeys
    platform: Platform | None
    policies: PolicySet
    login_providers: tuple[LoginProvider, ...]
    oauth: OAuthKeys | None
    publishers: Mapping[str, frozenset[bytes]]
    metrics: MetricsAccess
    webhooks: tuple[Webhook, ...]
    web_push: WebPush | None


def read_deployment(config: Path, passphrase: str, *, at: float) -> ProviderDeployment:
    """The deployment of a configuration file, when nothing in it is insecure or empty.

    Args:
        config: idp.toml.
        passphrase: of the key files.
        at: seconds since the epoch.

    Raises:
        ztpm_idp.keys.key_files.SettingsError: naming the first setting that is refused.
    """
    settings = load_settings(config)
    check_files(settings, config, at=at)
    keys = load_keys(settings, config.parent, passphrase)
    check_current(keys, at=at)
    return ProviderDeployment(
        settings,
        keys,
        load_platform(settings, config.parent, keys),
        load_policies(settings, config.parent),
        load_login_providers(settings.login_providers, config.parent),
        oauth_keys.load(settings.oauth_key_files, config.parent, keys, passphrase),
        {each.name: each.raw for each in settings.publishers},
        metrics_access.load(settings, config.parent, os.environ),
        load_webhooks(settings.webhooks, config.parent, os.environ),
        load_web_push(settings.web_push, config.parent),
    )
