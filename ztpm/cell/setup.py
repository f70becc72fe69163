"""Making of a cell's directory: keys, trust bundle, configurations, first operators. Body of `ztpm init`."""

from __future__ import annotations

import hashlib
import shutil
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from msgspec import structs

from capabilities.keys import keys
from capabilities.rotation.rotation_json import ring_to_json
from capabilities.statements import cell as cell_statement
from capabilities.statements import workload
from capabilities.values.caps import DEFAULT
from ztpm.base.layout import OPERATORS, SURVEYOR, Layout, LayoutError, new_key, write_private
from ztpm.cell import survey
from ztpm.cell.addresses import NAME, ROBOT_PORTS, Addresses, SetupError, free_addresses
from ztpm.cell.provider_setup import OAUTH_KEY, ROLES, make_ring, put_first_people, sqlite_url, toml
from ztpm.cell.simulated_platform import TRUST_DOMAIN
from ztpm.cell.site import read_site
from ztpm_idp.keys.key_files import SettingsError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.keys.keys import PrivateKey

__all__ = [
    "GATEWAY_ID",
    "PEP_ID",
    "ROBOT_PORTS",
    "SECOND_SENSOR_ID",
    "SENSOR_CALIBRATION",
    "SENSOR_ID",
    "SENSOR_TRANSIT_MS",
    "Addresses",
    "SetupError",
    "free_addresses",
    "initialise",
    "is_empty",
    "read_addresses",
    "sensor_keys",
]

PEP_ID: Final = "cell-1"
GATEWAY_ID: Final = "gateway-1"
SENSOR_ID: Final = "camera-1"
SECOND_SENSOR_ID: Final = "camera-2"
SENSOR_CALIBRATION: Final = hashlib.sha256(b"simulated sensor, ideal pinhole, base frame").hexdigest()
"""Digest of the calibration document; a simulated sensor's is this sentence."""
SENSOR_TRANSIT_MS: Final = 20
"""Declared longest transit of a frame from a simulated sensor on loopback."""


def sensor_keys(layout: Layout) -> dict[str, Path]:
    """Key files of a cell's sensors by id, of two in a cell that was made with two."""
    second = {SECOND_SENSOR_ID: layout.second_sensor_key} if layout.second_sensor_key.exists() else {}
    return {SENSOR_ID: layout.sensor_key, **second}


def read_addresses(layout: Layout) -> Addresses:
    """Addresses of the cell in a directory, by all its configurations.

    Args:
        layout: made by `initialise`.

    Raises:
        SetupError: naming a setting that is missing, refused or not the same in all; an embedded cell has one
            loopback host, one with a controller of its own those of `ztpm.cell.site`.
    """
    from pep.base.errors import ConfigError
    from ztpm.point.gateway_config import read_gateway_config
    from ztpm.point.tool_proxy_config import read_door_config
    from ztpm_idp.settings import load_settings

    if layout.controller.exists():
        return read_site(layout)
    try:
        idp, door = load_settings(layout.idp_config), read_door_config(layout.cell_config)
        gateway = read_gateway_config(layout.gateway_config)
    except SettingsError as error:
        raise SetupError(str(error)) from error
    except ConfigError as error:
        raise SetupError(error.detail) from error
    addresses = Addresses(
        door.host,
        idp_port=idp.port,
        tools_port=door.port,
        perception_port=gateway.perception_port,
        door_port=gateway.port,
        carriage_port=gateway.carriage_port,
        named=urlsplit(idp.issuer).hostname == NAME,
    )
    stated = (
        ("idp.toml: host", idp.host, addresses.provider_host),
        ("idp.toml: issuer", idp.issuer, addresses.issuer),
        ("cell.toml: issuer", door.issuer, addresses.issuer),
        ("cell.toml: audience", door.audience, addresses.audience),
        ("cell.toml: gateway_url", door.gateway_url, addresses.calls),
        ("gateway.toml: issuer", gateway.issuer, addresses.issuer),
        ("gateway.toml: audience", gateway.audience, addresses.audience),
        ("gateway.toml: host", gateway.host, addresses.gateway_host),
        ("gateway.toml: listen_host", gateway.listen_host, addresses.gateway_host),
        ("gateway.toml: url", gateway.url, addresses.door),
        ("gateway.toml: calls_url", gateway.calls_url, addresses.calls),
        ("gateway.toml: robot_host", gateway.robot_host, addresses.host),
    )
    for name, value, expected in stated:
        if value != expected:
            raise SetupError(f"{name} is {value}; an embedded cell on this host and these ports has {expected}")
    return addresses


def initialise(
    layout: Layout,
    addresses: Addresses,
    *,
    passphrase: bytes,
    policy: str,
    defer_timeout_s: int,
    second_sensor: bool = False,
) -> None:
    """Makes every file of a new cell and its three operators, or no file.

    Args:
        layout: an empty or missing directory; the lock of a `ztpm up` does not count.
        addresses: addresses of the new cell.
        passphrase: encrypts every private key.
        policy: name of a shipped policy set, or a path.
        defer_timeout_s: time for which the PEP waits for an answer to a deferral.
        second_sensor: a second sensor watches the same cell, with a key of its own; both must be heard.

    Raises:
        ztpm.base.layout.LayoutError: when the directory has anything in it.
        SetupError: when the services would not start on these settings.
        OSError: when the directory cannot be written.
    """
    missing = not layout.root.exists()
    layout.root.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not is_empty(layout):
        raise LayoutError(f"{layout.root} is not empty")
    try:
        new_key(layout.sensor_key, passphrase)
        if second_sensor:
            new_key(layout.second_sensor_key, passphrase)
        _fill(layout, addresses, passphrase, policy, defer_timeout_s)
    except BaseException:
        # The directory was empty: all that is in it is ours.
        for made in layout.root.iterdir():
            if made != layout.lock:
                shutil.rmtree(made) if made.is_dir() else made.unlink()
        if missing:
            layout.root.rmdir()
        raise


def is_empty(layout: Layout) -> bool:
    """True where nothing is in the directory but the lock of a `ztpm up`."""
    return all(entry == layout.lock for entry in layout.root.iterdir())


def _fill(layout: Layout, addresses: Addresses, passphrase: bytes, policy: str, defer_timeout_s: int) -> None:
    write_private(layout.idp_config, _lines(_idp_settings(layout, addresses)))
    operators = {name: new_key(layout.operator_key(name), passphrase) for name in OPERATORS}
    surveyor = operators[SURVEYOR]
    door = _door_settings(layout, addresses, policy)
    write_private(layout.cell_config, _lines(door | {"gateway_url": addresses.calls}))
    gateway = door | _gateway_settings(layout, addresses, defer_timeout_s, surveyor)
    write_private(layout.gateway_config, _lines(gateway) + b"\n[cell]\n")
    _check_readable(layout)
    stands = structs.replace(
        survey.embedded(audience=addresses.audience, author=SURVEYOR, sensor=SENSOR_ID, at=int(time.time())),
        sensors=tuple(sensor_keys(layout)),
    )
    write_private(layout.cell_file, cell_statement.sign(stands, surveyor).encode() + b"\n")
    ring = make_ring(layout, addresses.issuer, passphrase, at=int(time.time()))
    new_key(layout.idp_key(OAUTH_KEY), passphrase)
    platform = new_key(layout.platform_key, passphrase)
    write_private(layout.platform_jwks, workload.jwks(keys.public_raw(platform)))
    new_key(layout.pep_key, passphrase)
    new_key(layout.gateway_key, passphrase)
    for state in (layout.state, layout.gateway_state):
        state.mkdir(mode=0o700, parents=True, exist_ok=True)
    write_private(layout.key_ring, ring_to_json(ring))
    write_private(layout.trust, ring.bundle(DEFAULT).to_json())
    _bootstrap(layout, operators)


def _check_readable(layout: Layout) -> None:
    """Reads every service's configuration by the reader that it starts with.

    Raises:
        SetupError: naming what is refused.
    """
    from pep.base.errors import ConfigError
    from ztpm.point.cell_config import read_policies
    from ztpm.point.gateway_config import read_gateway_config
    from ztpm.point.tool_proxy_config import read_door_config
    from ztpm_idp.settings import load_settings

    try:
        load_settings(layout.idp_config)
        read_policies(read_door_config(layout.cell_config))
        read_gateway_config(layout.gateway_config)
    except SettingsError as error:
        raise SetupError(str(error)) from error
    except ConfigError as error:
        raise SetupError(error.detail) from error


def _lines(settings: Mapping[str, str | int | list[str]]) -> bytes:
    """Lines of TOML.

    Raises:
        SetupError: for a name that is not UTF-8.
    """
    try:
        return toml(settings)
    except SettingsError as error:
        raise SetupError(str(error)) from error


def _idp_settings(layout: Layout, addresses: Addresses) -> dict[str, str | int | list[str]]:
    return {
        "issuer": addresses.issuer,
        "host": addresses.provider_host,
        "port": addresses.idp_port,
        "database_url": sqlite_url(layout),
        "key_ring_file": str(layout.key_ring),
        "oauth_key_files": [str(layout.idp_key(OAUTH_KEY))],
        "platform_trust_domain": TRUST_DOMAIN,
        "platform_jwks_file": str(layout.platform_jwks),
        # The last lines that a process of the cell said are shown when it fails.
        "access_log": False,
    }


def _door_settings(layout: Layout, addresses: Addresses, policy: str) -> dict[str, str | int]:
    return {
        "audience": addresses.audience,
        "host": addresses.host,
        "port": addresses.tools_port,
        "pep_id": PEP_ID,
        "issuer": addresses.issuer,
        "trust_file": str(layout.trust),
        "pep_key_file": str(layout.pep_key),
        "journal_file": str(layout.journal),
        "state_dir": str(layout.state),
        # A server may start in another directory: a path is written whole.
        "policy": str(Path(policy).resolve()) if Path(policy).is_file() else policy,
    }


def _gateway_settings(
    layout: Layout, addresses: Addresses, defer_timeout_s: int, surveyor: PrivateKey
) -> dict[str, str | int]:
    """Settings of the gateway: its differences from the tool server's, and its own."""
    return {
        "host": addresses.gateway_host,
        "port": addresses.door_port,
        "pep_id": GATEWAY_ID,
        "pep_key_file": str(layout.gateway_key),
        "journal_file": str(layout.gateway_journal),
        "state_dir": str(layout.gateway_state),
        "robot_host": addresses.host,
        "perception_port": addresses.perception_port,
        "defer_timeout_s": defer_timeout_s,
        "cell_file": str(layout.cell_file),
        "cell_signer_key": keys.b64u(keys.public_raw(surveyor)),
        "url": addresses.door,
        "calls_url": addresses.calls,
        "listen_host": addresses.gateway_host,
        "carriage_port": addresses.carriage_port,
    }


def _bootstrap(layout: Layout, operators: dict[str, PrivateKey]) -> None:
    from ztpm_idp.bootstrap import FirstPerson
    from ztpm_idp.store.errors import StoreUnavailableError

    people = [
        FirstPerson(id=name, name=name.title(), key=keys.public_raw(key), roles=ROLES)
        for name, key in operators.items()
    ]
    try:
        put_first_people(layout, people)
    except StoreUnavailableError as error:
        raise SetupError(f"database_url: {layout.database} cannot be made") from error
