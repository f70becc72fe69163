"""`ztpm idp init` makes a provider or nothing; `ztpm doctor --idp` says what is wrong with one."""

import json
import shutil
import stat
import time

import httpx2
import pytest
from capabilities.keys.trust import TrustBundle
from tests.ztpm.cli.provider.certificates import certificate
from tests.ztpm_idp.push.receiver import Receiver
from ztpm.base import trace_export
from ztpm.base.layout import Layout
from ztpm.cell.provider_setup import ProviderPlan
from ztpm.codes.unavailable import UnavailableError
from ztpm.cli.provider.doctor import ProviderDoctor, fits, names_of
from ztpm_idp.settings import load_keys, load_settings

from capabilities.keys import keys

PASSPHRASE = "a passphrase for tests"
ISSUER = "http://127.0.0.1:8714/ztpm"
NOWHERE = "postgresql+asyncpg://postgres@127.0.0.1:1/idp"
"""A server that is not there: port 1 has none."""
PUBLIC = keys.b64u(keys.public_raw(keys.generate()))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A provider with one administrator whose key was told, made by the command."""
    from typer.testing import CliRunner

    from ztpm.cli import app

    root = tmp_path_factory.mktemp("idp") / "provider"
    words = ["idp", "init", "--data", str(root), "--issuer", ISSUER, "--admin", f"alice={PUBLIC}", "--admin", "bob"]
    told = CliRunner().invoke(app, [*words, "--json"], env={"ZTPM_PASSPHRASE": PASSPHRASE})
    assert told.exit_code == 0, told.output
    said = json.loads(told.stdout)
    assert said["keys"] == {"bob": str(root / "operators/bob.key")}
    assert said["administrators"] == ["alice", "bob"]
    return Layout(root)


def test_a_provider_is_made_whole_and_private_without_a_cell(made):
    settings = load_settings(made.idp_config)
    assert (settings.issuer, settings.host, settings.port) == (ISSUER, "127.0.0.1", 8714)
    bundle = load_keys(settings, made.idp_config.parent, PASSPHRASE).ring
    assert TrustBundle.from_json(made.trust.read_bytes()).issuer == bundle.issuer == ISSUER
    assert not made.cell_config.exists()
    files = [path for path in made.root.rglob("*") if path.is_file()]
    assert [path for path in files if stat.S_IMODE(path.stat().st_mode) & 0o077] == []


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("CONFIG_INVALID", ("--issuer", "http://idp.example/ztpm", "--admin", "alice")),
        ("CONFIG_INVALID", ("--issuer", "https://idp.example/ztpm", "--host", "0.0.0.0", "--admin", "alice")),
        ("CONFIG_INVALID", ("--issuer", "https://idp.example:x/ztpm", "--admin", "alice")),
        ("CONFIG_INVALID", ("--issuer", ISSUER, "--admin", "alice", "--database", "sqlite://")),
        ("CONFIG_INVALID", ("--issuer", ISSUER, "--admin", "alice", "--database", "")),
        ("DATABASE_UNUSABLE", ("--issuer", ISSUER, "--admin", "alice", "--database", NOWHERE)),
        ("CONFIG_INVALID", ("--issuer", ISSUER, "--admin", "alice", "--policy", "absent")),
        ("USAGE", ("--issuer", ISSUER, "--admin", "alice", "--admin", "alice")),
        ("USAGE", ("--admin", "alice")),
        ("NO_PEOPLE", ("--issuer", ISSUER)),
        ("NAME_MALFORMED", ("--issuer", ISSUER, "--admin", "../alice")),
        ("KEY_MALFORMED", ("--issuer", ISSUER, "--admin", "alice=short")),
        ("KEY_IN_USE", ("--issuer", ISSUER, "--admin", f"alice={PUBLIC}", "--admin", f"bob={PUBLIC}")),
    ],
)
def test_what_cannot_be_made_leaves_nothing(run, tmp_path, code, words):
    told = run("idp", "init", "--data", tmp_path / "provider", *words, "--json")
    assert (told.json["code"], (tmp_path / "provider").exists()) == (code, False)
    assert told.status == {"KEY_IN_USE": 3, "DATABASE_UNUSABLE": 1}.get(code, 2)


def test_a_directory_with_anything_in_it_is_left_alone(run, made):
    before = sorted(made.root.rglob("*"))
    told = run("idp", "init", "--data", made.root, "--issuer", ISSUER, "--admin", "carol", "--json")
    assert (told.status, told.json["code"], sorted(made.root.rglob("*"))) == (2, "EXISTS", before)


def test_the_next_steps_are_told(run, tmp_path):
    told = run("idp", "init", "--data", tmp_path / "p", "--issuer", "https://idp.example/ztpm", "--admin", "alice")
    assert told.status == 0
    for words in ("alice.key", "trust.json", "TLS proxy", "ztpm idp recover", "ztpm idp serve"):
        assert words in told.out


@pytest.mark.parametrize(
    ("issuer", "tls", "listener"),
    [
        ("https://idp.example/ztpm", True, ("0.0.0.0", 443)),
        ("https://idp.example:8443/ztpm", True, ("0.0.0.0", 8443)),
        ("https://idp.example/ztpm", False, ("127.0.0.1", 8700)),
        ("http://127.0.0.1:9000/ztpm", False, ("127.0.0.1", 9000)),
    ],
)
def test_where_it_listens(tmp_path, issuer, tls, listener):
    plan = ProviderPlan(issuer, {}, certificate=tmp_path / "c.pem" if tls else None)
    assert plan.listener == listener


# --- doctor -----------------------------------------------------------------------------------------------------------


def answering(content, *, date=None):
    headers = {} if date is None else {"date": date}
    return httpx2.MockTransport(lambda _: httpx2.Response(200, content=content, headers=headers))


def looked(layout, content=b"{}", *, date=None, ahead_s=0.0, passphrase=PASSPHRASE):
    """Findings of the doctor, by the name of the check."""
    doctor = ProviderDoctor(
        layout.idp_config, passphrase, transport=answering(content, date=date), now=lambda: time.time() + ahead_s
    )
    return {name: probe()[0] for name, probe in doctor.checks}


@pytest.mark.parametrize(
    ("ready", "ok"),
    [
        (b'{"ready":true}', True),
        (b'{"ready":true,"faults":{"key_ring_file":"REPLAYED"}}', False),
        (b'{"ready":true,"faults":1}', False),
        (b"<html>", False),
    ],
)
def test_a_file_that_is_not_acted_on_is_seen(made, ready, ok):
    answers = {"/readyz": ready, "/trust": made.trust.read_bytes()}
    transport = httpx2.MockTransport(
        lambda request: httpx2.Response(
            200, content=next(v for k, v in answers.items() if request.url.path.endswith(k))
        )
    )
    doctor = ProviderDoctor(made.idp_config, PASSPHRASE, transport=transport)
    assert {name: probe()[0] for name, probe in doctor.checks}["files in force"] is ok


def stamped(ahead_s=0.0):
    return time.strftime("%a, %d %b %Y %H:%M:%S GMT", time.gmtime(time.time() + ahead_s))


def test_a_sound_provider_is_sound(made):
    assert set(looked(made, made.trust.read_bytes(), date=stamped()).values()) == {True}


@pytest.mark.parametrize("content", [b"{}", b"", b"<html>"])
def test_what_answers_at_the_issuer_must_be_this_provider(made, content):
    assert looked(made, content, date=stamped())["issuer"] is False
    told = json.loads(made.trust.read_bytes())
    other = TrustBundle.from_json(made.trust.read_bytes())
    assert other.issuer == told["issuer"]
    told["feed"] = [PUBLIC]
    assert looked(made, json.dumps(told).encode(), date=stamped())["issuer"] is False


@pytest.mark.parametrize("ahead_s", [-30.0, 30.0])
def test_a_clock_that_is_off_is_seen(made, ahead_s):
    assert looked(made, made.trust.read_bytes(), date=stamped(ahead_s))["clock"] is False


def test_a_bundle_that_ends_soon_is_seen(made):
    assert looked(made, made.trust.read_bytes(), ahead_s=340 * 86_400)["trust bundle"] is False


def test_faults_of_files_and_of_the_store_are_seen(made, tmp_path):
    copy = Layout(tmp_path / "provider")
    shutil.copytree(made.root, copy.root)
    copy.idp_config.write_text(copy.idp_config.read_text().replace(str(made.root), str(copy.root)))
    assert looked(copy)["database"] is True
    copy.database.unlink()
    assert looked(copy)["database"] is False
    assert not copy.database.exists()
    copy.database.write_bytes(b"no database at all, but long enough for a page" * 100)
    copy.database.chmod(0o600)
    assert looked(copy)["database"] is False
    found = looked(copy, passphrase="another one")
    assert (found["configuration"], set(found.values()) - {False, True}) == (False, set())
    copy.idp_key("root-1").chmod(0o644)
    assert looked(copy)["configuration"] is False


@pytest.mark.clause("PSH-2")
def test_webhooks_are_looked_at_and_told_nothing(made, tmp_path):
    copy, receiver = Layout(tmp_path / "provider"), Receiver()
    shutil.copytree(made.root, copy.root)
    hook = copy.idp_config.parent / "hook.url"
    hook.write_text(receiver.url())
    hook.chmod(0o600)
    with copy.idp_config.open("a") as config:
        config.write('[[webhooks]]\nname = "cell"\nform = "json"\nurl_file = "hook.url"\n')
        config.write('[web_push]\ncontact = "mailto:ops@works.example"\n')
    doctor = ProviderDoctor(copy.idp_config, PASSPHRASE, transport=answering(b"{}"))
    doctor.configuration()
    found = doctor.questions()
    assert (found[0], "s3cret" in found[1], receiver.all()) == (True, False, [])
    assert "devices are told, as mailto:ops@works.example" in found[1]
    receiver.close()
    found = doctor.questions()
    assert (found[0], "PUSH_UNREACHABLE" in found[1], "s3cret" in found[1]) == (False, True, False)


def test_the_command_looks_at_a_directory_and_fails_where_anything_is_wrong(run, made):
    told = run("doctor", "--idp", made.root, "--json")
    assert (told.status, told.json["ok"]) == (1, False)  # nobody answers at the issuer
    wrong = {row["check"] for row in told.json["checks"] if not row["ok"]}
    assert "issuer" in wrong
    assert wrong <= {"issuer", "clock", "files in force"}  # as this machine's is


@pytest.mark.parametrize(
    ("stated", "ok"),
    [
        ({}, True),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:4318"}, True),
        ({"OTEL_EXPORTER_OTLP_TRACES_ENDPOINT": "https://collector.example/v1/traces"}, True),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "127.0.0.1:4318"}, False),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://[::1"}, False),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://h:99999"}, False),
        ({"OTEL_EXPORTER_OTLP_ENDPOINT": "http://h:4317", "OTEL_EXPORTER_OTLP_PROTOCOL": "grpc"}, False),
    ],
)
def test_a_collector_that_cannot_be_sent_to_is_seen(made, monkeypatch, stated, ok):
    for name, value in stated.items():
        monkeypatch.setenv(name, value)
    doctor = ProviderDoctor(made.idp_config, PASSPHRASE)
    found, said = doctor.traces()
    assert found is ok
    assert all(value in said for value in stated.values()) or not ok


def test_without_the_extra_only_an_export_that_is_asked_for_is_refused(monkeypatch):
    monkeypatch.setattr(trace_export, "EXTRA", ("opentelemetry.absent",))
    with trace_export.exporting("here", {}):
        pass
    with (
        pytest.raises(UnavailableError) as caught,
        trace_export.exporting("here", {trace_export.ENDPOINTS[0]: "http://h"}),
    ):
        pass
    assert caught.value.code == "TRACES_UNUSABLE"


def test_readers_of_figures_are_told(made):
    doctor = ProviderDoctor(made.idp_config, PASSPHRASE)
    assert doctor.figures()[0] is False  # nothing was read yet
    assert doctor.configuration()[0]
    assert doctor.figures()[0]


def test_names_of_certificates_fit_by_whole_labels():
    from cryptography import x509

    own = x509.load_pem_x509_certificate(certificate("idp.example")[0])
    assert names_of(own) == ["idp.example"]
    for host, name, expected in (
        ("idp.example", "idp.example", True), ("IDP.example", "idp.example.", True), ("a.example", "*.example", True),
        ("a.b.example", "*.example", False), ("example", "*.example", False), ("evil-idp.example", "idp.example", False),
    ):  # fmt: skip
        assert fits(host, name) is expected
