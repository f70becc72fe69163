"""Keys of platforms: bundles as SPIRE exports them, clusters by OIDC discovery, refreshed while the provider serves."""

from __future__ import annotations

import asyncio
import datetime as dt
import http.server
import ipaddress
import json
import ssl
import threading

import pytest
from capabilities.statements.workload import Cluster, Platform
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID
from tests.ztpm_idp.platforms.spire import Authority, Kubernetes, Spire, curve_key
from tests.ztpm_idp.test_settings import write_config
from tests.ztpm_idp.world import START_S, World
from ztpm_idp.keys.key_files import SettingsError
from ztpm_idp.keys.watched_file import WatchedFile
from ztpm_idp.platforms import fetch, sources
from ztpm_idp.platforms.sources import RETRY_S, AskedPlatform, PlatformKeys
from ztpm_idp.settings import load_keys, load_settings
from ztpm_idp.watching import watching

from capabilities.keys import keys
from capabilities.statements import platform_keys

NOW = int(START_S)
DOMAIN = "prod.example"


class Server:
    """An https server on loopback with an authority of its own; answers what a test puts there."""

    def __init__(self, folder):
        self.answers, self.asked, self.headers = {}, [], {}
        key, now = curve_key(), dt.datetime.now(dt.UTC)
        name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "test server")])
        made = (
            x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
            .serial_number(1).not_valid_before(now - dt.timedelta(hours=1)).not_valid_after(now + dt.timedelta(hours=1))
            .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]), critical=False)
            .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
            .sign(key, hashes.SHA256())
        )  # fmt: skip
        self.ca = folder / "ca.pem"
        self.ca.write_bytes(made.public_bytes(Encoding.PEM))
        pem = folder / "server.pem"
        pem.write_bytes(
            key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()) + made.public_bytes(Encoding.PEM)
        )
        server = self

        class Answers(http.server.BaseHTTPRequestHandler):
            def do_GET(self):
                server.asked.append(self.path)
                server.headers[self.path] = dict(self.headers)
                status, body, more = server.answers.get(self.path, (404, b"", {}))
                self.send_response(status)
                for header, value in more.items():
                    self.send_header(header, value)
                self.send_header("content-length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_):
                pass

        self.http = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Answers)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(pem)
        self.http.socket = context.wrap_socket(self.http.socket, server_side=True)
        self.base = f"https://127.0.0.1:{self.http.server_port}"
        threading.Thread(target=self.http.serve_forever, args=(0.01,), daemon=True).start()

    def put(self, path, body, status=200, **more):
        self.answers[path] = status, body, more

    def close(self):
        self.http.shutdown()
        self.http.server_close()


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    made = Server(tmp_path_factory.mktemp("server"))
    yield made
    made.close()


def source_of(folder, text) -> PlatformKeys:
    path = write_config(folder)
    path.write_text(f"{path.read_text()}\n[[platforms]]\n{text}\n")
    (stated,) = load_settings(path).platforms
    return PlatformKeys(stated, folder)


def spiffe(server, more="") -> str:
    return f'kind = "spiffe"\ntrust_domain = "{DOMAIN}"\nbundle_url = "{server.base}/bundle"\nca_file = "{server.ca}"\n{more}'


def kubernetes(server, cluster, more="") -> str:
    return (
        f'kind = "kubernetes"\ncluster = "east"\nissuer = "{cluster.issuer}"\ndiscovery_url = "{server.base}"\n'
        f'ca_file = "{server.ca}"\n{more}'
    )


def asked(source):
    return asyncio.run(source.ask())


def why(source) -> str:
    with pytest.raises(SettingsError) as caught:
        asked(source)
    assert caught.value.setting == source.setting
    return caught.value.why


def test_a_bundle_as_spire_exports_it():
    spire = Spire(DOMAIN, NOW)
    found = platform_keys.bundle(spire.bundle())
    assert (set(found.keys), found.sequence, found.refresh_hint_s, found.others) == ({spire.kid}, 1, 300, ())
    assert found.authorities == (spire.authority.certificate.public_bytes(Encoding.DER),)
    only = json.loads(spire.bundle())["keys"]
    assert platform_keys.bundle(spire.bundle(keys=only[:1])).keys == {}
    assert platform_keys.bundle(spire.bundle(keys=only[1:])).authorities == ()
    private = [{**only[1], "d": "AA"}]
    for raw in (
        spire.bundle(keys=[]), spire.bundle(keys=private), spire.bundle(spiffe_sequence=-1),
        spire.bundle(spiffe_sequence="1"), spire.bundle(spiffe_refresh_hint=True), spire.bundle(more=1),
        spire.bundle(keys=[{**only[0], "x5c": only[0]["x5c"] * 2}]), spire.bundle(keys=[{**only[0], "x5c": ["AA"]}]),
        spire.bundle(keys=[{**only[0], "x5c": ["!"]}]), spire.bundle(keys=only * 17), b"", b"x" * 65_537,
    ):  # fmt: skip
        with pytest.raises(Exception) as caught:
            platform_keys.bundle(raw)
        assert caught.value.code in {"STATEMENT_MALFORMED", "KEY_MALFORMED"}


def test_a_bundle_is_fetched_and_its_sequence_only_grows(server, tmp_path):
    spire, source = Spire(DOMAIN, NOW), source_of(tmp_path, spiffe(server))
    server.put("/bundle", spire.bundle(spiffe_sequence=7))
    assert isinstance(asked(source), Platform)
    server.put("/bundle", spire.bundle(spiffe_sequence=6))
    assert "sequence" in why(source)
    server.put("/bundle", spire.bundle(spiffe_sequence=7))
    assert asked(source).authorities


def test_a_cluster_is_found_by_discovery(server, tmp_path, monkeypatch):
    cluster = Kubernetes(NOW)
    (tmp_path / "bearer").write_text("the-token\n")
    source = source_of(tmp_path, kubernetes(server, cluster, 'bearer_file = "bearer"'))
    server.put("/.well-known/openid-configuration", cluster.discovery(server.base))
    server.put("/openid/v1/jwks", cluster.jwks())
    found = asked(source)
    assert isinstance(found, Cluster)
    assert (found.issuer, set(found.keys), found.lifetime_s) == (cluster.issuer, {cluster.kid}, 3_607)
    assert server.headers["/openid/v1/jwks"]["authorization"] == "Bearer the-token"
    urls, ask = [], sources.fetched

    async def noted(setting, url, **how):
        urls.append(url)
        return await ask(setting, url, **how)

    monkeypatch.setattr(sources, "fetched", noted)
    for answer in (
        cluster.discovery(server.base, issuer="https://evil.example"),
        cluster.discovery("https://evil.example"),
        cluster.discovery(server.base, jwks_uri=server.base.replace("https", "http") + "/openid/v1/jwks"),
        cluster.discovery(server.base, jwks_uri=None),
        b"{", b"[]",
    ):  # fmt: skip
        server.put("/.well-known/openid-configuration", answer)
        why(source)
    assert set(urls) == {f"{server.base}/.well-known/openid-configuration"}, "nothing else is asked"


def test_what_an_address_may_not_do(server, tmp_path):
    spire, source = Spire(DOMAIN, NOW), source_of(tmp_path, spiffe(server))
    server.put("/elsewhere", spire.bundle())
    server.put("/bundle", b"", 302, location=f"{server.base}/elsewhere")
    before = len(server.asked)
    assert why(source) == "status 302"
    assert server.asked[before:] == ["/bundle"], "no redirect is followed"
    server.put("/bundle", b" " * (platform_keys.BUNDLE_BYTES + 1))
    assert "bytes" in why(source)
    server.put("/sized", b"x" * 100)
    for most, fits in ((100, True), (99, False)):
        asking = fetch.fetched("s", f"{server.base}/sized", ca=server.ca, most_bytes=most)
        if fits:
            assert asyncio.run(asking) == b"x" * 100
            continue
        with pytest.raises(SettingsError):
            asyncio.run(asking)
    for body in (b"", b"{}", b"\xff", b'{"keys":[]}'):
        server.put("/bundle", body)
        why(source)
    server.put("/bundle", spire.bundle())
    other = Server(tmp_path)  # another authority in the same place
    try:
        strange = source_of(tmp_path, spiffe(other))
        (tmp_path / "ca.pem").write_bytes(server.ca.read_bytes())
        assert why(strange) == "ConnectError"
        (tmp_path / "ca.pem").unlink()
        why(strange)
    finally:
        other.close()


def test_an_address_that_says_nothing_costs_seconds_at_most(tmp_path, server, monkeypatch):
    import socket  # noqa: PLC0415

    monkeypatch.setattr(fetch, "FETCH_S", 0.05)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        text = spiffe(server).replace(server.base, f"https://127.0.0.1:{silent.getsockname()[1]}")
        assert "no answer" in why(source_of(tmp_path, text))


def test_the_last_good_keys_count_for_a_stated_time(server, tmp_path):
    spire = Spire(DOMAIN, NOW)
    source = source_of(tmp_path, spiffe(server, "kept_s = 60\nrefresh_s = 120"))
    taken, faults, clock = [], {}, [0.0]
    asking = AskedPlatform(source, take=taken.append, faults=faults, clock=lambda: clock[0])
    server.put("/bundle", spire.bundle(spiffe_refresh_hint=30))
    assert asyncio.run(asking.look()) == 30
    assert (len(taken), faults) == (1, {})
    server.put("/bundle", b"", 500)
    for at, told in ((60.0, 1), (60.1, 2), (61.0, 2)):
        clock[0] = at
        assert asyncio.run(asking.look()) == RETRY_S
        assert len(taken) == told
        assert faults == {source.setting: "status 500"}
    assert taken[-1] is None
    server.put("/bundle", spire.bundle(spiffe_refresh_hint=1, spiffe_sequence=2))
    assert asyncio.run(asking.look()) == RETRY_S, "a hint makes nobody ask without a pause"
    assert (isinstance(taken[-1], Platform), faults) == (True, {})


def test_a_file_that_changes_takes_effect(tmp_path):
    spire = Spire(DOMAIN, NOW)
    (tmp_path / "bundle.json").write_bytes(spire.bundle())
    (tmp_path / "world").mkdir()
    source = source_of(tmp_path, f'kind = "spiffe"\ntrust_domain = "{DOMAIN}"\nbundle_file = "bundle.json"')
    with World(tmp_path / "world") as world:
        provider = world.provider
        watch = WatchedFile(
            source.setting, source.path, read=source.read, faults=provider.faults,
            take=lambda platform: provider.trust_platform(source.setting, platform),
        )  # fmt: skip
        provider.trust_platform(source.setting, source.read())
        old, spire.jwt_key, spire.sequence = spire.kid, curve_key(), 2
        (tmp_path / "bundle.json").write_bytes(spire.bundle())
        world.on_loop(watch.look())
        platform = provider.rules.platform_of(f"spiffe://{DOMAIN}/x")
        assert set(platform.keys) == {spire.kid} != {old}
        for spoilt in (b"{", Spire(DOMAIN, NOW).bundle(), ours(world)):
            (tmp_path / "bundle.json").write_bytes(spoilt)
            world.on_loop(watch.look())
            assert provider.rules.platform_of(f"spiffe://{DOMAIN}/x") is platform
            assert list(provider.faults) == [source.setting]


def ours(world) -> bytes:
    raw = keys.public_raw(world.idp_keys.feed)
    key = {"kty": "OKP", "crv": "Ed25519", "x": keys.b64u(raw), "kid": "ours", "use": "jwt-svid"}
    return json.dumps({"keys": [key], "spiffe_sequence": 3}).encode()


def test_a_configuration_starts_with_its_platforms(tmp_path):
    spire, cluster = Spire(DOMAIN, NOW), Kubernetes(NOW)
    (tmp_path / "bundle.json").write_bytes(spire.bundle())
    (tmp_path / "jwks.json").write_bytes(cluster.jwks())
    key = keys.b64u(keys.public_raw(keys.generate()))
    path = write_config(tmp_path)
    path.write_text(
        f'{path.read_text()}\n[[platforms]]\nkind = "spiffe"\ntrust_domain = "{DOMAIN}"\nbundle_file = "bundle.json"\n'
        f'[[platforms]]\nkind = "kubernetes"\ncluster = "east"\nissuer = "{cluster.issuer}"\njwks_file = "jwks.json"\n'
        f'[[publishers]]\nname = "acme"\nkeys = ["{key}"]\n'
    )
    settings = load_settings(path)
    own = load_keys(settings, tmp_path, "secret")
    (tmp_path / "world").mkdir()
    with World(tmp_path / "world", idp_keys=own) as world:
        beside = watching(settings, tmp_path / "idp.toml", "secret", own)(world.provider)
        assert len(beside) == 3
        assert world.provider.rules.platform_of("k8s://east/a/b").issuer == cluster.issuer
        assert world.provider.rules.platform_of(f"spiffe://{DOMAIN}/x").authorities
        assert world.provider.rules.platform_of("k8s://west/a/b") is None
    (tmp_path / "bundle.json").chmod(0o622)
    with pytest.raises(SettingsError):
        watching(settings, tmp_path / "idp.toml", "secret", own)


@pytest.mark.parametrize(
    ("text", "setting"),
    [
        ('kind = "spiffe"\ntrust_domain = "A"\nbundle_file = "x"', "platforms.trust_domain"),
        ('kind = "spiffe"\ntrust_domain = "a"', "platforms.bundle_file"),
        ('kind = "spiffe"\ntrust_domain = "a"\nbundle_file = "x"\nbundle_url = "https://a/b"', "platforms.bundle_file"),
        ('kind = "spiffe"\ntrust_domain = "a"\nbundle_url = "https://a/b"', "platforms.ca_file"),
        ('kind = "spiffe"\ntrust_domain = "a"\nbundle_url = "http://a/b"\nca_file = "c"', "platforms.bundle_url"),
        ('kind = "spiffe"\ntrust_domain = "a"\nbundle_url = "https://u:p@a/b"\nca_file = "c"', "platforms.bundle_url"),
        ('kind = "kubernetes"\ncluster = "a"\nissuer = "http://a"\nca_file = "c"', "platforms.issuer"),
        ('kind = "kubernetes"\ncluster = "a"\nissuer = "https://a"', "platforms.ca_file"),
        ('kind = "kubernetes"\ncluster = "A"\nissuer = "https://a"\nca_file = "c"', "platforms.cluster"),
        ('kind = "kubernetes"\ncluster = "a"\nissuer = "x"\njwks_file = "f"\nca_file = "c"', "platforms.jwks_file"),
        ('kind = "tpm"', "platforms.0"),
        ('kind = "spiffe"\ntrust_domain = "a"\nbundle_file = "x"\nkept_s = 1', "platforms.0.spiffe.kept_s"),
        ('kind = "spiffe"\ntrust_domain = "a"\nbundle_file = "x"\nmore = 1', "platforms.0.spiffe.more"),
        ('kind = "spiffe"\ntrust_domain = "a"\nbundle_file = "x"\n' * 1 + '[[platforms]]\nkind = "spiffe"\n'
         'trust_domain = "a"\nbundle_file = "y"', "platforms"),
        ('kind = "spiffe"\ntrust_domain = "a"\nbundle_file = "x"\n[[publishers]]\nname = "a"\nkeys = ["x"]',
         "publishers.keys"),
    ],
)  # fmt: skip
def test_a_platform_that_is_stated_wrongly(tmp_path, text, setting):
    with pytest.raises(SettingsError) as caught:
        source_of(tmp_path, text)
    assert caught.value.setting == setting


def test_two_platforms_have_no_workload_in_common(tmp_path):
    with World(tmp_path) as world:
        stated = Platform(DOMAIN, {})
        world.provider.trust_platform("a", stated)
        with pytest.raises(SettingsError):
            world.provider.trust_platform("b", stated)
        world.provider.trust_platform("a", stated)
        world.provider.trust_platform("a", None)
        assert world.provider.rules.platform_of(f"spiffe://{DOMAIN}/x") is None
    assert Authority(DOMAIN, NOW).certificate
