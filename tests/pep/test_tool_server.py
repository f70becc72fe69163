"""The cell's configuration is read strictly, and refused by the name of what is wrong with it."""

import asyncio
import subprocess
import sys

import httpx2
import pytest

from capabilities import keys
from pep.errors import ConfigError, PepFault
from pep.pit import CellParameters
from pep.rtde.state import JointState
from tests.pep.kit import issuer_keys
from ztpm import tool_server
from ztpm.tool_server import CellConfig, read_config, read_key, read_policies, read_trust

GOOD = {
    "audience": '"http://127.0.0.1:8800/mcp"',
    "host": '"127.0.0.1"',
    "port": "8800",
    "pep_id": '"cell-1"',
    "issuer": '"http://127.0.0.1:8898/ztpm"',
    "trust_file": '"/nonexistent/trust.json"',
    "pep_key_file": '"/nonexistent/pep.key"',
    "journal_file": '"/nonexistent/journal"',
    "state_dir": '"/nonexistent"',
    "robot_host": '"127.0.0.1"',
    "perception_port": "8801",
    "policy": '"paper-default"',
    "defer_timeout_s": "60",
}


def toml(cell="", **changes):
    rows = {**GOOD, **changes}
    return "\n".join(f"{k} = {v}" for k, v in rows.items() if v is not None) + f"\n[cell]\n{cell}\n"


def refused(text, key):
    with pytest.raises(ConfigError) as raised:
        CellConfig.from_toml(text)
    assert raised.value.code is PepFault.CONFIG_INVALID
    assert raised.value.detail.startswith(key)


def test_the_good_one():
    config = CellConfig.from_toml(toml())
    assert (config.port, config.policy, config.cell.stop_deceleration_rad_s2) == (8800, "paper-default", 8.0)


@pytest.mark.parametrize("key", GOOD)
def test_nothing_may_be_missing_or_of_another_type(key):
    refused(toml(**{key: None}), key)
    refused(toml(**{key: "[]"}), key)
    refused(toml(**{key: "true"}), key)
    refused(toml(**{key: '""'}), key)


BAD = {
    "unknown": (toml() + "\n[extra]\nx = 1\n", "extra"),
    "no_cell": ("\n".join(f"{k} = {v}" for k, v in GOOD.items()), "cell"),
    "not_toml": ("audience = ", "not TOML"),
    "twice": (f"port = 1\n{toml()}", "not TOML"),
    "remote_http_audience": (toml(audience='"http://robot.example/mcp"'), "audience"),
    "remote_http_issuer": (toml(issuer='"http://idp.example/ztpm"'), "issuer"),
    "no_path": (toml(issuer='"http://127.0.0.1:8898"'), "issuer"),
    "ftp": (toml(audience='"ftp://127.0.0.1/mcp"'), "audience"),
    "query": (toml(audience='"http://127.0.0.1:8800/mcp?x=1"'), "audience"),
    "listens_everywhere": (toml(host='"0.0.0.0"'), "host"),
    "port_zero": (toml(port="0"), "port"),
    "port_large": (toml(port="65536"), "port"),
    "timeout_zero": (toml(defer_timeout_s="0"), "defer_timeout_s"),
    "cell_key": (toml(cell="gravity = 1.0"), "cell"),
    "cell_nan": (toml(cell="stop_deceleration_rad_s2 = nan"), "cell"),
    "cell_too_hard": (toml(cell="stop_deceleration_rad_s2 = 41.0"), "cell"),
    "cell_zero": (toml(cell="stop_deceleration_rad_s2 = 0.0"), "cell"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_ones(name):
    refused(*BAD[name])


@pytest.fixture
def files(tmp_path, monkeypatch):
    _, trust = issuer_keys()
    (tmp_path / "trust.json").write_bytes(trust.to_json())
    key_file = tmp_path / "pep.key"
    key_file.write_bytes(keys.to_pem(keys.generate(), b"secret words"))
    key_file.chmod(0o600)
    monkeypatch.setenv("ZTPM_PASSPHRASE", "secret words")
    config = CellConfig.from_toml(
        toml(trust_file=f'"{tmp_path}/trust.json"', pep_key_file=f'"{key_file}"', issuer=f'"{trust.issuer}"')
    )
    return config, key_file


def test_key_and_trust_are_read(files):
    config, _ = files
    assert read_trust(config).issuer == config.issuer
    read_key(config)
    assert read_policies(config).name == "paper-default"


def test_a_key_that_others_can_read(files):
    config, key_file = files
    key_file.chmod(0o640)
    with pytest.raises(ConfigError):
        read_key(config)


@pytest.mark.parametrize("passphrase", ["", "wrong"])
def test_a_wrong_or_missing_passphrase(files, monkeypatch, passphrase):
    monkeypatch.setenv("ZTPM_PASSPHRASE", passphrase)
    with pytest.raises(ConfigError):
        read_key(files[0])


def test_trust_of_another_issuer(files):
    config, _ = files
    object.__setattr__(config, "issuer", "http://127.0.0.1:1/other")
    with pytest.raises(ConfigError):
        read_trust(config)


def test_a_missing_file_or_policy(files, tmp_path):
    with pytest.raises(ConfigError):
        read_config(tmp_path / "none.toml")
    object.__setattr__(files[0], "policy", str(tmp_path / "none.toml"))
    with pytest.raises(ConfigError):
        read_policies(files[0])


def test_the_process_says_what_is_wrong_and_ends(tmp_path):
    path = tmp_path / "cell.toml"
    path.write_text(toml(port="0"))
    ended = subprocess.run(
        [sys.executable, "-m", "ztpm.tool_server", "--config", str(path)], capture_output=True, text=True, timeout=60
    )
    assert (ended.returncode, ended.stdout) == (1, "")
    assert "CONFIG_INVALID" in ended.stderr


def test_loopback():
    assert [tool_server._loopback(h) for h in ("127.3.2.1", "::1", "localhost", "10.0.0.1", "0.0.0.0", "x")] == [
        True, True, True, False, False, False,
    ]  # fmt: skip


def test_every_stop_is_as_hard_as_the_cell_says(files, tmp_path, monkeypatch):
    config, _ = files
    object.__setattr__(config, "cell", CellParameters(stop_deceleration_rad_s2=5.0))
    object.__setattr__(config, "journal_file", tmp_path / "journal.ndjson")
    object.__setattr__(config, "state_dir", tmp_path)
    sent = []

    class Arm:
        def __init__(self, host):
            assert host == config.robot_host

        def stopJ(self, a, asynchronous):
            sent.append(a)

        def stopScript(self):
            pass

        def disconnect(self):
            pass

        def read(self):
            return JointState((0.0,) * 6, (0.0,) * 6, 7, 1)

    monkeypatch.setattr(tool_server, "_connect", Arm)
    monkeypatch.setattr(tool_server, "ReceivedState", Arm)

    async def scenario():
        async with httpx2.AsyncClient() as http:
            server = tool_server.ToolServer(
                config, trust=read_trust(config), key=read_key(config), policies=read_policies(config), http=http
            )
            await server.drive.close()
            server.gate.close()
            server.journal.close()

    asyncio.run(scenario())
    assert sent == [5.0]
