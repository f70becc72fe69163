"""Keys in a hardware module: SoftHSM, Debian's package `softhsm2`, stands for one."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from capabilities.keys.windows import Role
from capabilities.rotation.rotation_json import ring_to_json
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain
from capabilities.values.errors import BadKeyError
from tests.ztpm_idp.keys.test_keys import verified
from tests.ztpm_idp.test_lending import SLOWER, refused, tree
from tests.ztpm_idp.world import ISSUER, START_S, World
from ztpm_idp.keys import hardware_token, key_ring
from ztpm_idp.keys.key_files import SettingsError, SignerUnavailableError
from ztpm_idp.settings import load_settings

from capabilities.keys import keys, signatures
from capabilities.rotation import rotation

MODULE = Path("/usr/lib/softhsm/libsofthsm2.so")
PIN, LABEL = "4711", "ztpm-test"
BEGUN = int(START_S) - 1_000
LINES = f'[pkcs11]\nmodule = "{MODULE}"\ntoken = "{LABEL}"\nroles = ["root", "attester"]\n'


@pytest.fixture(scope="module")
def token(tmp_path_factory):
    pytest.importorskip("pkcs11", reason="python-pkcs11 is not installed")
    if not MODULE.exists() or shutil.which("softhsm2-util") is None:
        pytest.skip("SoftHSM is not installed (Debian: softhsm2)")
    folder = tmp_path_factory.mktemp("hsm")
    (folder / "tokens").mkdir()
    config = folder / "softhsm2.conf"
    config.write_text(f"directories.tokendir = {folder}/tokens\nobjectstore.backend = file\nlog.level = ERROR\n")
    before = os.environ.get("SOFTHSM2_CONF")
    os.environ["SOFTHSM2_CONF"] = str(config)  # the library reads it once in the life of a process
    made = ["softhsm2-util", "--init-token", "--free", "--label", LABEL, "--pin", PIN, "--so-pin", "0815"]
    subprocess.run(made, check=True, capture_output=True)  # noqa: S603
    yield hardware_token.HardwareToken(str(MODULE), LABEL, PIN)
    os.environ.pop("SOFTHSM2_CONF")
    if before is not None:
        os.environ["SOFTHSM2_CONF"] = before


@pytest.fixture(scope="module")
def ring(token, tmp_path_factory):
    """A ring whose root and attester are in the module, and its folder with the other private keys."""
    folder = tmp_path_factory.mktemp("ring")
    public = {}
    for role in Role:
        name = f"{rotation.ID_STEM[role]}-1"
        if role in {Role.ROOT, Role.ATTESTER}:
            public[role] = token.make(name, keys.Algorithm.ED25519)
            continue
        key = keys.generate()
        public[role] = keys.public_raw(key)
        path = folder / f"{name}.key"
        path.touch(0o600)
        path.write_bytes(keys.to_pem(key, b"secret"))
    path = folder / "keys.json"
    path.touch(0o600)
    path.write_bytes(ring_to_json(rotation.begin(ISSUER, public, at=BEGUN)))
    return folder


def test_the_module_signs_what_is_lent(token, ring, tmp_path):
    own = key_ring.load("keys.json", ring, ISSUER, "secret", hardware=token)
    assert {type(own.root), type(own.attester)} == {hardware_token.HardwareKey}
    with World(tmp_path, idp_keys=own) as world:
        planner, mover, lent = tree(world)
        narrower = planner.delegate(lent.token, mover, SLOWER, purpose="move the arm")
        chain = verified(world, narrower.token, own.ring.bundle(DEFAULT))
        assert isinstance(chain, Chain)
        assert chain.leaf.agent == "mover"


def ledger(world):
    return [line for line in world.people["alice"].export_ledger().splitlines() if b'"kind":"' in line]


@pytest.mark.parametrize("algorithm", list(keys.Algorithm))
def test_a_key_of_the_module_signs_as_any_other(token, algorithm):
    name = f"ledger-{algorithm}"
    raw = token.make(name, algorithm)
    key = token.key(name, raw)
    assert keys.public_raw(key) == raw
    assert keys.algorithm_of(raw) is algorithm
    for n in range(8):  # of P-256, both halves of s come back
        assert signatures.verify(raw, bytes([n]), signatures.sign(key, bytes([n])))
    with pytest.raises(SettingsError):
        token.make(name, algorithm)
    with pytest.raises(SettingsError):
        token.key(name, keys.public_raw(keys.generate()))
    with pytest.raises(SettingsError):
        token.key("feed-7", raw)


def test_a_module_that_does_not_sign_is_said_and_nothing_is_done(token, ring, tmp_path, monkeypatch):
    own = key_ring.load("keys.json", ring, ISSUER, "secret", hardware=token)
    with World(tmp_path, idp_keys=own) as world:
        planner = world.agent("planner")
        monkeypatch.setattr(token, "_label", "pulled out")
        token._session.close()
        error = refused(world.people["alice"].issue, planner, world.scope(), purpose="p")
        assert (error.code, error.status) == ("SIGNER_UNAVAILABLE", 503)
        assert refused(world.people["alice"].issue, planner, world.scope(), purpose="p").status == 503
        kinds = [line.split(b'"kind":"')[1].split(b'"')[0] for line in ledger(world)]
        assert b"token-issued" not in kinds
        monkeypatch.undo()  # and back in again
        world.people["alice"].issue(planner, world.scope(), purpose="p")
    with pytest.raises(SignerUnavailableError):
        token.sign("gone", keys.public_raw(own.root), b"x")
    monkeypatch.setattr(token, "_signed", lambda *_: bytes(64))
    with pytest.raises(BadKeyError):
        signatures.sign(own.root, b"x")


def test_a_session_that_was_lost_is_opened_again(token, ring):
    own = key_ring.load("keys.json", ring, ISSUER, "secret", hardware=token)
    token._session.close()
    assert signatures.verify(own.root.public, b"x", signatures.sign(own.root, b"x"))


def test_what_is_configured_wrongly(token, tmp_path, monkeypatch):
    for module, label, pin in [("/nowhere.so", LABEL, PIN), (str(MODULE), "nobody", PIN)]:
        with pytest.raises(SettingsError) as caught:
            hardware_token.HardwareToken(module, label, pin)
        assert caught.value.setting == "pkcs11"
    monkeypatch.delenv("ZTPM_PKCS11_PIN", raising=False)
    with pytest.raises(SettingsError) as caught:
        hardware_token.open_token(str(MODULE), LABEL)
    assert caught.value.setting == "ZTPM_PKCS11_PIN"


def test_a_module_needs_a_ring(tmp_path):
    from tests.ztpm_idp.test_settings import write_config  # noqa: PLC0415

    path = write_config(tmp_path)
    path.write_text(f"{path.read_text()}\n{LINES}")
    with pytest.raises(SettingsError) as caught:
        load_settings(path)
    assert caught.value.setting == "pkcs11"
