"""`ztpm up` where it does not come up: a code, a status, and nothing left behind. Coming up: tests/e2e/test_up.py."""

import os
import shutil
import signal
import socket

import pytest
from ztpm.base.layout import Layout
from ztpm.base.lock import DirectoryLock
from ztpm.cell.setup import Addresses, SetupError, free_addresses, read_addresses

ADDRESSES = Addresses("127.77.0.9")


@pytest.fixture(autouse=True)
def signals():
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    yield
    for number, handler in zip(numbers, before, strict=True):
        signal.signal(number, handler)


@pytest.fixture
def copy(cell, tmp_path):
    """A cell's directory of one's own; its configurations still name the first one's files."""
    shutil.copytree(cell.root, tmp_path / "cell")
    return Layout(tmp_path / "cell")


def refused(told, code, status):
    assert (told.status, told.json["ok"], told.json["code"]) == (status, False, code)


def test_help(run):
    told = run("up", "--help")
    assert told.status == 0
    assert "--data" in told.out and "--json" in told.out


def test_passphrases(run, tmp_path, copy, monkeypatch):
    monkeypatch.setenv("ZTPM_PASSPHRASE", "short")
    refused(run("up", "--data", tmp_path / "new", "--json"), "PASSPHRASE_TOO_SHORT", 2)
    monkeypatch.setenv("ZTPM_PASSPHRASE", "another passphrase")
    refused(run("up", "--data", copy.root, "--json"), "PASSPHRASE_WRONG", 2)
    monkeypatch.delenv("ZTPM_PASSPHRASE")
    refused(run("up", "--data", tmp_path / "new", "--json"), "PASSPHRASE_MISSING", 2)
    assert not (tmp_path / "new").exists()


@pytest.mark.clause("LIV-6")
def test_a_cell_has_its_provider_at_a_name_in_all_its_files_or_not_at_all(copy):
    named = Addresses("127.77.0.9", idp_port=12_345, named=True)
    files = (copy.idp_config, copy.cell_config, copy.gateway_config)
    for path in files:
        text = path.read_text().replace(ADDRESSES.issuer, named.issuer)
        path.write_text(text.replace('host = "127.77.0.9"\nport = 8700', 'host = "127.0.0.1"\nport = 12345'))
    assert read_addresses(copy) == named
    assert (named.provider_host, named.issuer) == ("127.0.0.1", "http://localhost:12345/ztpm")
    for path in files[1:]:
        text = path.read_text()
        path.write_text(text.replace(named.issuer, ADDRESSES.issuer))
        with pytest.raises(SetupError, match="issuer is"):
            read_addresses(copy)
        path.write_text(text)


@pytest.mark.clause("LIV-6")
def test_a_port_at_the_name_that_is_taken_is_not_drawn():
    seed = bytes(16)
    drawn = free_addresses(seed, named=True)
    assert drawn == free_addresses(seed, named=True)
    with socket.create_server(("127.0.0.1", drawn.idp_port)):
        assert drawn.taken == (drawn.idp_port,)
        assert free_addresses(seed, named=True).idp_port != drawn.idp_port
    assert free_addresses(seed).provider_host == drawn.host


def test_a_policy_that_is_none_leaves_nothing_behind(run, tmp_path):
    refused(run("up", "--data", tmp_path / "new", "--policy", "no-such-set", "--json"), "CONFIG_INVALID", 2)
    assert not (tmp_path / "new").exists()


def test_a_directory_with_other_things_is_left_alone(run, tmp_path):
    (tmp_path / "thesis.txt").write_text("years of work")
    refused(run("up", "--data", tmp_path, "--json"), "NOT_A_CELL", 2)
    assert (tmp_path / "thesis.txt").read_text() == "years of work"
    refused(run("up", "--data", tmp_path / "thesis.txt", "--json"), "UNWRITABLE", 2)


def test_one_cell_at_a_time(run, copy):
    with DirectoryLock.take(copy.lock):
        told = run("up", "--data", copy.root, "--json")
        refused(told, "RUNNING_ALREADY", 1)
        assert str(os.getpid()) in told.json["detail"]


def test_keys_that_others_can_read(run, copy):
    copy.pep_key.chmod(0o644)
    refused(run("up", "--data", copy.root, "--json"), "KEYS_UNREADABLE", 2)


@pytest.mark.parametrize("name", ["trust", "pep_key", "gateway_key", "cell_config", "gateway_config", "idp_config"])
def test_a_cell_that_lacks_something(run, copy, name):
    getattr(copy, name).unlink()
    refused(run("up", "--data", copy.root, "--json"), "NOT_A_CELL", 2)


def test_an_address_that_somebody_has(run, cell, monkeypatch):
    monkeypatch.setattr("ztpm.up.FREE_S", 0.2)
    with socket.create_server((ADDRESSES.host, ADDRESSES.tools_port)):
        told = run("up", "--data", cell.root, "--json")
    refused(told, "PORT_UNUSABLE", 1)
    assert str(ADDRESSES.tools_port) in told.json["detail"]
    cell.lock.unlink()
    cell.log.unlink()


def test_addresses_are_read_back(cell):
    assert read_addresses(cell) == ADDRESSES


@pytest.mark.parametrize(
    ("file", "before", "after"),
    [
        ("idp_config", 'host = "127.77.0.9"', 'host = "127.77.0.10"'),
        ("idp_config", "port = 8700", "port = 8701"),
        ("idp_config", "port = 8700", "port = 0"),
        ("idp_config", "issuer = ", "publisher = "),
        ("cell_config", "8800/mcp", "8800/other"),
        ("cell_config", "8700/ztpm", "8701/ztpm"),
        ("cell_config", "8900/calls", "8900/others"),
        ("gateway_config", 'robot_host = "127.77.0.9"', 'robot_host = "192.0.2.1"'),
        ("gateway_config", "8900/calls", "8900/others"),
        ("gateway_config", "8900/leases", "8901/leases"),
        ("gateway_config", 'listen_host = "127.77.0.10"', 'listen_host = "127.77.0.11"'),
        ("gateway_config", "[cell]", "[cellar]"),
    ],
)
def test_configurations_that_do_not_hold_together(run, copy, file, before, after):
    path = getattr(copy, file)
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after))
    with pytest.raises(SetupError):
        read_addresses(copy)
    refused(run("up", "--data", copy.root, "--json"), "CONFIG_INVALID", 2)
