"""Layout of a cell's files: one directory; private keys are encrypted and readable by their owner alone."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys

if TYPE_CHECKING:
    from pathlib import Path

    from capabilities.keys.keys import PrivateKey

OPERATORS: Final = ("alice", "bob", "carol")
"""Three, so that a tier-4 act can have two different approvers besides its sponsor."""
SURVEYOR: Final = "carol"
"""The operator who signs the embedded cell's file."""


class LayoutError(RuntimeError):
    """A directory that is not as it should be."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Paths below one root directory."""

    root: Path

    @property
    def trust(self) -> Path:
        """The public trust bundle."""
        return self.root / "trust.json"

    @property
    def idp_config(self) -> Path:
        """Configuration of the identity provider."""
        return self.root / "idp" / "idp.toml"

    @property
    def database(self) -> Path:
        """Store of the identity provider."""
        return self.root / "idp" / "idp.sqlite"

    @property
    def cell_config(self) -> Path:
        """Configuration of the tool server."""
        return self.root / "cell" / "cell.toml"

    @property
    def gateway_config(self) -> Path:
        """Configuration of the robot's gateway."""
        return self.root / "gateway" / "gateway.toml"

    @property
    def calibration(self) -> Path:
        """Kinematics of the cell's own arm, where its controller has told some."""
        return self.root / "gateway" / "calibration.yaml"

    @property
    def gateway_key(self) -> Path:
        """The gateway's key."""
        return self.root / "gateway" / "gateway.key"

    @property
    def gateway_journal(self) -> Path:
        """The gateway's durable journal."""
        return self.root / "gateway" / "journal.ndjson"

    @property
    def gateway_state(self) -> Path:
        """Directory of the gateway's state over restarts."""
        return self.root / "gateway" / "state"

    @property
    def cell_file(self) -> Path:
        """File of the cell's surveyed objects, signed by `SURVEYOR`."""
        return self.root / "cell" / "cell.jws"

    @property
    def cell_draft(self) -> Path:
        """Draft of the cell file, for the person who surveys the cell."""
        return self.root / "cell" / "cell.draft.toml"

    @property
    def controller(self) -> Path:
        """Word of the controller on itself, there in a cell that was made for one (`ztpm init --robot`)."""
        return self.root / "controller.json"

    @property
    def first_scope(self) -> Path:
        """Scope of a first move, with the cell's own audience."""
        return self.root / "first.scope.json"

    @property
    def services(self) -> Path:
        """Folder of what keeps the cell's processes running: units of systemd, a compose file."""
        return self.root / "deploy"

    @property
    def authority(self) -> Path:
        """Certificate of the cell's own authority, which all who connect believe; there where it has one."""
        return self.root / "tls" / "ca.pem"

    @property
    def authority_key(self) -> Path:
        """Key of that authority."""
        return self.root / "tls" / "ca.key"

    def certificate(self, machine: str) -> Path:
        """Certificate chain of a machine, "provider", "gateway" or "tools"."""
        return self.root / "tls" / f"{machine}.pem"

    def certificate_key(self, machine: str) -> Path:
        """Its key, without a passphrase."""
        return self.root / "tls" / f"{machine}.key"

    @property
    def journal(self) -> Path:
        """The PEP's durable journal."""
        return self.root / "cell" / "journal.ndjson"

    @property
    def state(self) -> Path:
        """Directory of the PEP's state over restarts."""
        return self.root / "cell" / "state"

    @property
    def pep_key(self) -> Path:
        """The PEP's key."""
        return self.root / "cell" / "pep.key"

    @property
    def sensor_key(self) -> Path:
        """The simulated sensor's key."""
        return self.root / "cell" / "sensor.key"

    @property
    def second_sensor_key(self) -> Path:
        """The second simulated sensor's key, there in a cell that was made with two."""
        return self.root / "cell" / "sensor-2.key"

    @property
    def platform_key(self) -> Path:
        """The simulated platform attestor's key."""
        return self.root / "platform" / "platform.key"

    @property
    def platform_jwks(self) -> Path:
        """Its public half, as the identity provider reads it."""
        return self.root / "platform" / "jwks.json"

    @property
    def enrolled(self) -> Path:
        """There once the cell's parts are registered."""
        return self.root / "cell" / "enrolled"

    @property
    def scene(self) -> Path:
        """File of the simulated sensor's scene: the object that it takes as a command, where there is one."""
        return self.root / "cell" / "scene.json"

    @property
    def lock(self) -> Path:
        """Held by the `ztpm up` that runs the cell."""
        return self.root / "up.lock"

    @property
    def log(self) -> Path:
        """Log of `ztpm up`, as JSON lines."""
        return self.root / "up.log"

    @property
    def key_ring(self) -> Path:
        """File of the identity provider's keys, with the ones that sign."""
        return self.root / "idp" / "keys.json"

    @property
    def key_lock(self) -> Path:
        """Lock of the step of a rotation that is being taken."""
        return self.root / "idp" / "keys.lock"

    def idp_key(self, id_: str) -> Path:
        """A private key of the identity provider, by the name that the ring gives it: "root-2"."""
        return self.root / "idp" / f"{id_}.key"

    def operator_key(self, name: str) -> Path:
        """An operator's key."""
        return self.root / "operators" / f"{name}.key"

    def agent_key(self, name: str) -> Path:
        """An agent's key."""
        return self.party_key("agent", name)

    def party_key(self, kind: str, name: str) -> Path:
        """The key of an agent, enforcement point or sensor that was registered from this directory.

        `kind` is the word of its kind, "agent", "pep" or "sensor".
        """
        return self.root / f"{kind}s" / f"{name}.key"


def write_private(path: Path, content: bytes) -> None:
    """Writes a new file with mode 0600 from its first instant, synced to disk.

    Raises:
        LayoutError: when it exists already; a key is never overwritten.
    """
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError as error:
        raise LayoutError(f"{path} exists already") from error
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def replace_private(path: Path, content: bytes) -> None:
    """Replaces the file's content whole, with mode 0600.

    Raises:
        OSError: when it cannot be written; it is as it was then.
    """
    beside = path.with_name(f"{path.name}.new")
    beside.unlink(missing_ok=True)
    write_private(beside, content)
    beside.replace(path)
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def new_key(path: Path, passphrase: bytes, algorithm: keys.Algorithm = keys.Algorithm.ED25519) -> PrivateKey:
    """A fresh key, stored encrypted at `path`."""
    key = keys.generate(algorithm)
    write_private(path, keys.to_pem(key, passphrase))
    return key


def read_key(path: Path, passphrase: bytes) -> PrivateKey:
    """The key stored at `path`.

    Raises:
        LayoutError: when the file is missing or others can read it.
        capabilities.values.errors.BadKeyError: when it is no key or the passphrase is wrong.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError as error:
        raise LayoutError(f"{path} is missing") from error
    if mode & 0o077:
        raise LayoutError(f"{path} can be read by others (mode {mode & 0o777:o}); it must be 600")
    return keys.from_pem(path.read_bytes(), passphrase)
