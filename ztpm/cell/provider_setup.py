"""Making of an identity provider: keys, trust bundle, configuration, first people. Body of `ztpm idp init`."""

from __future__ import annotations

import asyncio
import json
import shutil
import time
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from capabilities.keys import keys
from capabilities.rotation import rotation
from capabilities.rotation.rotation_json import ring_to_json
from capabilities.values.caps import DEFAULT
from ztpm.base.layout import LayoutError, new_key, write_private
from ztpm_idp.keys.key_files import SettingsError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from ztpm.base.layout import Layout
    from ztpm_idp.bootstrap import FirstPerson

OAUTH_KEY: Final = "oauth-1"
"""Name of the first key that signs access tokens."""
ROLES: Final = ("sponsor", "approver", "admin")
"""Roles of each of the first people."""
HTTPS_PORT: Final = 443
ANY_HOST: Final = "0.0.0.0"  # noqa: S104 - with TLS only: the settings refuse it without
LOOPBACK: Final = "127.0.0.1"
LOOPBACK_PORT: Final = 8700


@dataclass(frozen=True, slots=True)
class ProviderPlan:
    """Identity provider that is to be made.

    Attributes:
        issuer: its base URL with a path, as every machine reaches it.
        people: first administrators by id, each with a raw public key of its own, or None: its key is made here.
        host, port: of its listener; where they are empty or 0, `listener` says which.
        certificate, key: PEM files for TLS, or neither.
        database_url: empty: SQLite in the directory.
        policy: name of a shipped policy set, or a TOML file's path.
    """

    issuer: str
    people: Mapping[str, bytes | None] = field(repr=False)
    host: str = ""
    port: int = 0
    certificate: Path | None = None
    key: Path | None = None
    database_url: str = ""
    policy: str = "paper-default"

    @property
    def listener(self) -> tuple[str, int]:
        """Host and port: every interface where there is TLS, else loopback alone, for a TLS proxy before it."""
        parts = urlsplit(self.issuer)
        try:
            stated = parts.port
        except ValueError:
            stated = None  # the settings say what is wrong with such an issuer
        if self.certificate is not None:
            return self.host or ANY_HOST, self.port or stated or HTTPS_PORT
        if parts.scheme == "https":
            return self.host or LOOPBACK, self.port or LOOPBACK_PORT
        return self.host or parts.hostname or LOOPBACK, self.port or stated or LOOPBACK_PORT

    def settings(self, layout: Layout) -> dict[str, str | int | list[str]]:
        """Settings as they stand in idp.toml."""
        host, port = self.listener
        tls = {"tls_certificate_file": self.certificate, "tls_key_file": self.key}
        return {
            "issuer": self.issuer,
            "host": host,
            "port": port,
            "database_url": self.database_url or sqlite_url(layout),
            "key_ring_file": str(layout.key_ring),
            "oauth_key_files": [str(layout.idp_key(OAUTH_KEY))],
            "policy": self.policy,
            **{name: str(file.resolve()) for name, file in tls.items() if file is not None},
        }


def initialise_provider(layout: Layout, plan: ProviderPlan, *, passphrase: bytes, at: int) -> None:
    """Makes every file of a new provider, and its first people in its store, or no file.

    Args:
        layout: an empty or missing directory.
        plan: of the provider.
        passphrase: encrypts every private key that is made here.
        at: seconds since the epoch.

    Raises:
        ztpm.base.layout.LayoutError: when the directory has anything in it.
        ztpm_idp.keys.key_files.SettingsError: naming the setting with which the provider would not start.
        ztpm_idp.provider.problems.Problem: when the store has people already, or those of the plan are refused.
        ztpm_idp.store.StoreUnavailableError: when the store cannot be opened.
        OSError: when the directory cannot be written.
    """
    with whole_or_nothing(layout):
        fill_provider(layout, plan, passphrase=passphrase, at=at)


@contextmanager
def whole_or_nothing(layout: Layout) -> Iterator[None]:
    """The directory, empty or missing before, holds all that the block makes, or is as it was.

    Raises:
        ztpm.base.layout.LayoutError: when the directory has anything in it.
        OSError: when it cannot be written.
    """
    missing = not layout.root.exists()
    layout.root.mkdir(mode=0o700, parents=True, exist_ok=True)
    if any(layout.root.iterdir()):
        raise LayoutError(f"{layout.root} is not empty")
    try:
        yield
    except BaseException:
        # The directory was empty: all that is in it is ours.
        for made in layout.root.iterdir():
            if made.is_dir():
                shutil.rmtree(made)
            else:
                made.unlink()
        if missing:
            layout.root.rmdir()
        raise


def fill_provider(layout: Layout, plan: ProviderPlan, *, passphrase: bytes, at: int) -> None:
    """Makes every file of a new provider, and its first people in its store.

    Args, Raises: see `initialise_provider`.
    """
    from ztpm_idp.bootstrap import FirstPerson

    write_private(layout.idp_config, toml(plan.settings(layout)))
    check_configuration(layout)
    people = []
    for name, given in plan.people.items():
        public = keys.public_raw(new_key(layout.operator_key(name), passphrase)) if given is None else given
        people.append(FirstPerson(id=name, name=name, key=public, roles=ROLES))
    ring = make_ring(layout, plan.issuer, passphrase, at=at)
    new_key(layout.idp_key(OAUTH_KEY), passphrase)
    write_private(layout.key_ring, ring_to_json(ring))
    write_private(layout.trust, ring.bundle(DEFAULT).to_json())
    put_first_people(layout, people)


def check_configuration(layout: Layout) -> None:
    """Reads idp.toml by the reader that the provider starts with, its policies and its TLS files too.

    Raises:
        SettingsError: naming the setting that is refused.
    """
    from ztpm_idp.settings import load_policies, load_settings

    folder = layout.idp_config.parent
    settings = load_settings(layout.idp_config)
    load_policies(settings, folder)
    for name in ("tls_certificate_file", "tls_key_file"):
        file = getattr(settings, name)
        if file is not None and not (folder / file).is_file():
            raise SettingsError(name, "the file cannot be read")


def make_ring(layout: Layout, issuer: str, passphrase: bytes, *, at: int) -> rotation.KeyRing:
    """First keys of an identity provider, with their files written under the ring's names."""
    first = {role: new_key(layout.idp_key(f"{stem}-1"), passphrase) for role, stem in rotation.ID_STEM.items()}
    return rotation.begin(issuer, {role: keys.public_raw(key) for role, key in first.items()}, at=at)


def put_first_people(layout: Layout, people: Iterable[FirstPerson]) -> None:
    """First people of the store that idp.toml names.

    Raises:
        ztpm_idp.provider.problems.Problem: as `ztpm_idp.bootstrap.initialise`.
        ztpm_idp.store.StoreUnavailableError: the store cannot be opened.
    """
    from ztpm_idp.bootstrap import initialise
    from ztpm_idp.settings import load_settings

    asyncio.run(initialise(load_settings(layout.idp_config).database_url, people=people, now=time.time))


def sqlite_url(layout: Layout) -> str:
    """The database URL of a store in the directory."""
    return f"sqlite+aiosqlite:///{layout.database}"


def toml(settings: Mapping[str, str | int | list[str]]) -> bytes:
    """Lines of TOML.

    A string as JSON spells it is a TOML basic string, but for DEL, which TOML wants escaped.

    Raises:
        SettingsError: for a name that is not UTF-8.
    """
    lines = []
    for name, value in settings.items():
        try:
            spelled = json.dumps(value, ensure_ascii=False).encode()
        except UnicodeEncodeError as error:
            raise SettingsError(name, "not UTF-8") from error
        lines.append(b"%s = %s\n" % (name.encode(), spelled.replace(b"\x7f", rb"\u007f")))
    return b"".join(lines)
