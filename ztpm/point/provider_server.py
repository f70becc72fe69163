"""Process of the identity provider, behind the same edge as the enforcement points.

It is composed here, since the edge is `ztpm`'s and the provider knows no other package of the house that serves.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import sys
import time
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from pep.base.collector import spare_what_stands
from ztpm.base.trace_export import exporting
from ztpm.codes.code_table import status_of
from ztpm.codes.unavailable import UnavailableError, line_of
from ztpm.point.provider_deployment import read_deployment
from ztpm_idp.keys.key_files import PASSPHRASE_VARIABLE, SettingsError
from ztpm_idp.keys.passphrase import passphrase_of
from ztpm_idp.safe_files import check_tls_files
from ztpm_idp.store import Store, StoreNotOpenedError
from ztpm_idp.watching import watching

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Iterable, Mapping

    from capabilities.statements.workload import Platform
    from policies.decision.policy import PolicySet
    from ztpm_idp.keys.key_files import IdpKeys
    from ztpm_idp.keys.oauth_keys import OAuthKeys
    from ztpm_idp.keys.watched_file import Beside
    from ztpm_idp.login_settings import LoginProvider
    from ztpm_idp.provider.metrics_access import MetricsAccess
    from ztpm_idp.provider.provider import Provider
    from ztpm_idp.settings import Settings
    from ztpm_idp.web_push_settings import WebPush
    from ztpm_idp.webhook_settings import Webhook

TLS: Final = "tls_certificate_file"
"""Name under which a fault of certificate or key is told."""
GRACE_S: Final = 5
"""Seconds that open requests may take to end after SIGTERM."""


def serve(
    settings: Settings,
    keys: IdpKeys,
    platform: Platform | None = None,
    policies: PolicySet | None = None,
    login_providers: tuple[LoginProvider, ...] = (),
    *,
    folder: Path,
    oauth: OAuthKeys | None = None,
    publishers: Mapping[str, frozenset[bytes]] = MappingProxyType({}),
    metrics: MetricsAccess | None = None,
    webhooks: tuple[Webhook, ...] = (),
    web_push: WebPush | None = None,
    watch: Callable[[Provider], Iterable[Beside]] = lambda _: (),
) -> None:
    """Serve until SIGTERM or SIGINT. Returns when every open request has ended and the store is closed.

    Args:
        settings: checked already.
        keys: the five private keys.
        platform: the platform whose workload tokens count, if any.
        policies: the set that decides on delegations; None: the shipped set that the settings name.
        login_providers: OpenID providers at which people may log in.
        folder: where relative names of TLS files start.
        oauth: keys of the authorization server, if there is one.
        publishers: raw public keys by name of each whose releases count.
        metrics: right to read the figures; None: on this machine alone.
        webhooks: that are told of open questions and latches.
        web_push: the way to people's devices; None: there is none.
        watch: names what runs beside, so that files and keys take effect while it serves (`ztpm_idp.watching`).

    Raises:
        StoreNotOpenedError: the database cannot be had.
        UnavailableError: nor the certificate or the port.
    """
    from ztpm.edge.server import EdgeServer
    from ztpm_idp.app import create_app

    asyncio.run(_check_store(settings.database_url))
    app = create_app(
        settings,
        keys,
        platform=platform,
        policies=policies,
        oauth_keys=oauth,
        login_providers=login_providers,
        publishers=publishers,
        metrics_access=metrics,
        webhooks=webhooks,
        web_push=web_push,
        watch=watch,
    )

    class Announcing(EdgeServer):
        """Says on standard output, in one JSON line, that it listens; lets nobody wait once it is told to end."""

        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            spare_what_stands()
            sys.stdout.write(json.dumps({"ready": True, "port": settings.port}) + "\n")
            sys.stdout.flush()

        async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
            # The application is told of its end only after every request has ended; one that waits must be told before.
            app.state.provider.epochs.close()  # there is a provider from the start of the application on
            await super().shutdown(sockets)

    def check() -> None:
        try:
            check_tls_files(settings, folder, at=time.time())
        except SettingsError as error:
            raise ValueError(f"{error.setting}: {error.why}") from None

    def tell(fault: str | None) -> None:
        faults: dict[str, str] = app.state.provider.faults
        if fault is None:
            faults.pop(TLS, None)
        else:
            faults[TLS] = fault

    named = (settings.tls_certificate_file, settings.tls_key_file)
    certificate, key = (None if name is None else str(folder / name) for name in named)
    Announcing(
        app,
        host=settings.host,
        port=settings.port,
        ssl_certfile=certificate,
        ssl_keyfile=key,
        check_tls=check,
        tell_tls=tell,
        lifespan="on",
        log_level="warning",
        timeout_graceful_shutdown=GRACE_S,
    ).run()


async def _check_store(database_url: str) -> None:
    """Brings the store to the newest schema: the application's own failure would end in a traceback."""
    await (await Store.open(database_url)).close()


def _told(code: str, sentence: str) -> int:
    """Tells a person; the exit status."""
    sys.stderr.write(f"{line_of(code, sentence)}\n")
    return status_of(code)


def main() -> int:
    """Serves by the configuration; the exit status."""
    from ztpm.edge.log import tell
    from ztpm_idp.provider import observing

    parser = argparse.ArgumentParser(
        prog="python -m ztpm.point.provider_server", description="The ZTPM identity provider."
    )
    parser.add_argument("--config", required=True, type=Path, help="idp.toml")
    config: Path = parser.parse_args().config
    tell(sys.stderr, context=observing.context, accesses=observing.ACCESS.name)
    os.umask(0o077)  # the database is nobody else's
    try:
        passphrase = passphrase_of(PASSPHRASE_VARIABLE, os.environ)
        # Taken out of the environment, so that no child and no dump of it has it.
        os.environ.pop(PASSPHRASE_VARIABLE, None)
        read = read_deployment(config, passphrase, at=time.time())
        watch = watching(read.settings, config, passphrase, read.keys)
    except SettingsError as error:
        return _told("CONFIG_INVALID", f"{config}: {error.setting}: {error.why}")
    for each in read.webhooks:  # likewise, now that it is read
        os.environ.pop(each.stated.url_variable or "", None)
    observing.ACCESS.disabled = not read.settings.access_log
    # The server hands the signal back when it has ended in order; that is success, not death by signal.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    try:
        with exporting("ztpm-idp", os.environ):
            serve(
                read.settings.settings(read.keys),
                read.keys,
                read.platform,
                read.policies,
                read.login_providers,
                folder=config.parent,
                oauth=read.oauth,
                publishers=read.publishers,
                metrics=read.metrics,
                webhooks=read.webhooks,
                web_push=read.web_push,
                watch=watch,
            )
    except (StoreNotOpenedError, UnavailableError) as error:
        return _told(error.code, error.sentence)
    return 0


if __name__ == "__main__":
    sys.exit(main())
