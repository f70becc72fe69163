"""Every insecure or empty setting of an identity provider keeps it from starting, and is named."""

from __future__ import annotations

import json
import os
import shutil
import sys
import time

import pytest
from capabilities.rotation.rotation_json import ring_to_json
from tests.e2e.tls import Authority
from tests.ztpm.cli.provider.certificates import certificate
from ztpm.base.layout import Layout, write_private
from ztpm.cell.provider_setup import ProviderPlan, make_ring, toml
from ztpm.point import provider_server
from ztpm.point.provider_deployment import read_deployment
from ztpm_idp.keys.key_files import SettingsError

from capabilities.keys import keys

PASSPHRASE = "a passphrase for tests"
ISSUER = "https://127.0.0.1:8711/ztpm"
CERTIFICATE, KEY = "tls_certificate_file", "tls_key_file"
FIVE = ("root_key_file", "attester_key_file", "feed_key_file", "registry_key_file", "ledger_key_file")

STATED = {
    "no issuer": ("issuer", None),
    "an empty issuer": ("issuer", ""),
    "an issuer in the clear beyond loopback": ("issuer", "http://idp.example/ztpm"),
    "an issuer in the clear on a private address": ("issuer", "http://10.0.0.5/ztpm"),
    "an issuer that only looks like loopback": ("issuer", "http://127.0.0.1.evil.example/ztpm"),
    "an issuer in the clear where there is TLS": ("issuer", "http://127.0.0.1:8711/ztpm"),
    "an issuer with a password": ("issuer", "https://user:word@idp.example/ztpm"),
    "an issuer without a path": ("issuer", "https://idp.example"),
    "an issuer with a query": ("issuer", "https://idp.example/ztpm?x=1"),
    "an issuer of another scheme": ("issuer", "ftp://idp.example/ztpm"),
    "an issuer that is not canonical": ("issuer", "https://IDP.example/ztpm"),
    "the issuer of another ring": ("key_ring_file", {"issuer": "https://other.example/ztpm"}),
    "no host": ("host", None),
    "an empty host": ("host", ""),
    "every interface without TLS": ("host", {"host": "0.0.0.0", CERTIFICATE: None, KEY: None}),
    "every IPv6 interface without TLS": ("host", {"host": "::", CERTIFICATE: None, KEY: None}),
    "a site's address without TLS": ("host", {"host": "10.0.0.5", CERTIFICATE: None, KEY: None}),
    "no port": ("port", None),
    "port zero": ("port", 0),
    "a port beyond the last": ("port", 65_536),
    "no database": ("database_url", None),
    "an empty database": ("database_url", ""),
    "a database in memory": ("database_url", "sqlite+aiosqlite://"),
    "a database in memory by its name": ("database_url", "sqlite+aiosqlite:///:memory:"),
    "a database in memory by a URI": ("database_url", "sqlite+aiosqlite:///file:x?mode=memory&uri=true"),
    "a database with options": ("database_url", "sqlite+aiosqlite:////tmp/x?check_same_thread=false"),
    "a database of another driver": ("database_url", "mysql+aiomysql://idp@db/idp"),
    "a server's password in the file": ("database_url", "postgresql+asyncpg://idp:word@db.example/idp"),
    "a server with options": ("database_url", "postgresql+asyncpg://idp@db.example/idp?ssl=disable"),
    "a server without a user": ("database_url", "postgresql+asyncpg://db.example/idp"),
    "a server without a database": ("database_url", "postgresql+asyncpg://idp@db.example/"),
    "a server by another driver": ("database_url", "postgresql+psycopg://idp@db.example/idp"),
    "a database in no folder": ("database_url", "sqlite+aiosqlite:////nowhere/at/all/idp.sqlite"),
    "half of TLS: no key": (KEY, None),
    "half of TLS: no certificate": (CERTIFICATE, None),
    "a certificate that is missing": (CERTIFICATE, "absent.pem"),
    "a key of TLS that is missing": (KEY, "absent.pem"),
    "no keys": ("root_key_id", {"key_ring_file": None}),
    "an empty name of the ring": ("key_ring_file", ""),
    "a ring that is missing": ("key_ring_file", "absent.json"),
    "a ring and a key beside it": ("root_key_file", {"root_key_file": "root-1.key"}),
    "a platform without keys": ("platform_jwks_file", {"platform_trust_domain": "plant.example"}),
    "keys of a platform without a name": ("platform_trust_domain", {"platform_jwks_file": "jwks.json"}),
    "a platform with an empty name": (
        "platform_trust_domain", {"platform_trust_domain": "", "platform_jwks_file": "jwks.json"}
    ),
    "a platform whose keys are missing": (
        "platform_jwks_file", {"platform_trust_domain": "plant.example", "platform_jwks_file": "absent.json"}
    ),
    "an empty policy": ("policy", ""),
    "a policy that is missing": ("policy", "absent.toml"),
    "no nonces": ("open_nonces", 0),
    "nonces without end": ("open_nonces", 1_000_000),
    "no questions": ("open_asks", 0),
    "questions without end": ("open_asks", 1_000_000),
    "a token for a day": ("lifetimes.token_s", {"lifetimes": {"token_s": 86_401}}),
    "a token for no time": ("lifetimes.token_s", {"lifetimes": {"token_s": 0}}),
    "a nonce for an hour": ("lifetimes.nonce_s", {"lifetimes": {"nonce_s": 3_600}}),
    "a life that nothing has": ("lifetimes.proof_s", {"lifetimes": {"proof_s": 9_999}}),
    "no tokens": ("allowances.live_tokens", {"allowances": {"live_tokens": 0}}),
    "more agents than may end at once": ("allowances.agents", {"allowances": {"agents": 257}}),
    "no requests": ("rates.caller_a_minute", {"rates": {"caller_a_minute": 0}}),
    "requests without end": ("rates.login_a_minute", {"rates": {"login_a_minute": 10**9}}),
    "everybody a proxy": ("rates.trusted_proxies", {"rates": {"trusted_proxies": ["0.0.0.0/0"]}}),
    "any proxy": ("rates.trusted_proxies", {"rates": {"trusted_proxies": ["*"]}}),
    "a setting that nothing reads": ("debug", {"debug": True}),
    "a setting misspelled": ("tls_certifcate_file", {"tls_certifcate_file": "hosts.pem"}),
}  # fmt: skip
"""Settings of idp.toml, by the name of the setting that must be told: another value, none, or several."""


def mode(path, to):
    return lambda root: (root / path).chmod(to)


def content(path, text):
    return lambda root: (root / path).write_text(text)


def other_key(path, passphrase=PASSPHRASE.encode()):
    def replace(root):
        (root / path).write_bytes(keys.to_pem(keys.generate(), passphrase))

    return replace


def weak(**changes):
    def replace(root):
        made, key = certificate("127.0.0.1", **changes)
        (root / "idp/hosts.pem").write_bytes(made)
        (root / "idp/hosts.key").write_bytes(key)

    return replace


LOGIN = {"name": "corp", "title": "Corp", "issuer": "https://login.example", "client_id": "ztpm"}


def login(**changes):
    """Adds an OpenID provider, with these members of it otherwise."""

    def add(root):
        members = {name: value for name, value in (LOGIN | changes).items() if value is not None}
        with (root / "idp/idp.toml").open("a") as config:
            config.write("[[login_providers]]\n" + "".join(f"{n} = {json.dumps(v)}\n" for n, v in members.items()))

    return add


def twice(root):
    login()(root)
    login(issuer="https://other.example")(root)


def secret(text, rights):
    def write(root):
        write_private(root / "idp/client.secret", text.encode())
        (root / "idp/client.secret").chmod(rights)
        login(client_secret_file="client.secret")(root)

    return write


def webhook(url, rights=0o600, **changes):
    """States a webhook whose address is in a file with these rights."""

    def write(root):
        write_private(root / "idp/hook.url", url.encode())
        (root / "idp/hook.url").chmod(rights)
        members = {"name": "cell", "form": "slack", "url_file": "hook.url"} | changes
        with (root / "idp/idp.toml").open("a") as config:
            config.write("[[webhooks]]\n" + "".join(f"{n} = {json.dumps(v)}\n" for n, v in members.items()))

    return write


def oauth(*names, **other):
    """States keys of the authorization server."""

    def add(root):
        for name, rights in other.items():
            other_key(f"idp/{name}.key")(root)
            (root / f"idp/{name}.key").chmod(rights)
        state(root, {"oauth_key_files": [*names, *(f"{name}.key" for name in other)]})

    return add


def metrics(text, rights):
    """States a token by which the figures are read."""

    def write(root):
        write_private(root / "idp/metrics.token", text.encode())
        (root / "idp/metrics.token").chmod(rights)
        state(root, {"metrics_token_file": "metrics.token"})

    return write


FILES = {
    "a login in the clear": ("login_providers.0", login(issuer="http://login.example")),
    "a login without an issuer": ("login_providers.0.issuer", login(issuer="")),
    "a login with a password in its issuer": ("login_providers.0", login(issuer="https://a:b@login.example")),
    "a login without a client": ("login_providers.0.client_id", login(client_id="")),
    "a login without signatures": ("login_providers.0.algorithms.0", login(algorithms=["none"])),
    "a login with a shared secret's signatures": ("login_providers.0.algorithms.0", login(algorithms=["HS256"])),
    "a login with no algorithm": ("login_providers.0.algorithms", login(algorithms=[])),
    "a login with groups and no roles": ("login_providers.0", login(groups_claim="groups")),
    "a login that stands twice": ("login_providers", twice),
    "a login whose secret others may read": ("login_providers", secret("s" * 32, 0o644)),
    "a login whose secret is short": ("login_providers", secret("short", 0o600)),
    "a login whose secret is missing": ("login_providers", login(client_secret_file="absent")),
    "a webhook in the clear": ("webhooks", webhook("http://hooks.example/s3cret")),
    "a webhook whose address others may read": ("webhooks: cell", webhook("https://hooks.example/s3cret", 0o644)),
    "a webhook that is no form": ("webhooks.0.form", webhook("https://hooks.example/s3cret", form="mail")),
    "a webhook whose address is not there": ("webhooks: cell", webhook("https://hooks.example/", url_file="absent")),
    "an access token's key that is missing": ("oauth_key_files", oauth("absent.key")),
    "an access token's key that others may read": ("oauth_key_files", oauth(oauth=0o644)),
    "an access token's key that is the provider's": ("oauth_key_files", oauth("feed-1.key")),
    "an access token's key that stands twice": ("oauth_key_files", oauth("oauth.key", oauth=0o600)),
    "a token of the figures that others may read": ("metrics_token_file", metrics("t" * 44, 0o644)),
    "a token of the figures that is short": ("metrics_token_file", metrics("short", 0o600)),
    "a token of the figures that is missing": (
        "metrics_token_file",
        lambda root: state(root, {"metrics_token_file": "absent"}),
    ),
    "a configuration that others may write": ("config", mode("idp/idp.toml", 0o666)),
    "a configuration that is no TOML": ("config", content("idp/idp.toml", "issuer =")),
    "a ring that others may write": ("key_ring_file", mode("idp/keys.json", 0o662)),
    "a ring that is none": ("key_ring_file", content("idp/keys.json", "{}")),
    "a private key that others may read": ("key_ring_file", mode("idp/root-1.key", 0o644)),
    "a private key that a group may read": ("key_ring_file", mode("idp/feed-1.key", 0o640)),
    "a private key that is another's": ("key_ring_file", other_key("idp/ledger-1.key")),
    "a private key under another passphrase": ("key_ring_file", other_key("idp/attester-1.key", b"another")),
    "a private key that is not encrypted": ("key_ring_file", content("idp/registry-1.key", "-----BEGIN")),
    "a store that others may read": ("database_url", mode("idp/idp.sqlite", 0o604)),
    "a store that a group may write": ("database_url", mode("idp/idp.sqlite", 0o660)),
    "a folder of the store that others may write": ("database_url", mode("idp", 0o777)),
    "a key of TLS that others may read": (KEY, mode("idp/hosts.key", 0o644)),
    "a key of TLS that is another's": (KEY, lambda root: shutil.copy(root / "other.key", root / "idp/hosts.key")),
    "a certificate that others may write": (CERTIFICATE, mode("idp/hosts.pem", 0o666)),
    "a certificate that is none": (CERTIFICATE, content("idp/hosts.pem", "no certificate")),
    "a certificate that has ended": (CERTIFICATE, weak(ended=True)),
    "a certificate of the future": (CERTIFICATE, weak(future=True)),
    "a certificate with a short RSA key": (CERTIFICATE, weak(bits=1_024)),
    "a policy that others may write": ("policy", None),
}
ENVIRONMENT = {
    "no passphrase": ("ZTPM_PASSPHRASE", {}),
    "an empty passphrase": ("ZTPM_PASSPHRASE", {"ZTPM_PASSPHRASE": ""}),
    "a wrong passphrase": ("key_ring_file", {"ZTPM_PASSPHRASE": "another passphrase"}),
    "a passphrase twice": ("ZTPM_PASSPHRASE_FILE", {"ZTPM_PASSPHRASE": PASSPHRASE, "ZTPM_PASSPHRASE_FILE": "word"}),
    "a passphrase in a file that is missing": ("ZTPM_PASSPHRASE_FILE", {"ZTPM_PASSPHRASE_FILE": "absent"}),
    "a passphrase in a file that others may read": ("ZTPM_PASSPHRASE_FILE", {"ZTPM_PASSPHRASE_FILE": "open"}),
    "a passphrase in an empty file": ("ZTPM_PASSPHRASE_FILE", {"ZTPM_PASSPHRASE_FILE": "empty"}),
}
CASES = len(STATED) + len(FILES) + len(ENVIRONMENT)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The directory of a provider that would start, but for its store's rows."""
    layout = Layout(tmp_path_factory.mktemp("insecure") / "provider")
    authority = Authority(tmp_path_factory.mktemp("tls"), ["127.0.0.1"])
    plan = ProviderPlan(ISSUER, {})
    settings = plan.settings(layout) | {"key_ring_file": "keys.json", "host": "127.0.0.1", CERTIFICATE: "hosts.pem"}
    del settings["oauth_key_files"]
    write_private(layout.idp_config, toml(settings | {KEY: "hosts.key", "database_url": "STORE"}))
    write_private(layout.key_ring, ring_to_json(make_ring(layout, ISSUER, PASSPHRASE.encode(), at=int(time.time()))))
    write_private(layout.database, b"")
    write_private(layout.root / "idp/hosts.pem", authority.certificate.read_bytes())
    write_private(layout.root / "idp/hosts.key", authority.key.read_bytes())
    write_private(layout.root / "other.key", certificate("127.0.0.1")[1])
    for name, text, rights in (("word", PASSPHRASE, 0o600), ("open", PASSPHRASE, 0o604), ("empty", "", 0o600)):
        write_private(layout.root / name, text.encode())
        (layout.root / name).chmod(rights)
    return layout.root


@pytest.fixture
def provider(made, tmp_path):
    """A copy of it, and the way to state its settings otherwise."""
    root = tmp_path / "provider"
    shutil.copytree(made, root)
    config = root / "idp/idp.toml"
    config.write_text(config.read_text().replace("STORE", f"sqlite+aiosqlite:///{root}/idp/idp.sqlite"))
    return root


def state(root, changes):
    config = root / "idp/idp.toml"
    lines = [line for line in config.read_text().splitlines() if line.split(" = ")[0] not in changes]
    tables = [f"[{name}]\n{inner} = {value}" for name, told in changes.items() if isinstance(told, dict)
              for inner, value in told.items()]  # fmt: skip
    lines += [f"{name} = {json.dumps(value)}" for name, value in changes.items()
              if value is not None and not isinstance(value, dict)]  # fmt: skip
    config.write_text("\n".join([*lines, *tables]))


def refused(root, passphrase=PASSPHRASE):
    with pytest.raises(SettingsError) as caught:
        read_deployment(root / "idp/idp.toml", passphrase, at=time.time())
    return caught.value.setting


def test_the_safe_one_is_taken(provider):
    assert read_deployment(provider / "idp/idp.toml", PASSPHRASE, at=time.time()).settings.issuer == ISSUER


@pytest.mark.parametrize("case", sorted(STATED))
def test_an_insecure_setting_is_refused_by_name(provider, case):
    setting, changes = STATED[case]
    state(provider, changes if isinstance(changes, dict) else {setting: changes})
    assert refused(provider) == setting


@pytest.mark.parametrize("case", sorted(FILES))
def test_an_insecure_file_is_refused_by_the_setting_that_names_it(provider, case):
    setting, change = FILES[case]
    if change is None:
        state(provider, {"policy": "own.toml"})
        (provider / "idp/own.toml").write_text("")
        (provider / "idp/own.toml").chmod(0o666)
    else:
        change(provider)
    assert refused(provider) == setting


def test_a_ring_whose_bundle_is_over_is_refused(provider):
    with pytest.raises(SettingsError) as caught:
        read_deployment(provider / "idp/idp.toml", PASSPHRASE, at=time.time() + 3 * 365 * 86_400)
    assert caught.value.setting in {"key_ring_file", CERTIFICATE}


@pytest.mark.parametrize("case", sorted(ENVIRONMENT))
def test_the_process_names_what_is_wrong_with_its_passphrase_and_ends_with_2(provider, case, monkeypatch, capsys):
    setting, told = ENVIRONMENT[case]
    for name in ("ZTPM_PASSPHRASE", "ZTPM_PASSPHRASE_FILE"):
        monkeypatch.delenv(name, raising=False)
    for name, value in told.items():
        monkeypatch.setenv(name, str(provider / value) if name.endswith("FILE") else value)
    monkeypatch.setattr(sys, "argv", ["provider_server", "--config", str(provider / "idp/idp.toml")])
    before = os.umask(0o077)
    try:
        assert provider_server.main() == 2
    finally:
        os.umask(before)
    assert f": {setting}: " in capsys.readouterr().err


def test_there_are_forty_of_them():
    assert CASES >= 40


if __name__ == "__main__":
    status = pytest.main(["-q", "-n", "0", __file__])
    print(
        f"{CASES} of {CASES} insecure settings refused by name" if status == 0 else "not every one is refused by name"
    )
    sys.exit(status)
