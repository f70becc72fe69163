"""A door that speaks TLS itself, and paths that begin in the configuration's folder."""

import time
from types import SimpleNamespace

import pytest
from tests.e2e.tls import Authority
from ztpm.point.enforcement_point import EnforcementPoint
from ztpm.point.tool_proxy_config import ToolProxyConfig, read_door_config

from pep.base.errors import ConfigError, PepFault

PLAIN = """
audience = "https://10.0.5.30:8800/mcp"
host = "10.0.5.30"
port = 8800
pep_id = "cell-1"
issuer = "https://10.0.5.10:8700/ztpm"
trust_file = "../trust.json"
pep_key_file = "/etc/ztpm/pep.key"
journal_file = "journal.ndjson"
state_dir = "state"
policy = "paper-default"
gateway_url = "https://10.0.5.20:8900/calls"
"""
TLS = 'tls_certificate_file = "hosts.pem"\ntls_key_file = "hosts.key"\n'


def test_paths_begin_in_the_folder_wherever_the_process_was_started(tmp_path, monkeypatch):
    (tmp_path / "cell").mkdir()
    file = tmp_path / "cell/cell.toml"
    monkeypatch.chdir(tmp_path / "cell")
    for policy, placed in (("paper-default", "paper-default"), ("own.toml", str(tmp_path / "cell/own.toml"))):
        file.write_text(PLAIN.replace("paper-default", policy) + TLS)
        config = read_door_config(file)
        assert config.trust_file.resolve() == tmp_path / "trust.json"
        assert str(config.pep_key_file) == "/etc/ztpm/pep.key"
        assert (config.journal_file, config.tls_key_file) == (
            file.with_name("journal.ndjson"),
            file.with_name("hosts.key"),
        )
        assert config.policy == placed
    monkeypatch.chdir("/")
    assert read_door_config(file) == config


@pytest.mark.parametrize(
    "text",
    [
        PLAIN + TLS.splitlines()[0],
        PLAIN + TLS.splitlines()[1],
        PLAIN.replace("https", "http").replace("10.0.5.", "127.0.5.") + TLS,
        PLAIN + TLS.replace("hosts.key", ""),
    ],
    ids=["no key", "no certificate", "TLS under plain URLs", "an empty name"],
)
def test_half_of_it_is_refused(text):
    with pytest.raises(ConfigError) as refused:
        ToolProxyConfig.from_toml(text)
    assert refused.value.code == PepFault.CONFIG_INVALID


def door(tmp_path, at):
    config = SimpleNamespace(tls_certificate_file=tmp_path / "hosts.pem", tls_key_file=tmp_path / "hosts.key")
    return SimpleNamespace(config=config, clock=SimpleNamespace(wall_s=lambda: at))


def test_a_certificate_that_is_not_safe_to_show_is_refused_by_its_setting(tmp_path):
    authority, now = Authority(tmp_path, ["10.0.5.30"]), time.time()
    EnforcementPoint._check_tls(door(tmp_path, now))
    EnforcementPoint._check_tls(SimpleNamespace(config=SimpleNamespace(tls_certificate_file=None, tls_key_file=None)))
    with pytest.raises(ValueError, match="tls_certificate_file"):
        EnforcementPoint._check_tls(door(tmp_path, now + 7 * 86_400))
    authority.key.chmod(0o644)
    with pytest.raises(ValueError, match="tls_key_file"):
        EnforcementPoint._check_tls(door(tmp_path, now))
    authority.key.chmod(0o600)
    (tmp_path / "other").mkdir()
    authority.key.write_bytes(Authority(tmp_path / "other", ["10.0.5.30"]).key.read_bytes())
    with pytest.raises(ValueError, match="tls_key_file"):
        EnforcementPoint._check_tls(door(tmp_path, now))
