"""`ztpm keys` on the files of a cell: a rotation by an operator, and the provider that starts on it."""

from __future__ import annotations

import json
import shutil
import stat
import time

import pytest
from capabilities.keys.trust import TrustBundle
from capabilities.keys.windows import Role
from capabilities.rotation.rotation import KeyState
from capabilities.rotation.succession import check_bundle, succeed
from capabilities.values.caps import DEFAULT
from tests.ztpm.cli.conftest import PASSPHRASE
from ztpm.base.layout import Layout
from ztpm.base.lock import DirectoryLock
from ztpm_idp.keys.key_files import SettingsError
from ztpm_idp.keys.key_ring import check_current
from ztpm_idp.settings import load_keys, load_settings

from capabilities.keys import keys
from capabilities.statements import trust as trust_statement
from ztpm.cell import key_ring


@pytest.fixture
def copy(cell, tmp_path):
    """A cell's directory of one's own, whose provider reads the keys of this directory."""
    shutil.copytree(cell.root, tmp_path / "cell")
    layout = Layout(tmp_path / "cell")
    config = layout.idp_config.read_text().replace(str(cell.root), str(layout.root))
    layout.idp_config.write_text(config)
    return layout


def did(run, layout, *arguments):
    told = run("keys", *arguments, "--data", layout.root, "--json")
    assert told.status == 0, told.out + told.err
    return told.json


def refused(run, layout, *arguments):
    told = run("keys", *arguments, "--data", layout.root, "--json")
    assert told.json["ok"] is False
    return told.status, told.json["code"]


def bundle_of(layout) -> TrustBundle:
    return TrustBundle.from_json(layout.trust.read_bytes())


def loaded(layout, passphrase=PASSPHRASE):
    settings = load_settings(layout.idp_config)
    return settings, load_keys(settings, layout.idp_config.parent, passphrase)


def test_a_new_cell_has_one_key_of_each_role(run, copy):
    told = did(run, copy, "list")
    assert {key["id"]: key["state"] for key in told["keys"]} == {
        f"{role}-1": "active" for role in ("root", "attester", "feed", "registry", "ledger")
    }
    assert told["version"] == bundle_of(copy).version == 1
    settings, own = loaded(copy)
    assert own.trust(issuer=settings.issuer, root_key_id=0) == bundle_of(copy)
    assert settings.settings(own).root_key_id == 1
    shown = run("keys", "list", "--data", copy.root)
    assert shown.status == 0
    assert "attester-1" in shown.out


@pytest.mark.parametrize(
    ("role", "of"),
    [
        ("root", Role.ROOT),
        ("attester", Role.ATTESTER),
        ("feed", Role.FEED),
        ("registry", Role.REGISTRY),
        ("ledger", Role.LEDGER),
    ],
)
def test_a_rotation_by_hand(run, copy, role, of):
    before = bundle_of(copy)
    signer = keys.from_pem(copy.idp_key("registry-1").read_bytes(), PASSPHRASE.encode())
    made = did(run, copy, "prepare", role)
    assert (made["key"]["id"], made["key"]["state"], made["version"]) == (f"{role}-2", "prepared", 2)
    path = copy.idp_key(f"{role}-2")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert b"ENCRYPTED" in path.read_bytes()
    raw = keys.public_raw(keys.from_pem(path.read_bytes(), PASSPHRASE.encode()))
    assert made["key"]["thumbprint"] == keys.thumbprint(raw)
    assert raw in bundle_of(copy).of_role(of)
    assert keys.public_raw(getattr(loaded(copy)[1], role)) != raw, "prepared, it signs nothing"

    assert did(run, copy, "activate", f"{role}-2", "--at-once")["key"]["state"] == "active"
    settings, own = loaded(copy)
    assert keys.public_raw(getattr(own, role)) == raw
    assert settings.settings(own).root_key_id == (2 if role == "root" else 1)
    assert len(own.former_registry) == (role == "registry")
    # A verifier of the first bundle takes the third at once: a key that it knows signed it too.
    signed = trust_statement.sign(bundle_of(copy), signer)
    assert succeed(before, signed, at=time.time(), caps=DEFAULT) == bundle_of(copy)

    assert did(run, copy, "taint", f"{role}-1")["key"]["state"] == "tainted"
    assert loaded(copy)[1].former_registry == ()
    assert did(run, copy, "revoke", f"{role}-1")["key"]["state"] == "revoked"
    assert bundle_of(copy).of_role(of) == {raw}
    assert bundle_of(copy).version == 5
    own = loaded(copy)[1]
    assert len(own.every_public) == 6, "what was a key of the provider is nobody else's"
    check_current(own, at=time.time())
    seen = check_bundle(bundle_of(copy), None, at=time.time(), caps=DEFAULT)
    assert check_bundle(before, seen, at=time.time(), caps=DEFAULT).code == "REPLAYED"
    assert {path.name for path in copy.key_ring.parent.glob("*.new")} == set()
    assert stat.S_IMODE(copy.key_ring.stat().st_mode) == stat.S_IMODE(copy.trust.stat().st_mode) == 0o600


def test_what_is_refused(run, copy):
    assert refused(run, copy, "activate", "root-2") == (3, "KEY_UNKNOWN")
    assert refused(run, copy, "activate", "root-1") == (3, "WRONG_STATE")
    assert refused(run, copy, "taint", "root-1") == (3, "STILL_ACTIVE")
    assert refused(run, copy, "revoke", "root-1") == (3, "STILL_ACTIVE")
    did(run, copy, "prepare", "root")
    files = set(copy.key_ring.parent.iterdir())
    assert refused(run, copy, "prepare", "root") == (3, "ALREADY_PREPARED")
    assert refused(run, copy, "prepare", "attester", "--algorithm", "p256") == (2, "ALGORITHM")
    assert set(copy.key_ring.parent.iterdir()) == files, "a refusal makes no file"
    assert refused(run, copy, "activate", "root-2") == (3, "TOO_SOON")
    with DirectoryLock.take(copy.key_lock):
        assert refused(run, copy, "activate", "root-2", "--at-once") == (1, "STEP_UNDER_WAY")
    assert key_ring.read(copy).find("root-2").state is KeyState.PREPARED
    copy.key_ring.chmod(0o622)
    assert refused(run, copy, "list") == (2, "KEYS_UNREADABLE")
    copy.key_ring.chmod(0o600)
    copy.key_ring.write_text("{}")
    assert refused(run, copy, "list") == (2, "KEYS_UNREADABLE")
    copy.key_ring.unlink()
    assert refused(run, copy, "list") == (2, "KEYS_UNREADABLE")


def test_a_step_is_taken_while_the_cell_runs(run, copy):
    with DirectoryLock.take(copy.lock):
        assert did(run, copy, "renew")["version"] == 2


def test_a_key_may_be_made_in_a_module(run, copy, monkeypatch):
    """The configuration names a module that is not there: nothing is made, and no ring names a key without one."""
    monkeypatch.setenv("ZTPM_PKCS11_PIN", "1")
    lines = '[pkcs11]\nmodule = "/nowhere.so"\ntoken = "t"\nroles = ["root"]\n'
    copy.idp_config.write_text(f"{copy.idp_config.read_text()}\n{lines}")
    assert refused(run, copy, "prepare", "root") == (2, "CONFIG_INVALID")
    assert did(run, copy, "prepare", "feed")["key"]["id"] == "feed-2"
    assert bundle_of(copy).version == 2


def test_another_passphrase_makes_no_key(run, copy, monkeypatch):
    monkeypatch.setenv("ZTPM_PASSPHRASE", "another passphrase")
    assert refused(run, copy, "prepare", "feed") == (2, "KEYS_UNREADABLE")
    assert not copy.idp_key("feed-2").exists()


def test_a_step_that_was_cut_off_is_taken_again(run, copy):
    """The power went after the key was written and before the ring was: the next step makes it anew."""
    copy.idp_key("feed-2").write_text("half a key")
    copy.key_ring.with_name("keys.json.new").write_text("half a ring")
    made = did(run, copy, "prepare", "feed", "--algorithm", "p256")
    assert made["key"]["algorithm"] == "P-256"
    did(run, copy, "activate", "feed-2", "--at-once")
    assert len(keys.public_raw(loaded(copy)[1].feed)) == 33


def test_renewing_gives_the_bundle_another_year(run, copy):
    before = bundle_of(copy)
    assert did(run, copy, "renew")["version"] == 2
    after = bundle_of(copy)
    assert after.all_keys == before.all_keys
    assert after.valid_until >= before.valid_until
    own = loaded(copy)[1]
    with pytest.raises(SettingsError) as caught:
        check_current(own, at=after.valid_until)
    assert caught.value.setting == "key_ring_file"
    with pytest.raises(SettingsError):
        check_current(own, at=after.issued_at - 1)


@pytest.mark.parametrize(
    "spoil", ["mode", "no key", "another key", "key readable", "nonsense", "another issuer", "a P-256 root"]
)
def test_the_provider_refuses_a_ring_that_does_not_hold_together(run, copy, spoil):
    path = copy.key_ring
    match spoil:
        case "mode":
            path.chmod(0o620)
        case "no key":
            copy.idp_key("feed-1").unlink()
        case "another key":
            copy.idp_key("feed-1").write_bytes(copy.idp_key("ledger-1").read_bytes())
        case "key readable":
            copy.idp_key("feed-1").chmod(0o640)
        case "nonsense":
            path.write_text("[]")
        case "another issuer":
            path.write_text(path.read_text().replace("/ztpm", "/other"))
        case "a P-256 root":
            key = keys.generate(keys.Algorithm.P256)
            copy.idp_key("root-1").write_bytes(keys.to_pem(key, PASSPHRASE.encode()))
            ring = json.loads(path.read_text())
            ring["keys"][0]["key"] = keys.b64u(keys.public_raw(key))
            path.write_text(json.dumps(ring))
    with pytest.raises(SettingsError) as caught:
        loaded(copy)
    assert caught.value.setting == "key_ring_file"


@pytest.mark.parametrize("line", ["root_key_id = 1", 'root_key_file = "root.key"', 'ledger_key_file = "x"'])
def test_a_ring_and_a_key_of_ones_own_are_refused_together(copy, line):
    copy.idp_config.write_text(f"{copy.idp_config.read_text()}{line}\n")
    with pytest.raises(SettingsError) as caught:
        load_settings(copy.idp_config)
    assert caught.value.setting == line.split(" = ")[0]
