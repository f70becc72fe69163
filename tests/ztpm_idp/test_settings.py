"""A service with an unsafe or empty setting does not start, and names it."""

from __future__ import annotations

from pathlib import Path

import pytest
from ztpm_idp.keys.key_files import IdpKeys, SettingsError
from ztpm_idp.settings import (
    check_settings,
    load_keys,
    load_platform,
    load_policies,
    load_settings,
)

import policies
from capabilities.keys import keys
from capabilities.statements import workload

KEY_FILES = ("root_key_file", "attester_key_file", "feed_key_file", "registry_key_file", "ledger_key_file")
GOOD = {
    "issuer": "http://127.0.0.1:8700/ztpm",
    "host": "127.0.0.1",
    "port": 8700,
    "database_url": "sqlite+aiosqlite:////tmp/idp.sqlite",
    "root_key_id": 1,
}
TLS = {"tls_certificate_file": "c.pem", "tls_key_file": "k.pem"}


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"host": "::1"},
        {"host": "localhost"},
        {"issuer": "https://idp.example/ztpm"},
        {"issuer": "https://idp.example/ztpm", "host": "0.0.0.0", **TLS},
        {"lifetimes": {"token_s": 600, "nonce_s": 30}},
    ],
)
def test_safe_settings_are_taken(changes):
    assert check_settings(GOOD | changes).root_key_id == 1


@pytest.mark.parametrize(
    ("setting", "changes"),
    [
        ("issuer", {"issuer": ""}),
        ("issuer", {"issuer": "http://idp.example/ztpm"}),
        ("issuer", {"issuer": "http://192.168.1.2/ztpm"}),
        ("issuer", {"issuer": "http://127.0.0.1.evil.example/ztpm"}),
        ("issuer", {"issuer": "http://127.0.0.1:8700"}),
        ("issuer", {"issuer": "http://127.0.0.1:8700/ztpm/"}),
        ("issuer", {"issuer": "ftp://127.0.0.1/ztpm"}),
        ("issuer", {"issuer": "http://user@127.0.0.1/ztpm"}),
        ("issuer", {"issuer": "http://127.0.0.1:8700/ztpm?x=1"}),
        ("issuer", {"issuer": 5}),
        ("issuer", TLS),
        ("host", {"host": ""}),
        ("host", {"host": "0.0.0.0"}),
        ("host", {"host": "::"}),
        ("host", {"host": "192.168.1.2"}),
        ("tls_key_file", {"tls_certificate_file": "c.pem"}),
        ("tls_certificate_file", {"tls_key_file": "k.pem"}),
        ("port", {"port": 0}),
        ("port", {"port": "8700"}),
        ("port", {"port": True}),
        ("port", {"port": 65_536}),
        ("database_url", {"database_url": ""}),
        ("database_url", {"database_url": "sqlite+aiosqlite://"}),
        ("database_url", {"database_url": "sqlite+aiosqlite:///:memory:"}),
        ("database_url", {"database_url": "sqlite+aiosqlite:///file:x?mode=memory&uri=true"}),
        ("database_url", {"database_url": "sqlite+aiosqlite:///x?isolation_level=IMMEDIATE"}),
        ("database_url", {"database_url": "sqlite:///x"}),
        ("database_url", {"database_url": "postgresql://idp@db.example/ztpm"}),
        ("database_url", {"database_url": "postgresql+psycopg://idp@db.example/ztpm"}),
        ("database_url", {"database_url": "postgresql+asyncpg://idp:canary@db.example/ztpm"}),
        ("database_url", {"database_url": "postgresql+asyncpg://db.example/ztpm"}),
        ("database_url", {"database_url": "postgresql+asyncpg://idp@db.example"}),
        ("database_url", {"database_url": "postgresql+asyncpg://idp@/ztpm"}),
        ("database_url", {"database_url": "postgresql+asyncpg://idp@db.example/ztpm?ssl=disable"}),
        ("database_url", {"database_url": "postgresql+asyncpg://idp@db.example/ztpm?sslmode=prefer"}),
        ("database_url", {"database_url": "postgresql+asyncpg://idp@/ztpm?host=db.example"}),
        ("database_url", {"database_url": "postgresql+asyncpg://idp@db.example/ztpm?host=/run/postgresql"}),
        ("database_url", {"database_url": "postgresql+asyncpg://idp@/ztpm?host=/a&host=/b"}),
        ("database_url", {"database_url": "mysql://x/y"}),
        ("database_url", {"database_url": "postgresql+asyncpg://idp@/idp"}),
        ("database_url", {"database_url": "nonsense"}),
        ("root_key_id", {"root_key_id": -1}),
        ("root_key_id", {"root_key_id": "1"}),
        ("lifetimes.token_s", {"lifetimes": {"token_s": 0}}),
        ("lifetimes.token_s", {"lifetimes": {"token_s": 86_401}}),
        ("lifetimes.nonce_s", {"lifetimes": {"nonce_s": 61}}),
        ("lifetimes.proof_s", {"lifetimes": {"proof_s": 9_999}}),
        ("open_nonces", {"open_nonces": 0}),
        ("debug", {"debug": True}),
    ],
)
def test_unsafe_settings_are_refused_by_name(setting, changes):
    with pytest.raises(SettingsError) as caught:
        check_settings(GOOD | changes)
    assert caught.value.setting == setting


@pytest.mark.parametrize("missing", sorted(GOOD))
def test_a_missing_setting_is_named(missing):
    with pytest.raises(SettingsError) as caught:
        check_settings({name: value for name, value in GOOD.items() if name != missing})
    assert caught.value.setting == missing


def write_config(folder, *, key_files=KEY_FILES, mode=0o600, passphrase=b"secret", lines=()):
    for name in set(key_files):
        (folder / name).write_bytes(keys.to_pem(keys.generate(), passphrase))
        (folder / name).chmod(mode)
    stated = [f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v}" for k, v in GOOD.items()]
    stated += [f'{name} = "{file}"' for name, file in zip(KEY_FILES, key_files, strict=True)]
    (folder / "idp.toml").write_text("\n".join([*stated, *lines]))
    return folder / "idp.toml"


PLATFORM = ('platform_trust_domain = "cell.example"', 'platform_jwks_file = "jwks.json"')


def write_platform(folder, raw=None, *, mode=0o600, lines=PLATFORM):
    path = write_config(folder, lines=lines)
    (folder / "jwks.json").write_bytes(workload.jwks(keys.public_raw(keys.generate())) if raw is None else raw)
    (folder / "jwks.json").chmod(mode)
    return path


def platform_of(folder, path):
    settings = load_settings(path)
    return load_platform(settings, folder, load_keys(settings, folder, "secret"))


def test_a_platform_is_named_by_trust_domain_and_keys(tmp_path):
    assert platform_of(tmp_path, write_config(tmp_path)) is None
    found = platform_of(tmp_path, write_platform(tmp_path, mode=0o644))
    assert found.trust_domain == "cell.example"
    assert len(found.keys) == 1


@pytest.mark.parametrize(
    ("lines", "setting"),
    [
        (PLATFORM[:1], "platform_jwks_file"),
        (PLATFORM[1:], "platform_trust_domain"),
        ((PLATFORM[1], 'platform_trust_domain = ""'), "platform_trust_domain"),
        ((PLATFORM[1], 'platform_trust_domain = "Cell"'), "platform_trust_domain"),
        ((PLATFORM[1], "platform_trust_domain = 5"), "platform_trust_domain"),
    ],
)
def test_half_a_platform_is_refused(tmp_path, lines, setting):
    with pytest.raises(SettingsError) as caught:
        platform_of(tmp_path, write_platform(tmp_path, lines=lines))
    assert caught.value.setting == setting


def test_a_key_file_of_the_platform_that_is_refused(tmp_path):
    def setting(**how):
        with pytest.raises(SettingsError) as caught:
            platform_of(tmp_path, write_platform(tmp_path, **how))
        return caught.value.setting

    assert setting(raw=b"") == "platform_jwks_file"
    assert setting(raw=b'{"keys": []}') == "platform_jwks_file"
    assert setting(mode=0o622) == "platform_jwks_file"
    path = write_platform(tmp_path)
    (tmp_path / "jwks.json").unlink()
    with pytest.raises(SettingsError) as caught:
        platform_of(tmp_path, path)
    assert caught.value.setting == "platform_jwks_file"
    own = load_keys(load_settings(path), tmp_path, "secret")
    (tmp_path / "jwks.json").write_bytes(workload.jwks(keys.public_raw(own.feed)))
    (tmp_path / "jwks.json").chmod(0o600)
    with pytest.raises(SettingsError) as caught:
        platform_of(tmp_path, path)
    assert caught.value.setting == "platform_jwks_file"


def refused(folder, path, passphrase="secret"):
    with pytest.raises(SettingsError) as caught:
        load_keys(load_settings(path), folder, passphrase)
    return caught.value.setting


def test_a_good_file_is_loaded(tmp_path):
    settings = load_settings(write_config(tmp_path))
    assert isinstance(load_keys(settings, tmp_path, "secret"), IdpKeys)
    assert "root_key_file" not in repr(settings.settings())


def test_key_files(tmp_path):
    path = write_config(tmp_path)
    assert refused(tmp_path, path, "") == "ZTPM_PASSPHRASE"
    assert refused(tmp_path, path, "wrong") == "root_key_file"
    (tmp_path / "feed_key_file").chmod(0o640)
    assert refused(tmp_path, path) == "feed_key_file"
    (tmp_path / "feed_key_file").unlink()
    assert refused(tmp_path, path) == "feed_key_file"
    (tmp_path / "feed_key_file").write_text("nonsense")
    (tmp_path / "feed_key_file").chmod(0o600)
    assert refused(tmp_path, path) == "feed_key_file"


def test_one_key_in_two_roles_is_refused(tmp_path):
    path = write_config(tmp_path, key_files=("one", "one", "feed_key_file", "registry_key_file", "ledger_key_file"))
    assert refused(tmp_path, path) == "root_key_file"


@pytest.mark.parametrize("content", ["", "issuer = ", "\xff", "issuer = 'x'\nissuer = 'y'"])
def test_files_that_are_no_configuration(tmp_path, content):
    (tmp_path / "idp.toml").write_bytes(content.encode("latin-1"))
    with pytest.raises(SettingsError):
        load_settings(tmp_path / "idp.toml")
    with pytest.raises(SettingsError):
        load_settings(tmp_path / "absent.toml")


def test_keys_are_not_shown(tmp_path):
    assert repr(load_keys(load_settings(write_config(tmp_path)), tmp_path, "secret")) == "IdpKeys(...)"


def test_the_policies_that_delegations_are_decided_by(tmp_path):
    named = lambda name: check_settings(GOOD | {"policy": name})
    assert load_policies(check_settings(GOOD)).name == "paper-default"
    assert load_policies(named("strict"), tmp_path).name == "strict"
    (tmp_path / "line.toml").write_text('name = "line"\nversion = 1\nextends = "plant.toml"\n')
    (tmp_path / "plant.toml").write_text('name = "plant"\nversion = 1\nextends = "strict"\n')
    assert load_policies(named("line.toml"), tmp_path).floor.name == "plant"
    shipped = Path(policies.__file__).with_name("sets") / "strict.toml"
    (tmp_path / "own.toml").write_text(shipped.read_text().replace('name = "strict"', 'name = "own"'))
    assert load_policies(named("own.toml"), tmp_path).name == "own"
    (tmp_path / "bad.toml").write_text("name = 1")
    for name, folder in (("bad.toml", tmp_path), ("absent.toml", tmp_path), ("own.toml", None), ("../x", None)):
        with pytest.raises(SettingsError) as caught:
            load_policies(named(name), folder)
        assert caught.value.setting == "policy"
    with pytest.raises(SettingsError):
        named("")


@pytest.mark.parametrize(
    "url",
    [
        "postgresql+asyncpg://idp@db.example/ztpm",
        "postgresql+asyncpg://idp@127.0.0.1:5433/ztpm",
        "postgresql+asyncpg://idp@/ztpm?host=/run/postgresql",
    ],
)
def test_a_server_that_keeps_the_state(url):
    assert check_settings(GOOD | {"database_url": url}).database_url == url
