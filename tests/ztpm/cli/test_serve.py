"""The commands that are one process of a cell: which program they become, with which configuration."""

import asyncio
import sys

import pytest

from ztpm.point import gateway_server


class BecameError(Exception):
    """Program that the process would become."""


@pytest.mark.parametrize(
    ("command", "module", "config"),
    [
        (("mcp", "serve"), "ztpm.point.tool_proxy", "cell_config"),
        (("rtde", "gateway"), "ztpm.point.gateway_server", "gateway_config"),
    ],
)
def test_a_process_of_a_cell_has_the_cells_configuration(run, cell, tmp_path, monkeypatch, command, module, config):
    def become(path, arguments):
        raise BecameError(arguments[1:])

    monkeypatch.setattr("os.execv", become)
    own = tmp_path / "own.toml"
    own.write_text("")
    for options, file in (("--data", cell.root), getattr(cell, config)), (("--config", own), own):
        with pytest.raises(BecameError) as became:
            run(*command, *options)
        assert became.value.args[0][:4] == ["-m", module, "--config", str(file)]


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ((), []),
        (("--robot", "192.0.2.7"), ["--robot=192.0.2.7"]),
        (("--listen", "127.0.0.5"), ["--listen=127.0.0.5"]),
        (("--listen", "127.0.0.5", "--robot", "192.0.2.7"), ["--robot=192.0.2.7", "--listen=127.0.0.5"]),
        (("--unsafe-observe",), ["--unsafe-observe"]),
    ],
)
def test_a_gateway_stands_where_it_is_told_and_before_whom(run, cell, monkeypatch, said, meant):
    def become(path, arguments):
        raise BecameError(arguments[1:])

    monkeypatch.setattr("os.execv", become)
    with pytest.raises(BecameError) as became:
        run("rtde", "gateway", "--data", cell.root, *said)
    assert became.value.args[0][4:] == meant


@pytest.mark.parametrize(("said", "meant"), [((), []), (("--listen", "127.0.0.1:1"), ["--listen=127.0.0.1:1"])])
def test_a_signer_has_the_point_and_the_key_that_it_is_told(run, tmp_path, monkeypatch, said, meant):
    def become(path, arguments):
        raise BecameError(arguments[1:])

    monkeypatch.setattr("os.execv", become)
    key = tmp_path / "gateway.key"
    key.write_text("")
    with pytest.raises(BecameError) as became:
        run("mcp", "sign", "--point", "http://127.0.0.1:8900", "--key", key, *said)
    to = ["--point", "http://127.0.0.1:8900", "--key", str(key)]
    assert became.value.args[0] == ["-m", "ztpm.point.evaluation_signer", *to, *meant]


def test_what_it_is_told_goes_before_its_configuration(cell, monkeypatch):
    served = []

    async def serve(config, *, reports, unsafe_observe, certifier):
        assert not unsafe_observe, "nobody asked for it"
        served.append((config.robot_host, config.listen_host))

    monkeypatch.setattr(gateway_server, "serve", serve)
    monkeypatch.setattr(gateway_server, "main_of", lambda served, **_: asyncio.run(served()))  # the process goes on
    own = gateway_server.read_gateway_config(cell.gateway_config)
    for robot, listen in (("", ""), ("127.77.0.3", ""), ("", "127.77.0.4"), ("127.77.0.3", "127.77.0.4")):
        options = [f"--{name}={value}" for name, value in (("robot", robot), ("listen", listen)) if value]
        monkeypatch.setattr(sys, "argv", ["gateway", "--config", str(cell.gateway_config), *options])
        gateway_server.main()
        assert served.pop() == (robot or own.robot_host, listen or own.listen_host)
    assert own.robot_host != own.listen_host
