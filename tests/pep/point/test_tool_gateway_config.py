"""Configuration of a gateway: servers and mappings, each fault with its place; the shipped mappings are mappings."""

from pathlib import Path

import pytest
from pep.base.errors import ConfigError
from pep.mcp.gateway.lock import Lock
from pep.point.tool_gateway_config import ToolGatewayConfig

TOP = Path(__file__).parents[3]
HEAD = """
audience = "http://127.0.0.1:8910/mcp"
pep_id = "gateway"
issuer = "http://127.0.0.1:8898/ztpm"
trust_file = "trust.json"
pep_key_file = "pep.key"
folder = "state"
"""
STDIO = '[upstream.one]\ncommand = ["server"]\n'
VALVE = '[upstream.{}.tool.open]\nobject = "valve"\nbase_tier = 1\n'


def read(tmp_path, servers, **files):
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    path = tmp_path / "gateway.toml"
    path.write_text(HEAD + servers)
    return ToolGatewayConfig.read(path)


def test_servers_with_their_tools(tmp_path):
    mapping = '[tool.shut]\nobject = "valve"\nbase_tier = 2\n[tool.open]\nobject = "door"\nbase_tier = 2\n'
    two = '[upstream.two]\nurl = "https://two.example/mcp"\nprefix = "two_"\nbearer = "TWO"\ntimeout_s = 5\n'
    servers = STDIO + 'mapping = "m.toml"\n' + VALVE.format("one") + two + VALVE.format("two")
    config = read(tmp_path, servers, **{"m.toml": mapping})
    rows = config.rows()
    assert {name: (row.object, int(row.base_tier)) for name, row in rows.items()} == {
        "open": ("valve", 1), "shut": ("valve", 2), "two_open": ("valve", 1),
    }  # fmt: skip
    one, two = config.upstreams
    assert (one.command, one.folder, one.url, one.timeout_s) == (("server",), tmp_path, "", 60.0)
    assert (two.url, two.bearer, two.timeout_s, two.resources) == ("https://two.example/mcp", "TWO", 5.0, False)
    assert config.lock == tmp_path / "gateway.lock.json"


@pytest.mark.parametrize(
    ("servers", "place"),
    [
        ("", "upstream is missing"),
        ("[upstream]\n", "upstream: there is no server"),
        ("[upstream.one]\n", "upstream.one: Value error, either url or command"),
        (STDIO + 'url = "https://a.example/mcp"\n', "upstream.one: Value error, either url or command"),
        ('[upstream.one]\nurl = "http://a.example/mcp"\n', "upstream.one.url: plain HTTP on loopback only"),
        ('[upstream.one]\nurl = "file:///etc/passwd"\n', "upstream.one: Value error, url"),
        ('[upstream.one]\nurl = "https://me:secret@a.example/mcp"\n', "upstream.one: Value error, url"),
        ('[upstream."A B"]\ncommand = ["server"]\n', "upstream.A B.name"),
        (STDIO + "timeout_s = 0\n", "upstream.one.timeout_s"),
        (STDIO + 'timeout_s = "5"\n', "upstream.one.timeout_s"),
        (STDIO + 'environment = ["A=B"]\n', "upstream.one.environment.0"),
        (STDIO + 'prefix = "a b"\n', "upstream.one.prefix"),
        (STDIO + 'prompts = "yes"\n', "upstream.one.prompts"),
        (STDIO + "shell = true\n", "upstream.one.shell"),
        (STDIO + 'mapping = "none.toml"\n', "none.toml"),
        (STDIO + 'mapping = "m.toml"\n', "m.toml has only tables [tool.NAME]"),
        (STDIO + VALVE.format("one") + STDIO.replace("one", "two") + VALVE.format("two"), "give it a prefix"),
        ('[tool.open]\nobject = "valve"\nbase_tier = 1\n' + STDIO, "tool: a gateway's tools are those of its servers"),
    ],
)
def test_each_fault_is_named_with_its_place(tmp_path, servers, place):
    with pytest.raises(ConfigError) as refused:
        read(tmp_path, servers, **{"m.toml": 'object = "valve"\n'})
    assert refused.value.code == "CONFIG_INVALID"
    assert place in str(refused.value)
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize("path", sorted((TOP / "examples" / "mappings").glob("*.toml")), ids=lambda path: path.stem)
def test_a_shipped_mapping_is_one(tmp_path, path):
    config = read(tmp_path, f'{STDIO}mapping = "{path}"\n')
    rows = config.rows()
    assert rows
    assert len(path.read_text().splitlines()) <= 15 or "robot" in path.stem
    assert all(row.base_tier >= 2 for name, row in rows.items() if name.startswith("move"))


@pytest.mark.parametrize("text", ["", "[]", '{"version": 2, "servers": {}}', '{"version": 1, "servers": {"a": 1}}'])
def test_a_lock_that_is_none_is_refused(tmp_path, text):
    path = tmp_path / "gateway.lock.json"
    assert Lock.read(path).servers == {}
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"gateway\.lock\.json"):
        Lock.read(path)
